"""Which cycles of a run count."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.contour import judged_range
from pkm_cnc.evaluation import Evaluation

__all__ = ["judged_cycles"]


def judged_cycles(evaluation: Evaluation) -> NDArray[np.bool_]:
    """Which cycles count in the summaries, shape (n,): those on the middle half of a judged line, on a judged arc."""
    low, high = np.array(list(map(judged_range, evaluation.elements, evaluation.starts))).T
    segment = np.array([error.segment for error in evaluation.errors])
    path_length = np.array([error.path_length for error in evaluation.errors])
    inside = (low[segment] <= path_length) & (path_length <= high[segment])
    return np.asarray(inside & np.isin(segment, list(evaluation.summaries)), dtype=np.bool_)
