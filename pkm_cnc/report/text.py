"""A table as text for a terminal."""

from __future__ import annotations

from pkm_cnc.report.figure import Table

__all__ = ["text_table"]


def text_table(table: Table) -> str:
    """Title, column names, a rule and the rows; numbers with six significant digits to the right, None as "-"."""
    cells = [list(table.columns), *([_cell(value) for value in row] for row in table.rows)]
    numeric = [all(not isinstance(row[place], str) for row in table.rows) for place in range(len(table.columns))]
    widths = [max(len(line[place]) for line in cells) for place in range(len(table.columns))]
    lines = [
        "  ".join(
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(line, widths, numeric, strict=True)
        ).rstrip()
        for line in cells
    ]
    rule = "-" * (sum(widths) + 2 * (len(widths) - 1))
    return "\n".join([table.title, lines[0], rule, *lines[1:]])


def _cell(value: str | float | None) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else f"{value:.6g}"
