"""Every claim of the thesis that can be checked without its lost figures, and what the model says of it."""

from pkm_cnc.reproduction.claim import Claim, Outcome, Verdict
from pkm_cnc.reproduction.claims import all_claims
from pkm_cnc.reproduction.evidence import Evidence

__all__ = ["Claim", "Evidence", "Outcome", "Verdict", "all_claims"]
