"""Processes that share the work of an experiment."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["starting_workers"]


@contextmanager
def starting_workers() -> Iterator[None]:
    """Processes started within ignore SIGINT, which a terminal sends to all: this process takes it and ends them.

    Else every worker that is still importing prints a traceback. (A blocked signal would not do: joblib's starting of
    processes unblocks it.) What arrives in this tenth of a second is lost. To be used in the main thread.
    """
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
