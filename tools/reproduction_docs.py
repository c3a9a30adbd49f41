"""Writes docs/reproduction.md by judging all claims anew: `.venv/bin/python tools/reproduction_docs.py`."""

from __future__ import annotations

from pathlib import Path

from pkm_cnc.reproduction import Reproduction, judge, markdown

DOCUMENT = Path(__file__).resolve().parent.parent / "docs" / "reproduction.md"

if __name__ == "__main__":
    DOCUMENT.write_text(markdown(Reproduction(judge({}), {})), encoding="utf-8")
    print(f"wrote {DOCUMENT}")
