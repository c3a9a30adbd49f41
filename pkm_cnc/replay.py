"""A recorded run done again from its bag alone, and compared with it message by message."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pkm_cnc.bag import Channel, read_channels
from pkm_cnc.check import prepare
from pkm_cnc.config import Setup, setup_from_text
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.messages import codec, deserialize, time_of
from pkm_cnc.program import Program
from pkm_cnc.records import Command
from pkm_cnc.run_messages import End, RunOptions, command_of, ended
from pkm_cnc.simulation import Cycle, Sink, simulate
from pkm_cnc.topics import RUN_END, SERVO_FRAMES

__all__ = ["Comparison", "Recording", "read_recording", "replay"]

NOT_COMPARED = ("run_info", RUN_END)
"""They tell with which versions and by whom."""


@dataclasses.dataclass(frozen=True)
class Recording:
    """What a bag holds of how its run came about, and its messages by topic.

    `cycles` are those that every servo-rate topic holds; `end` is None for a bag that was never closed.
    """

    setup: Setup
    program: Program
    options: RunOptions
    commands: list[tuple[int, Command]]
    end: End | None
    cycles: int
    channels: dict[str, Channel]

    @property
    def whole(self) -> bool:
        """Whether the run came to the end of its program, so that everything must be there."""
        return self.end is not None and self.end.completed


def read_recording(folder: Path | str) -> Recording:
    """Read a bag of this version or an older one. Raises InputError."""
    channels, _ = read_channels(folder)
    infos = _read(channels, "run_info")
    if not infos:
        raise InputError(f"bag {folder}: it holds no run_info: not a run of pkm_cnc, or it ended before it began")
    info, ends = infos[0], _read(channels, RUN_END)
    servo = [len(channel.lengths) for channel in channels.values() if channel.typename in SERVO_FRAMES]
    return Recording(
        setup=setup_from_text(info.parameters),
        program=Program(info.program_name, info.program),
        options=RunOptions(bool(getattr(info, "attended", False)), getattr(info, "from_line", 0)),
        commands=[command_of(content) for content in _read(channels, "operator/command")],
        end=ended(ends[0]) if ends else None,
        cycles=min(servo, default=0),
        channels=channels,
    )


def _read(channels: dict[str, Channel], topic: str) -> list[Any]:
    return [channels[topic].read(data) for data in channels[topic].messages()] if topic in channels else []


def replay(recording: Recording, sink: Sink | None = None, watch: Callable[[Cycle], None] | None = None) -> Comparison:
    """Simulate a recorded run with its commands in their cycles, as far as it went; compare it, and write it to `sink`.

    Raises InputError for what this version does not accept any more.
    """
    comparison = Comparison(recording)
    fault = None
    try:
        simulate(
            recording.setup,
            recording.program,
            prepare(recording.setup, recording.program, recording.options.from_line),
            _Both(comparison, sink) if sink else comparison,
            watch,
            options=recording.options,
            commands=recording.commands,
            cycles=None if recording.whole else recording.cycles,
        )
    except MachineFault as error:
        fault = error
    comparison.finish()
    if comparison.difference and fault is not None:
        comparison.difference += f"; the replay ended with a fault: {fault}"
    return comparison


@dataclasses.dataclass
class _Both:
    first: Sink
    second: Sink

    def write(self, topic: str, time: int, data: bytes) -> None:
        self.first.write(topic, time, data)
        self.second.write(topic, time, data)


class Comparison:
    """A sink that compares what it is given with a recording. Topics that the recording does not know are not compared.

    A run that ended before its program is compared up to the end of its last whole cycle.
    """

    def __init__(self, recording: Recording) -> None:
        self.messages = 0
        """How many messages were equal."""
        self.difference = ""
        """The first difference: topic, cycle, field, both values; empty while there is none."""
        self._period = recording.setup.servo_period_ns
        self._whole = recording.whole
        self._end = math.inf if recording.whole else recording.cycles * self._period
        self._channels = {topic: channel for topic, channel in recording.channels.items() if topic not in NOT_COMPARED}
        self._recorded = {topic: channel.messages() for topic, channel in self._channels.items()}

    def write(self, topic: str, time: int, data: bytes) -> None:
        """Compare the next message of a topic."""
        if topic not in self._recorded or self.difference or time >= self._end:
            return
        recorded = next(self._recorded[topic], None)
        if recorded is not None and len(recorded) < len(data):  # older versions left the end without padding
            recorded += bytes(-len(recorded) % 4)
        if recorded == data:
            self.messages += 1
        elif recorded is not None:
            where = f"{topic}, cycle {time // self._period}"
            self.difference = f"{where}: {_first_difference(self._channels[topic], recorded, data)}"
        elif self._whole:
            self.difference = f"{topic}, cycle {time // self._period}: replayed, not in the bag"

    def finish(self) -> None:
        """Note that the replay is over: whatever the bag holds beyond it is a difference."""
        for topic, left in self._recorded.items():
            message = next(left, None)
            if message is not None and not self.difference:
                time = time_of(message, self._channels[topic].typename)
                if time < self._end:
                    self.difference = f"{topic}, cycle {time // self._period}: in the bag, not replayed"


def _first_difference(channel: Channel, recorded: bytes, replayed: bytes) -> str:
    """The first field that differs, with both values."""
    before, after = _fields(channel, recorded, own=True), _fields(channel, replayed, own=False)
    for (name, old), (_, new) in itertools.zip_longest(before, after, fillvalue=("", None)):
        if repr(old) != repr(new):  # repr: NaN equals NaN, -0.0 differs from 0.0
            return f"{name} is {old!r} in the bag, {new!r} replayed"
    return "the bytes differ, no field does"


def _fields(channel: Channel, data: bytes, own: bool) -> Iterator[tuple[str, Any]]:
    if channel.typename in SERVO_FRAMES:
        ours = codec(channel.typename, SERVO_FRAMES[channel.typename])
        try:
            cycle, values = ours.unpack(data)
        except ValueError as error:
            return iter([("", str(error))])
        return zip(ours.dtype.names or (), (cycle, *values), strict=True)
    return _leaves("", channel.read(data) if own else deserialize(data, channel.typename))


def _leaves(path: str, content: Any) -> Iterator[tuple[str, Any]]:
    if dataclasses.is_dataclass(content):
        for field in dataclasses.fields(content):
            if field.name != "__msgtype__":
                yield from _leaves(f"{path}.{field.name}".lstrip("."), getattr(content, field.name))
    elif isinstance(content, list):
        for place, item in enumerate(content):
            yield from _leaves(f"{path}[{place}]", item)
    else:
        yield path, content
