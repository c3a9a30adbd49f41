"""A table as text for a terminal, and how its cells are written everywhere."""

from __future__ import annotations

import contextlib
import re

from pkm_cnc.report.figure import Table

__all__ = ["cell", "numeric_columns", "plain", "text_table"]

_NO_TEXT = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


def plain(text: str) -> str:
    """The text with U+FFFD for what no file may hold: control characters, bytes of a file name that are no UTF-8."""
    return _NO_TEXT.sub("\N{REPLACEMENT CHARACTER}", text)


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
    """Which columns hold nothing but numbers, None and texts of numbers."""
    return [all(_is_number(row[place]) for row in table.rows) for place in range(len(table.columns))]


def _is_number(value: str | float | None) -> bool:
    if not isinstance(value, str) or value == "-":
        return True
    with contextlib.suppress(ValueError):
        return bool([float(part) for part in value.split()])
    return False
