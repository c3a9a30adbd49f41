"""All claims."""

from __future__ import annotations

from pkm_cnc.reproduction import section_2, section_4, section_5, section_6, section_7
from pkm_cnc.reproduction.claim import Claim

__all__ = ["all_claims"]


def all_claims() -> tuple[Claim, ...]:
    """In the order of the thesis."""
    chapters = (section_2, section_4, section_5, section_6, section_7)
    return tuple(claim for chapter in chapters for claim in chapter.CLAIMS)
