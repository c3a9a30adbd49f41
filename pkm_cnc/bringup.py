"""The one description of the graph, for the command and for launch: which executables, where, with which parameters."""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from pkm_cnc.config import Setup
from pkm_cnc.errors import MachineFault
from pkm_cnc.run_messages import COMPLETED, End
from pkm_cnc.topics import INTERPOLATOR, RECORDER, nodes

__all__ = ["GraphNodeSpec", "describe_graph", "prepare_environment", "run_in_one_process", "run_in_processes"]

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
LEAVE_TIMEOUT = 3.0
"""s of wall time after which processes are told to leave after one of them has failed."""
TERMINATION_TIMEOUT = 10.0
"""s of wall time that processes have to end after the first of them has."""


class GraphNodeSpec(NamedTuple):
    """One node to start: executable (and node name), namespace relative to the machine's, run parameters it needs."""

    executable: str
    namespace: str
    parameters: dict[str, str]

    @property
    def full_name(self) -> str:
        """Name relative to the machine's namespace, e.g. u1/plant."""
        return f"{self.namespace}/{self.executable}" if self.namespace else self.executable


def describe_graph(axes: Sequence[str], program: str, bag: str, pacing: str) -> list[GraphNodeSpec]:
    """The nodes of a machine with these axes that run `program`, paced "fast" or "realtime", recorded to `bag`."""
    extra = {INTERPOLATOR: {"program": program, "pacing": pacing}, RECORDER: {"bag": bag}}
    specs = []
    for name in nodes(axes):
        namespace, _, executable = name.rpartition("/")
        specs.append(GraphNodeSpec(executable, namespace, extra.get(name, {})))
    return specs


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
def sole_machine() -> Iterator[None]:
    """Hold this computer's ROS domain for one run: two machines on the same topics would stop each other.

    Raises MachineFault where another `pkm_cnc run` holds it. The lock goes with its process, however that ends.
    Machines that were started otherwise, or elsewhere on the network, are noticed by the nodes before they move.
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
        yield


def run_in_one_process(
    setup: Setup, program: str, bag: str, pacing: str, tick: Callable[[int], None] = lambda cycle: None
) -> End:
    """Run the graph in this process; `tick` is told the recorded cycles some ten times a second.

    Raises MachineFault where another machine is on the topics.
    """
    import rclpy
    from rclpy.context import Context
    from rclpy.signals import SignalHandlerOptions

    from pkm_cnc.nodes.all_nodes import NODE_CLASSES
    from pkm_cnc.nodes.recorder import RecorderNode
    from pkm_cnc.nodes.runner import run_nodes

    parameters = {key: value for key, (value, _) in setup.parameters.items()}
    context = Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        with sole_machine():
            recorder = RecorderNode(RECORDER, tapped=True, context=context, parameters={**parameters, "bag": bag})
            others = [
                NODE_CLASSES[spec.executable](
                    spec.executable,
                    context=context,
                    namespace=spec.namespace,
                    parameters={**parameters, **spec.parameters},
                    tap=recorder.tap_in,
                )
                for spec in describe_graph(tuple(setup.axes), program, bag, pacing)
                if spec.executable != RECORDER
            ]
            return run_nodes([*others, recorder], context, lambda: tick(recorder.cycles))
    finally:
        context.try_shutdown()


def run_in_processes(
    setup: Setup, program: str, bag: str, pacing: str, tick: Callable[[int], None] = lambda cycle: None
) -> End:
    """Run the graph with one process per node; `tick` is called some ten times a second, with 0.

    Raises MachineFault where another machine is on the topics.
    """
    specs = describe_graph(tuple(setup.axes), program, bag, pacing)
    with sole_machine(), tempfile.TemporaryDirectory(prefix="pkm_cnc_") as folder:
        parameters = Path(folder, "parameters.yaml")
        parameters.write_text(setup.to_yaml(), encoding="utf-8")
        processes: dict[str, subprocess.Popen[bytes]] = {}
        with _forwarded_signals(processes):
            with _held_signals():
                for spec in specs:
                    processes[spec.full_name] = _start(spec, parameters, Path(folder))
            order = _wait(processes, tick)
        return _end_of({name: processes[name] for name in order}, Path(folder))


def _start(spec: GraphNodeSpec, parameters: Path, folder: Path) -> subprocess.Popen[bytes]:
    arguments = ["--ros-args", "--params-file", str(parameters)]
    if spec.namespace:
        arguments += ["-r", f"__ns:=/{spec.namespace}"]
    for name, value in spec.parameters.items():
        arguments += ["-p", f"{name}:={value}"]
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
        )


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
        if process.returncode < 0:
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
