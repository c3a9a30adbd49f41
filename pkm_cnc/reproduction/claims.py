"""All claims."""

from __future__ import annotations

from pkm_cnc.reproduction import section_6
from pkm_cnc.reproduction.claim import Claim

__all__ = ["all_claims"]


def all_claims() -> tuple[Claim, ...]:
    """In the order of the thesis."""
    return section_6.CLAIMS
