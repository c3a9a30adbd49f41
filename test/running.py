"""What the tests of the graph share: programs, the command as a process, bags read without the code under test."""

import contextlib
import errno
import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from mcap.reader import NonSeekingReader

import pkm_cnc

AXES = ("u1", "u2", "u3")
SERVO_TYPES = {"TcpSetpoint", "AxisSetpoint", "AxisCommand", "AxisCorrection", "AxisState", "TcpState", "ContourError"}

SHORT = "%\nG21 G90\nG1 X6 Y2 F6000\nG3 X6 Y2 I-3 J0\nM30\n%\n"
"""A line, a stop, a full circle of radius 3 mm: about 0.5 s of machine time."""
LONG = "%\nG21 G90\n" + "G1 X100 Y40 F6000\nG1 X-100 Y-40\n" * 30 + "G1 X0 Y0\nM30\n%\n"
"""Two minutes of machine time: it is stopped, it never ends by itself."""

COMMAND = [sys.executable, "-c", "import sys; from pkm_cnc.cli import main; sys.exit(main())"]
TIMEOUT = 60.0
"""s of wall time after which what was awaited is not coming any more."""


def environment():
    """The environment of a child that uses the same pkm_cnc as this process."""
    source = str(Path(pkm_cnc.__file__).parents[1])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [source, os.environ.get("PYTHONPATH", "")]))}


def command(*arguments, **options):
    """Run `pkm_cnc ARGUMENTS` to its end."""
    return subprocess.run(
        [*COMMAND, *map(str, arguments)], env=environment(), capture_output=True, text=True, timeout=TIMEOUT, **options
    )


@contextlib.contextmanager
def started(*arguments, **options):
    """Start `pkm_cnc ARGUMENTS`; whatever happens, it and what it started are gone at the end."""
    process = subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        env=environment(),
        stdout=subprocess.PIPE,
        text=True,
        **{"stderr": subprocess.PIPE, **options},
    )
    below = set()
    try:
        process.below = below
        yield process
    finally:
        below |= set(children(process.pid).values())
        for pid in (process.pid, *below):
            if pid != process.pid or process.poll() is None:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, 9)
        process.communicate()


def children(pid):
    """Processes of the nodes that process `pid` started, by the node's full name."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError, ValueError, StopIteration):
            if int((path / "stat").read_text().rpartition(")")[2].split()[1]) != pid:
                continue
            words = (path / "cmdline").read_bytes().decode().split("\0")
            code = next(word for word in words if word.startswith("from pkm_cnc.nodes."))
            namespace = next((word.removeprefix("__ns:=/") for word in words if word.startswith("__ns:=")), "")
            name = code.split()[1].rpartition(".")[2]
            found[f"{namespace}/{name}".lstrip("/")] = int(path.name)
    return found


def wait_for(condition, what, process=None):
    """Return what `condition()` returns as soon as it is true; `process` must live until then."""
    deadline = time.monotonic() + TIMEOUT
    while True:
        result = condition()
        if result:
            return result
        if process is not None and process.poll() is not None:
            raise AssertionError(f"{what}: the command ended before: {process.communicate()}")
        if time.monotonic() > deadline:
            raise AssertionError(f"{what}: not within {TIMEOUT:g} s")
        time.sleep(0.01)


def wait_until_it_moves(process, bag):
    """Wait until the first two chunks of a bag are on disk: the machine is in the middle of its run."""

    def chunks():
        files = list(Path(bag).glob("*.mcap"))
        return bool(files) and files[0].stat().st_size > 150_000

    wait_for(chunks, f"{bag} grows", process)


def messages(bag):
    """Every message of a bag in order, by topic: log time and bytes."""
    found = {}
    with next(Path(bag).glob("*.mcap")).open("rb") as file:
        for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append((message.log_time, message.data))
    return found


def servo_messages(bag):
    """The messages of the servo-rate topics of a whole bag: log time and bytes, by topic."""
    with next(Path(bag).glob("*.mcap")).open("rb") as file:
        types = {
            channel.topic: schema.name.rpartition("/")[2]
            for schema, channel, _ in NonSeekingReader(file).iter_messages(log_time_order=False)
        }
    return {topic: content for topic, content in messages(bag).items() if types[topic] in SERVO_TYPES}


def one_line(process):
    """The one line on stderr of an ended process."""
    lines = process.stderr.splitlines() if isinstance(process.stderr, str) else process.communicate()[1].splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def evaluation(bag):
    """What `pkm_cnc evaluate --json` prints for a bag, and what it says on stderr."""
    done = command("evaluate", bag, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), done.stderr


class FillingDisk(io.FileIO):
    """A file on a disk with room for so many bytes; the last write goes halfway, as on a real one."""

    room = 600_000

    def write(self, data):
        left = self.room - self.tell()
        if left <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data[:left])


def fill_the_disk(monkeypatch):
    def opened(path, mode="r", *rest, **more):
        writes = path.suffix == ".mcap" and mode == "xb"
        return FillingDisk(path, mode) if writes else open(path, mode, *rest, **more)

    monkeypatch.setattr(Path, "open", opened)
