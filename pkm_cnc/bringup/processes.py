"""One process per node: started, told to stop, waited for, and what they said at the end."""

from __future__ import annotations

import contextlib
import ctypes
import math
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import yaml

from pkm_cnc.bringup.description import GraphNodeSpec, describe_graph
from pkm_cnc.bringup.environment import sole_machine
from pkm_cnc.bringup.listener import Hear, listening
from pkm_cnc.config import Setup
from pkm_cnc.run_messages import COMPLETED, NEUTRAL, End, RunOptions
from pkm_cnc.topics import RECORDER

__all__ = ["run_in_processes"]

MACHINE_FILE = "machine.yaml"
PR_SET_PDEATHSIG = 1
"""From linux/prctl.h."""
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
LEAVE_TIMEOUT = 3.0
"""s of wall time after which processes are told to leave after one of them has failed."""
TERMINATION_TIMEOUT = 10.0
"""s of wall time that processes have to end after the first of them has."""


def run_in_processes(
    setup: Setup,
    program: str,
    bag: str,
    pacing: str,
    tick: Callable[[int], None] = lambda cycle: None,
    options: RunOptions = NEUTRAL,
    hear: Hear | None = None,
) -> End:
    """Run the graph with one process per node; `tick` is called some ten times a second, with 0.

    `hear` gets the messages of the topics HEARD. Raises MachineFault where another machine runs in the ROS domain.
    """
    specs = describe_graph(tuple(setup.axes), program, bag, pacing, setup.tcp_control.active, options)
    with sole_machine() as lock, tempfile.TemporaryDirectory(prefix="pkm_cnc_") as folder:
        Path(folder, MACHINE_FILE).write_text(setup.to_yaml(), encoding="utf-8")
        processes: dict[str, subprocess.Popen[bytes]] = {}
        with _forwarded_signals(processes):
            with _held_signals():
                for spec in specs:
                    processes[spec.full_name] = _start(spec, Path(folder), lock)
            with contextlib.nullcontext() if hear is None else listening(tuple(setup.axes), hear) as look:
                order = _wait(processes, tick if look is None else partial(_look_and_tick, look, tick))
        return _end_of({name: processes[name] for name in order}, Path(folder))


def _look_and_tick(look: Callable[[], None], tick: Callable[[int], None], cycle: int) -> None:
    look()
    tick(cycle)


def _start(spec: GraphNodeSpec, folder: Path, lock: int) -> subprocess.Popen[bytes]:
    arguments = ["--ros-args", "--params-file", str(folder / MACHINE_FILE)]
    if spec.namespace:
        arguments += ["-r", f"__ns:=/{spec.namespace}"]
    if spec.parameters:  # in a file, because "-p name:=1.10" would be a number
        own = _output(folder, spec.full_name, "yaml")
        own.write_text(yaml.safe_dump({"/**": {"ros__parameters": spec.parameters}}), encoding="utf-8")
        arguments += ["--params-file", str(own)]
    code = f"from pkm_cnc.nodes.{spec.executable} import main; main()"
    with (
        _output(folder, spec.full_name, "out").open("wb") as out,
        _output(folder, spec.full_name, "err").open("wb") as err,
    ):
        return subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,
            pass_fds=(lock,),
            preexec_fn=_end_with_the_parent,
        )


def _end_with_the_parent() -> None:
    """In a new process: be told to stop when the process that started it is gone, however that ended (Linux)."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM))


def _output(folder: Path, full_name: str, stream: str) -> Path:
    return folder / f"{full_name.replace('/', '.')}.{stream}"


def _wait(processes: dict[str, subprocess.Popen[bytes]], tick: Callable[[int], None]) -> list[str]:
    """Wait until all have ended; return their names in the order in which they did."""
    order: list[str] = []
    first_left = math.inf
    told = False
    while len(order) < len(processes):
        time.sleep(0.1)
        tick(0)
        now = time.monotonic()
        order += [name for name, process in processes.items() if name not in order and process.poll() is not None]
        if any(processes[name].returncode >= 0 for name in order):  # a killed one is the watchdog's matter
            first_left = min(first_left, now)
        running = [process for name, process in processes.items() if name not in order]
        if now > first_left + TERMINATION_TIMEOUT:
            for process in running:
                process.kill()
        elif now > first_left + LEAVE_TIMEOUT and not told and any(processes[name].returncode > 0 for name in order):
            told = True
            for process in running:
                process.terminate()
    return order


def _end_of(processes: dict[str, subprocess.Popen[bytes]], folder: Path) -> End:
    for name, process in processes.items():
        if process.returncode > 0:
            lines = _output(folder, name, "err").read_text(errors="replace").splitlines()
            said = [line.removeprefix("pkm_cnc: ") for line in lines if line.startswith("pkm_cnc: ")]
            node, _, reason = (said or [f"{name}: {(lines or ['ended without a word'])[-1]}"])[-1].partition(": ")
            return End(0, node, reason, process.returncode)
    for name, process in processes.items():
        # Fast DDS may crash or hang while it is torn down: what a node has completed before, it has completed.
        if process.returncode < 0 and COMPLETED not in _output(folder, name, "out").read_text():
            return End(0, name, f"killed by {signal.Signals(-process.returncode).name}")
    for name in processes:
        sys.stderr.write(_output(folder, name, "err").read_text(errors="replace"))  # warnings
    said = _output(folder, RECORDER, "out").read_text().splitlines()
    return End(int(said[-1].removeprefix(COMPLETED)), RECORDER, "")


@contextlib.contextmanager
def _held_signals() -> Iterator[None]:
    """Signals wait meanwhile; a process that is started takes them when it is ready to."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _forwarded_signals(processes: dict[str, subprocess.Popen[bytes]]) -> Iterator[None]:
    def forward(number: int, frame: object) -> None:
        for process in processes.values():
            process.send_signal(number)

    before = {number: signal.signal(number, forward) for number in STOP_SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
