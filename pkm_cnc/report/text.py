"""A table as text for a terminal, and how its cells are written everywhere."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Sequence

from pkm_cnc.report.figure import Table

__all__ = ["cell_texts", "numeric_columns", "plain", "text_table"]

SIGNIFICANT = 6
"""Digits of the largest number of a column."""
SMALL, LARGE = 1e-4, 1e9
"""Columns whose largest number is not between are written with powers of ten."""
_NO_TEXT = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


def plain(text: str) -> str:
    """The text with U+FFFD for what no file may hold: control characters, bytes of a file name that are no UTF-8."""
    return _NO_TEXT.sub("\N{REPLACEMENT CHARACTER}", text)


def text_table(table: Table) -> str:
    """Title, column names, a rule and the rows; columns of numbers stand to the right."""
    cells = [list(table.columns), *cell_texts(table)]
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


def cell_texts(table: Table) -> list[list[str]]:
    """The rows as texts: texts as they are, None as "-", numbers with six significant digits of their column's largest.

    So rounding noise beside large numbers shows as zero; a column of small numbers alone shows them.
    """
    forms = [_form([row[place] for row in table.rows]) for place in range(len(table.columns))]
    return [
        [
            "-" if value is None else value if isinstance(value, str) else form(value)
            for form, value in zip(forms, row, strict=True)
        ]
        for row in table.rows
    ]


def _form(column: Sequence[str | float | None]) -> Callable[[float], str]:
    sizes = [abs(value) for value in column if isinstance(value, (int, float)) and math.isfinite(value)]
    largest = max(sizes, default=0.0)
    if not SMALL <= largest < LARGE:
        return "{:.6g}".format
    decimals = max(0, SIGNIFICANT - 1 - math.floor(math.log10(largest)))
    while decimals and all(round(size, decimals) == round(size, decimals - 1) for size in sizes):
        decimals -= 1
    return lambda value: f"{value:.{decimals}f}" if round(value, decimals) else f"{0.0:.{decimals}f}"


def numeric_columns(table: Table) -> list[bool]:
    """Which columns hold nothing but numbers, None and texts of numbers."""
    return [all(_is_number(row[place]) for row in table.rows) for place in range(len(table.columns))]


def _is_number(value: str | float | None) -> bool:
    if not isinstance(value, str) or value == "-":
        return True
    with contextlib.suppress(ValueError):
        return bool([float(part) for part in value.split()])
    return False
