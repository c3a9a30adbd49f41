"""What a claim of the thesis is, and what a check of it says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from pkm_cnc.reproduction.evidence import Evidence

__all__ = ["Check", "Claim", "Outcome", "Verdict", "claim", "judged", "not_checkable"]

Verdict = Literal["reproduced", "contradicted", "not checkable"]


@dataclass(frozen=True)
class Outcome:
    """What a check found: the verdict, the figures it rests on with their units, and why, or what to keep in mind."""

    verdict: Verdict
    computed: str
    reason: str = ""


Check = Callable[[Evidence], Outcome]


@dataclass(frozen=True)
class Claim:
    """A statement of the thesis, in our words, and the check that judges it."""

    name: str
    section: str
    claim: str
    source: str
    """What the computed figures come from."""
    check: Check


def claim(section: str, text: str, source: str) -> Callable[[Check], Claim]:
    """Make the check below it a Claim, called as the function is."""

    def made(check: Check) -> Claim:
        return Claim(check.__name__.replace("_", "-"), section, text, source, check)

    return made


def judged(holds: bool, computed: str, *, otherwise: str = "", remark: str = "") -> Outcome:
    """The verdict by whether the claim `holds`, which is computed; `otherwise` is why if it does not."""
    if holds:
        return Outcome("reproduced", computed, remark)
    return Outcome("contradicted", computed, otherwise or "the model does not show it")


def not_checkable(reason: str, computed: str = "-") -> Outcome:
    """For what this version of the model cannot answer; `computed` is what it can say nevertheless."""
    return Outcome("not checkable", computed, reason)
