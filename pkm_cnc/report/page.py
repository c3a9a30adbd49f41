"""One self-contained page: the question, the answer in tables and pictures, what it was made with.

The page opens without a network; on paper it shows the SVG pictures in the place of those that move.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from pkm_cnc import __version__
from pkm_cnc.errors import InputError
from pkm_cnc.report.figure import Figure, Table
from pkm_cnc.report.files import write_whole
from pkm_cnc.report.text import cell_texts, numeric_columns, plain
from pkm_cnc.report.thinning import thinned

__all__ = ["Page", "write_page"]


@dataclass(frozen=True)
class Page:
    """What a page says, in this order; texts are plain, not HTML."""

    title: str
    question: str
    command: str
    """The command that made it."""
    tables: Sequence[Table]
    figures: Sequence[Figure]
    remarks: Sequence[str] = ()
    parameters: Sequence[Table] = ()
    """What it was made with, below everything else; the last table, the longest, is folded."""
    links: Sequence[tuple[str, str]] = ()
    """Text and relative address of pages that belong to it."""
    data: dict[str, Any] | None = None
    """Written beside the page as data.json, for scripts."""


def write_page(folder: Path, page: Page) -> list[Path]:
    """Write index.html, each figure as NAME.svg and NAME.png and the data to `folder`, made if it does not exist.

    Each file appears whole or not at all, index.html last; equal pages give equal files. Returns their paths.
    Raises InputError where `folder` cannot be written.
    """
    from pkm_cnc.report import paper  # half a second of imports that only pages need, as those of screen below

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"report {folder}: {error.strerror}") from None
    drawn = [(figure, paper.svg(figure)) for figure in map(thinned, page.figures)]
    files = [
        (f"{figure.name}.{kind}", content)
        for figure, svg in drawn
        for kind, content in (("svg", svg), ("png", paper.png(figure)))
    ]
    if page.data is not None:
        files.append(("data.json", (json.dumps(page.data, allow_nan=False, indent=1) + "\n").encode()))
    files.append(("index.html", _html(page, drawn).encode()))
    return [write_whole(folder / name, content) for name, content in files]


def _html(page: Page, drawn: Sequence[tuple[Figure, bytes]]) -> str:
    from pkm_cnc.report import screen

    links = "".join(f'<li><a href="{_text(address)}">{_text(text)}</a></li>' for text, address in page.links)
    return _PAGE.substitute(
        title=_text(page.title),
        question=_text(page.question),
        tables="".join(map(_table, page.tables)),
        remarks="".join(f'<p class="remark">{_text(remark)}</p>' for remark in page.remarks),
        links=f"<ul>{links}</ul>" if links else "",
        figures="".join(_figure(figure, svg, screen.picture(figure, f"figure-{figure.name}")) for figure, svg in drawn),
        parameters="".join(
            _parameters(table, "" if table is page.parameters[-1] else " open") for table in page.parameters
        ),
        command=_text(page.command),
        version=_text(__version__),
        script=f"<script>{screen.script()}</script>" if drawn else "",
    )


def _text(text: str) -> str:
    return escape(plain(text))


def _figure(figure: Figure, svg: bytes, moving: str) -> str:
    name = _text(figure.name)
    return (
        f'<figure><div class="screen">{moving}</div>'
        f'<img class="paper" alt="{_text(figure.title)}"'
        f' src="data:image/svg+xml;base64,{base64.b64encode(svg).decode()}">'
        f"<figcaption><b>{_text(figure.title)}.</b> {_text(figure.caption)} "
        f'<span class="files">Files: <a href="{name}.svg">{name}.svg</a>, <a href="{name}.png">{name}.png</a></span>'
        "</figcaption></figure>"
    )


def _table(table: Table) -> str:
    kinds = [' class="number"' if right else "" for right in numeric_columns(table)]
    head = "".join(f"<th{kind}>{_text(name)}</th>" for kind, name in zip(kinds, table.columns, strict=True))
    rows = "".join(
        "<tr>" + "".join(f"<td{kind}>{_text(text)}</td>" for kind, text in zip(kinds, row, strict=True)) + "</tr>"
        for row in cell_texts(table)
    )
    caption = f"<caption>{_text(table.title)}</caption>" if table.title else ""
    return f'<div class="table"><table>{caption}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'


def _parameters(table: Table, shown: str) -> str:
    return f"<details{shown}><summary>{_text(table.title)}</summary>{_table(replace(table, title=''))}</details>"


_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>$title</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; max-width: 1100px; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0.5rem 0; }
.question { font-size: 1.1rem; color: #333; max-width: 48rem; }
.table { overflow-x: auto; margin: 1.2rem 0; }
table { border-collapse: collapse; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: 0.3rem 0; white-space: nowrap; }
th, td { padding: 0.2rem 0.7rem; text-align: left; vertical-align: top; border-bottom: 1px solid #ddd; }
th { border-bottom: 2px solid #555; }
.number { text-align: right; white-space: nowrap; }
.remark { max-width: 52rem; white-space: pre-line; }
figure { margin: 2rem 0; }
.panels { display: grid; grid-template-columns: repeat(var(--columns), minmax(0, 1fr)); gap: 0.5rem 1.5rem; }
.panel { grid-row: span var(--rows); min-width: 0; }
.panel h3 { font-size: 0.9rem; font-weight: 600; text-align: center; min-height: 1.4rem; margin: 0.5rem 0 0; }
.plot { height: calc(var(--rows) * 20rem + (var(--rows) - 1) * 2.4rem); }
.tall .plot { height: 34rem; }
@media screen and (max-width: 50rem) {
  .panels { grid-template-columns: minmax(0, 1fr); }
  .panel { grid-row: auto; }
  .tall .plot, .plot { height: min(34rem, 105vw); }
}
figcaption { font-size: 0.9rem; color: #333; max-width: 52rem; }
.files { color: #666; }
.paper { display: none; width: 100%; }
code { background: #f2f2f2; padding: 0.1rem 0.3rem; overflow-wrap: anywhere; }
details { margin: 1.5rem 0; }
summary { cursor: pointer; font-weight: 600; }
footer { border-top: 1px solid #ddd; margin-top: 2rem; padding-top: 0.5rem; font-size: 0.9rem; color: #333; }
@media print {
  body { max-width: none; font-size: 11pt; padding: 0; }
  .screen, .files { display: none; }
  .paper { display: block; max-height: 22cm; object-fit: contain; object-position: left; }
  figure { break-inside: avoid; }
  .table { overflow: visible; }
  table { font-size: 8pt; }
  th, td { padding: 0.1rem 0.35rem; }
}
</style>
<noscript><style>.screen { display: none; } .paper { display: block; }</style></noscript>
$script
</head>
<body>
<h1>$title</h1>
<p class="question">$question</p>
$tables
$remarks
$links
$figures
$parameters
<footer><p>Made by <code>$command</code> (pkm_cnc $version)</p></footer>
</body>
</html>
""")
