"""Processes that share the work leave Ctrl-C to the one that started them."""

from __future__ import annotations

import signal
import subprocess
import sys

from pkm_cnc.experiments import starting_workers

IGNORES = "import signal; print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)"


def test_a_worker_ignores_what_the_terminal_sends_to_all() -> None:
    before = signal.getsignal(signal.SIGINT)
    with starting_workers():
        worker = subprocess.run([sys.executable, "-c", IGNORES], capture_output=True, text=True, check=True)
    assert worker.stdout == "True\n"
    assert signal.getsignal(signal.SIGINT) is before


def test_the_workers_of_joblib_are_started_as_the_first_tasks_are_given_out() -> None:
    """In a process of its own: here joblib may have workers already."""
    program = """
import signal
from joblib import Parallel, delayed
from pkm_cnc.experiments import starting_workers
with starting_workers():
    told = Parallel(n_jobs=2, return_as="generator")(delayed(signal.getsignal)(signal.SIGINT) for _ in range(4))
print(set(told) == {signal.SIG_IGN})
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"
