"""A bag against itself: equal, or the first difference; and bags that end early or are of an older version."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import pytest
from command_line import done, refused
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from running import messages

from pkm_cnc.bag import BagWriter, Channel, read_channels
from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.messages import codec, deserialize, typestore
from pkm_cnc.program import Program
from pkm_cnc.records import CMD_FEED_OVERRIDE, CMD_HOLD, CMD_RAPID_OVERRIDE, CMD_RESUME, Command
from pkm_cnc.replay import Comparison, read_recording
from pkm_cnc.simulation import simulate
from pkm_cnc.topics import Topic, recorded_topics, topics

REFERENCE = Path(__file__).resolve().parents[1] / "bags" / "reference"
CORNER = Program("corner.ngc", "G21 G90\nG1 X10 F3000\nG1 Y10\nM0\nG1 X0\nM2\n")
AXES = ("u1", "u2", "u3")


def record(bag: Path, *commands: tuple[int, Command], change=lambda topic, time, data: data) -> Path:
    """A bag of the simulation; `change` may alter what is written."""
    setup = load_setup("tripod")
    with BagWriter(bag, recorded_topics(AXES)) as writer:

        class Changing:
            def write(self, topic: str, time: int, data: bytes) -> None:
                altered = change(topic, time, data)
                if altered is not None:
                    writer.write(topic, time, altered)

        simulate(setup, CORNER, prepare(setup, CORNER), Changing(), commands=commands)
    return bag


class OldBagWriter(BagWriter):
    """Writes what a version did that knew no operator: no topics of his, no options in run_info."""

    def __init__(self, folder: Path) -> None:
        new = ("operator/command", "program/event", "status")
        super().__init__(folder, [topic for topic in recorded_topics(AXES) if topic.name not in new])

    def _add(self, topic: Topic) -> int:
        return self._stream.add_channel(f"/{topic.name}", topic.typename, self._definition(topic), {})

    def _definition(self, topic: Topic) -> str:
        definition, _ = typestore().generate_msgdef(topic.typename, ros_version=2)
        return re.sub(r"^(bool attended|uint32 from_line)\n", "", definition, flags=re.MULTILINE)

    def write(self, topic: str, time: int, data: bytes) -> None:
        if topic == "run_info":
            (info,) = (one for one in self._topics if one.name == topic)
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(self._definition(info), info.typename))
            content = deserialize(data, info.typename)
            names = [name for name, _ in store.fielddefs[info.typename][1]]
            old = store.types[info.typename](**{name: getattr(content, name) for name in names})
            assert "attended" not in names
            data = bytes(store.serialize_cdr(old, info.typename))
        if topic in self._channels:
            super().write(topic, time, data)


def test_a_bag_of_an_older_version_is_replayed_without_commands(tmp_path: Path) -> None:
    setup = load_setup("tripod")
    with OldBagWriter(tmp_path / "bag") as writer:
        cycles = simulate(setup, CORNER, prepare(setup, CORNER), writer)
    assert done("replay", tmp_path / "bag").startswith(f"equal bit for bit: {cycles} cycles, ")
    assert done("evaluate", tmp_path / "bag")


def test_commands_are_given_again_in_their_cycles(tmp_path: Path) -> None:
    commands = [
        (100, Command(CMD_HOLD, 0.0)),
        (105, Command(CMD_RESUME, 0.0)),
        (180, Command(CMD_FEED_OVERRIDE, 0.5)),
        (180, Command(CMD_RAPID_OVERRIDE, 0.5)),
        (300, Command(CMD_FEED_OVERRIDE, 1.5)),
    ]
    bag = record(tmp_path / "bag", *commands)
    assert read_recording(bag).commands == commands
    assert done("replay", bag, "--bag", tmp_path / "again").startswith("equal bit for bit: ")
    assert messages(tmp_path / "again") == messages(bag)


def test_a_run_is_not_the_same_without_its_commands(tmp_path: Path) -> None:
    def change(name: str, time: int, data: bytes) -> bytes | None:
        return None if name == "operator/command" else data

    bag = record(tmp_path / "bag", (100, Command(CMD_FEED_OVERRIDE, 0.5)), change=change)
    assert "cycle 100: " in refused("replay", bag, code=1)


def test_the_first_difference_is_named_with_both_values(tmp_path: Path) -> None:
    topic = topics(AXES)["u2/command"]

    def change(name: str, time: int, data: bytes) -> bytes:
        if name != topic.name or time != 70_000_000:
            return data
        cycle, (velocity, _) = topic.codec.unpack(data)
        return topic.codec.pack(cycle, time, (velocity, 0.125))

    line = refused("replay", record(tmp_path / "bag", change=change), code=1)
    assert "u2/command, cycle 70: tracking_error is 0.125 in the bag, " in line


def test_a_difference_in_a_text_is_named(tmp_path: Path) -> None:
    def change(name: str, time: int, data: bytes) -> bytes:
        return data.replace(b"G1 Y10", b"G1 Y11") if name == "status" else data

    line = refused("replay", record(tmp_path / "bag", change=change), code=1)
    assert "status, cycle " in line
    assert "block is 'G1 Y11' in the bag, 'G1 Y10' replayed" in line


@pytest.mark.parametrize("topic", ["status", "program/event", "contour_monitor/segment_summary"])
def test_a_message_that_is_missing_or_too_many_is_a_difference(tmp_path: Path, topic: str) -> None:
    dropped = []

    def change(name: str, time: int, data: bytes) -> bytes | None:
        if name == topic and not dropped:
            dropped.append(data)
            return None
        return data

    assert f"{topic}, cycle " in refused("replay", record(tmp_path / "bag", change=change), code=1)


def test_a_bag_that_was_never_closed_is_compared_up_to_its_end(tmp_path: Path) -> None:
    bag = record(tmp_path / "bag")
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    assert "up to where the run ended (it was never closed)" in done("replay", bag)


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    assert "no .mcap file there" in refused("replay", tmp_path)
    bag = record(tmp_path / "bag", change=lambda name, time, data: None if name == "run_info" else data)
    assert "it holds no run_info" in refused("replay", bag)


def test_not_a_number_equals_itself_and_the_sign_of_zero_counts() -> None:
    error = topics(AXES)["contour_error"]
    definition = ""
    recording = read_recording(REFERENCE)

    def compared(before: float, after: float) -> str:
        one, other = (
            codec(error.typename, error.frame_id).pack(0, 0, (value, *(0.0,) * 6, 0)) for value in (before, after)
        )
        channel = Channel("contour_error", error.typename, definition, bytearray(one), [len(one)])
        comparison = Comparison(recording.__class__(**{**recording.__dict__, "channels": {"contour_error": channel}}))
        comparison.write("contour_error", 0, other)
        return comparison.difference

    nan, other_nan = (struct.unpack("<d", struct.pack("<Q", bits))[0] for bits in (0x7FF8 << 48, 0xFFF8 << 48))
    assert compared(nan, nan) == ""
    assert compared(0.0, -0.0) == "contour_error, cycle 0: vector.x is 0.0 in the bag, -0.0 replayed"
    assert "cycle 0" in compared(nan, other_nan)
    assert read_channels(REFERENCE)[1]
