"""A table as text for a terminal, and how its cells are written everywhere."""

from __future__ import annotations

import contextlib

from pkm_cnc.report.figure import Table

__all__ = ["cell", "numeric_columns", "text_table"]


def text_table(table: Table) -> str:
    """Title, column names, a rule and the rows; columns of numbers stand to the right."""
    cells = [list(table.columns), *([cell(value) for value in row] for row in table.rows)]
    widths = [max(len(line[place]) for line in cells) for place in range(len(table.columns))]
    numeric = numeric_columns(table)
    lines = [
        "  ".join(
            text.rjust(width) if right else text.ljust(width)
            for text, width, right in zip(line, widths, numeric, strict=True)
        ).rstrip()
        for line in cells
    ]
    rule = "-" * (sum(widths) + 2 * (len(widths) - 1))
    return "\n".join([table.title, lines[0], rule, *lines[1:]])


def cell(value: str | float | None) -> str:
    """A number with six significant digits, None as "-", a text as it is."""
    if value is None:
        return "-"
    return value if isinstance(value, str) else f"{value:.6g}"


def numeric_columns(table: Table) -> list[bool]:
    """Which columns hold nothing but numbers, None and texts that are numbers."""
    return [all(_is_number(row[place]) for row in table.rows) for place in range(len(table.columns))]


def _is_number(value: str | float | None) -> bool:
    if not isinstance(value, str) or value == "-":
        return True
    with contextlib.suppress(ValueError):
        float(value)
        return True
    return False
