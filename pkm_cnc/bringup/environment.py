"""What a run needs around it: settings of ROS, and the ROS domain for itself."""

from __future__ import annotations

import contextlib
import fcntl
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from pkm_cnc.errors import MachineFault

__all__ = ["prepare_environment", "sole_machine"]


def prepare_environment() -> None:
    """Let ROS work in a bare environment: find the installed packages, stay on this machine, have a place for logs.

    Only what is not set is set.
    """
    if Path(sys.prefix, "share", "ament_index").is_dir():
        os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if not any(name in os.environ for name in ("ROS_LOG_DIR", "ROS_HOME", "HOME")):
        os.environ["ROS_LOG_DIR"] = str(Path(tempfile.gettempdir(), "pkm_cnc_log"))


@contextlib.contextmanager
def sole_machine() -> Iterator[int]:
    """Hold this computer's ROS domain for one run: two machines on the same topics would stop each other.

    Gives the lock's file descriptor: the lock lives as long as any process that has it, however they end. Machines that
    were started otherwise, or elsewhere on the network, are noticed by the nodes before they move.
    Raises MachineFault where another `pkm_cnc run` holds it.
    """
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    path = Path(tempfile.gettempdir(), f"pkm_cnc_domain_{domain}_{os.getuid()}.lock")
    with path.open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise MachineFault(
                f"another machine runs in ROS domain {domain}: give this one another ROS_DOMAIN_ID"
            ) from None
        yield lock.fileno()
