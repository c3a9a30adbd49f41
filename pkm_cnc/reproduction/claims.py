"""All claims, by chapter."""

from __future__ import annotations

from collections.abc import Mapping

from pkm_cnc.reproduction import section_2, section_4, section_5, section_6, section_7
from pkm_cnc.reproduction.claim import Claim

__all__ = ["CHAPTERS"]

CHAPTERS: Mapping[str, tuple[Claim, ...]] = {
    "2.2 Servo motion control": section_2.CLAIMS,
    "4 Monopod": section_4.CLAIMS,
    "5 Bipod": section_5.CLAIMS,
    "6 Tripod": section_6.CLAIMS,
    "7 Compensation": section_7.CLAIMS,
}
"""In the order of the thesis, as the claims of each."""
