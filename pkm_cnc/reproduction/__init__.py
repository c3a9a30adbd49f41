"""Every claim of the thesis that can be checked without its lost figures, and what the model says of it.

A claim is data (`Claim`): section, statement in our words, and a check that computes its verdict from evidence. The
claims of a chapter are the Claims of its module here, in the order in which they stand.
"""

from pkm_cnc.reproduction.claim import Claim, Outcome, Verdict
from pkm_cnc.reproduction.claims import CHAPTERS
from pkm_cnc.reproduction.document import claims_table, counts_table, markdown, text
from pkm_cnc.reproduction.evidence import Evidence
from pkm_cnc.reproduction.pages import write_report
from pkm_cnc.reproduction.run import LEFT_OUT, Judged, Reproduction, judge, reproduce

__all__ = [
    "CHAPTERS",
    "LEFT_OUT",
    "Claim",
    "Evidence",
    "Judged",
    "Outcome",
    "Reproduction",
    "Verdict",
    "claims_table",
    "counts_table",
    "judge",
    "markdown",
    "reproduce",
    "text",
    "write_report",
]
