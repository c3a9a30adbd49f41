"""Pictures of a run."""

from __future__ import annotations

from pathlib import Path

from pkm_cnc.evaluation import Evaluation

__all__ = ["draw"]


def draw(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write the pictures of a run to `folder`; return their paths."""
    return []
