"""The judged claims as tables, as text for a terminal, and as docs/reproduction.md."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from pkm_cnc.report import Table
from pkm_cnc.reproduction.run import Judged, Reproduction

__all__ = ["READING", "claims_table", "counts_table", "markdown", "text"]

READING = (
    "Every claim is in our words. Its verdict is computed: from the figures beside it and a tolerance that its check "
    "states (`pkm_cnc/reproduction/section_*.py`). `pkm_cnc reproduce` computes it all anew.",
    "Reproduced: the model shows it. Where the thesis measured, this is the model's answer to the same question.",
    "Contradicted: the model, or the algebra, shows otherwise; the reason is given. Nothing is tuned into agreement.",
    "Not checkable: it needs what is lost, or what this version of the model does not have; the reason says what.",
    "Contour error + = the tool is left of travel; radial deviation + = the circle came out too small.",
)
"""How to read the tables."""

HEAD = """# The thesis, claim by claim

The statements of sections 2.2 to 7.6 of the thesis that can be checked without its lost figures, and what this model
says of them. Written by `tools/reproduction_docs.py`.
"""


def claims_table(title: str, judged: Sequence[Judged]) -> Table:
    """Section, claim, computed figures, verdict, reason."""
    rows = [
        (each.claim.section, each.claim.claim, each.outcome.computed, each.outcome.verdict, each.outcome.reason)
        for each in judged
    ]
    return Table(title, ("section", "claim", "computed", "verdict", "why, or what to keep in mind"), rows)


def counts_table(reproduction: Reproduction) -> Table:
    """How many claims have each verdict."""
    return Table("Verdicts", ("verdict", "claims"), list(reproduction.counts().items()))


def text(reproduction: Reproduction) -> str:
    """For a terminal of any width: claim by claim, then how many have each verdict."""
    lines = []
    for title, chapter in reproduction.by_chapter().items():
        lines.append(title)
        for each in chapter:
            outcome = each.outcome
            lines += [f"  {outcome.verdict.upper():14}{each.claim.section}: {each.claim.claim}"]
            said = [outcome.computed] * (outcome.computed != "-") + [f"({outcome.reason})"] * bool(outcome.reason)
            lines += textwrap.wrap(" ".join(said), 104, initial_indent=" " * 16, subsequent_indent=" " * 16)
        lines.append("")
    counts = ", ".join(f"{number} {verdict}" for verdict, number in reproduction.counts().items())
    return "\n".join([*lines, f"{len(reproduction.judged)} claims: {counts}"])


def markdown(reproduction: Reproduction) -> str:
    """docs/reproduction.md."""
    parts = [HEAD, "\n".join([*(f"- {sentence}" for sentence in READING), ""])]
    for title, chapter in reproduction.by_chapter().items():
        table = claims_table(title, chapter)
        lines = [f"## {title}", "", _row(table.columns), "|" + "---|" * len(table.columns)]
        parts.append("\n".join([*lines, *(_row([str(cell) for cell in row]) for row in table.rows), ""]))
    return "\n".join(parts)


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
