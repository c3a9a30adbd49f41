"""Bags: other programs read them, and what was on disk before a fault stays readable."""

import re
import resource
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from running import AXES, FillingDisk, command, fill_the_disk, one_line

import pkm_cnc_msgs.msg
from pkm_cnc.bag import BagWriter, read_run
from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.evaluation import evaluate
from pkm_cnc.messages import typestore
from pkm_cnc.program import read_program
from pkm_cnc.simulation import simulate
from pkm_cnc.topics import recorded_topics

PERIOD_NS = 1_000_000
LINES = "G21 G90\nG1 X40 Y15 F6000\nG1 X0 Y0\nM2\n"
RECORDED = recorded_topics(AXES)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A bag of more than a second, what was written to it, and its number of cycles."""
    folder = tmp_path_factory.mktemp("bag")
    (folder / "lines.ngc").write_text(LINES)
    setup, program = load_setup("tripod"), read_program(str(folder / "lines.ngc"))
    written = []
    with BagWriter(folder / "run", RECORDED) as bag:

        class Both:
            def write(self, topic, time, data):
                written.append((topic, time, data))
                bag.write(topic, time, data)

        cycles = simulate(setup, program, prepare(setup, program), Both())
    return folder / "run", written, cycles


def write_all(bag, messages):
    for message in messages:
        bag.write(*message)


def mcap_file(folder):
    return folder / f"{folder.name}_0.mcap"


def test_rosbags_reads_every_message_with_its_type(recorded):
    folder, written, _ = recorded
    with AnyReader([folder], default_typestore=typestore()) as reader:
        read = [(connection.topic, time, data) for connection, time, data in reader.messages()]
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        assert reader.duration == max(time for _, time, _ in written) + 1
        state = next(
            reader.deserialize(data, connection.msgtype)
            for connection, time, data in reader.messages()
            if connection.topic == "/tcp/state" and time == 500 * PERIOD_NS
        )
    assert sorted(read) == sorted((f"/{topic}", time, data) for topic, time, data in written)
    assert types == {f"/{topic.name}": topic.typename for topic in RECORDED}
    assert state.cycle == 500
    assert state.header.frame_id == "base_link"
    assert state.position.x > 0.01


def test_rosbags_needs_no_definitions_but_those_in_the_bag(recorded):
    folder, _, cycles = recorded
    with AnyReader([folder]) as reader:
        connections = [connection for connection in reader.connections if connection.topic == "/u2/actual"]
        read = [reader.deserialize(data, kind.msgtype).cycle for kind, _, data in reader.messages(connections)]
    assert read == list(range(cycles + 1))


def test_mcap_reads_it_by_its_index_and_ros_the_messages(recorded):
    folder, written, cycles = recorded
    with mcap_file(folder).open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert summary.statistics.message_count == len(written)
        assert summary.statistics.message_end_time == cycles * PERIOD_NS
        window = reader.iter_messages(
            topics=["/contour_error"], starting_at=100 * PERIOD_NS, ending_before=103 * PERIOD_NS
        )
        found = [deserialize_message(message.data, pkm_cnc_msgs.msg.ContourError).cycle for _, _, message in window]
    assert found == [100, 101, 102]


def test_all_that_was_written_is_read_back(recorded):
    folder, written, cycles = recorded
    run = read_run(folder)
    assert run.complete
    assert run.cycles() == cycles
    assert list(run.servo["u1/actual"]["cycle"]) == list(range(cycles + 1))
    assert len(run.slow["run_info"]) == 1
    assert run.slow["run_info"][0].program == LINES
    assert {topic: len(rows) for topic, rows in run.servo.items()} == {
        topic.name: sum(name == topic.name for name, _, _ in written) for topic in RECORDED if topic.record
    }
    assert read_run(mcap_file(folder)).cycles() == cycles


def whole_chunks(path):
    """End of every chunk in the file, and the latest time in it, as its own index tells."""
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    return [(chunk.chunk_start_offset + chunk.chunk_length, chunk.message_end_time) for chunk in chunks]


def test_a_chunk_is_on_disk_before_a_second_of_machine_time_has_passed(recorded):
    times = [0] + [time for _, time in whole_chunks(mcap_file(recorded[0]))]
    assert len(times) > 4
    assert max(np.diff(times)) < 1_000_000_000


def damaged(folder, tmp_path, content):
    other = tmp_path / "damaged"
    shutil.rmtree(other, ignore_errors=True)
    other.mkdir()
    (other / "damaged_0.mcap").write_bytes(content)
    return other


@settings(derandomize=True, max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0.0, 1.0))
@example(place=0.9999)
def test_a_killed_writer_loses_the_chunk_it_was_filling_and_no_more(recorded, tmp_path, place):
    folder, _, _ = recorded
    content = mcap_file(folder).read_bytes()
    chunks = whole_chunks(mcap_file(folder))
    first, last = chunks[0][0], chunks[-1][0]
    end = first + round(place * (last - first))
    run = read_run(damaged(folder, tmp_path, content[:end]))
    assert not run.complete
    held = max(time for chunk_end, time in chunks if chunk_end <= end) // PERIOD_NS
    reached = next((time for chunk_end, time in chunks if chunk_end >= end), chunks[-1][1]) // PERIOD_NS
    assert held - 2 <= run.cycles() <= held + 1
    assert reached - run.cycles() < 1000
    whole = read_run(folder)
    for topic, rows in run.servo.items():
        assert rows.tobytes() == whole.servo[topic][: len(rows)].tobytes()
    assert len(evaluate(run).errors) == run.cycles()


@settings(derandomize=True, max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0.0, 1.0))
@example(place=0.0)
def test_a_file_cut_before_its_first_chunk_holds_no_run(recorded, tmp_path, place):
    folder, _, _ = recorded
    content = mcap_file(folder).read_bytes()
    end = round(place * (whole_chunks(mcap_file(folder))[0][0] - 1))
    with pytest.raises(InputError, match=r"bag .*damaged"):
        evaluate(read_run(damaged(folder, tmp_path, content[:end])))


@settings(derandomize=True, max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7), part=st.integers(0, 2))
def test_a_damaged_file_is_refused_or_read_up_to_the_damage_but_never_read_wrongly(
    recorded, tmp_path, place, bit, part
):
    """Parts: the declarations at the start, the chunks, and the summary at the end."""
    folder, _, _ = recorded
    whole = read_run(folder)
    content = bytearray(mcap_file(folder).read_bytes())
    chunks = whole_chunks(mcap_file(folder))
    borders = [0, 30_000, chunks[-1][0], len(content)]
    content[int(borders[part] + place * (borders[part + 1] - borders[part]))] ^= 1 << bit
    try:
        run = read_run(damaged(folder, tmp_path, content))
    except InputError:
        return
    for topic, rows in run.servo.items():
        if topic in whole.servo:
            assert rows.tobytes() == whole.servo[topic][: len(rows)].tobytes()


@pytest.mark.parametrize("content", [b"", b"not a bag", b"\x89MCAP0\r\n", bytes(1000), b"\x89MCAP0\r\n" + bytes(1000)])
def test_what_is_not_a_bag_is_refused(tmp_path, content):
    with pytest.raises(InputError, match=r"bag .*damaged_0.mcap: not an MCAP file"):
        read_run(damaged(None, tmp_path, content))


@pytest.mark.parametrize("name", ["missing", "missing.mcap", "."])
def test_where_there_is_no_bag_it_says_so(tmp_path, name):
    with pytest.raises(InputError, match=r"no .mcap file there"):
        read_run(tmp_path / name)


def test_a_cycle_that_is_not_in_the_bag_is_named(recorded, tmp_path):
    _, written, _ = recorded
    with BagWriter(tmp_path / "gap", RECORDED) as bag:
        for topic, time, data in written:
            if (topic, time) != ("u2/command", 70 * PERIOD_NS):
                bag.write(topic, time, data)
    with pytest.raises(InputError, match=r"bag .*gap: /u2/command: cycle 70 is missing \(found 71\)"):
        read_run(tmp_path / "gap")


def test_messages_of_another_length_are_refused(recorded, tmp_path):
    _, written, _ = recorded
    with BagWriter(tmp_path / "old", RECORDED) as bag:
        for topic, time, data in written[:50]:
            bag.write(topic, time, data[:-8] if topic == "u3/actual" else data)
    with pytest.raises(InputError, match=r"bag .*old: /u3/actual: .* another version"):
        read_run(tmp_path / "old")


def test_equal_runs_make_equal_files(recorded, tmp_path):
    folder, written, _ = recorded
    with BagWriter(tmp_path / "run", RECORDED) as bag:
        write_all(bag, written)
    assert mcap_file(tmp_path / "run").read_bytes() == mcap_file(folder).read_bytes()
    assert (tmp_path / "run/metadata.yaml").read_bytes() == (folder / "metadata.yaml").read_bytes()


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_what_exists_is_not_written_over(tmp_path, kind):
    path = tmp_path / "run"
    path.mkdir() if kind == "folder" else path.write_text("mine")
    with pytest.raises(InputError, match=r"bag .*run exists already"):
        BagWriter(path, RECORDED)
    assert kind == "folder" or path.read_text() == "mine"


def test_a_folder_that_cannot_be_made_is_refused_with_the_reason(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"bag .*run cannot be created: Not a directory"):
        BagWriter(tmp_path / "file" / "run", RECORDED)


def test_a_disk_that_is_full_from_the_start_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "open", lambda path, mode, buffering: open("/dev/full", "wb", buffering))  # noqa: SIM115
    with pytest.raises(InputError, match=r"bag .*run cannot be created: No space left on device"):
        BagWriter(tmp_path / "run", RECORDED)


def test_a_disk_that_fills_up_is_one_fault_and_the_chunks_before_it_stay(recorded, tmp_path, monkeypatch):
    _, written, _ = recorded
    with monkeypatch.context() as patch:
        fill_the_disk(patch)
        bag = BagWriter(tmp_path / "run", RECORDED)
        for action in (lambda: write_all(bag, written), bag.close):
            with pytest.raises(MachineFault, match=r"^bag .*run: No space left on device; [^\n]*stays readable$"):
                action()
    assert mcap_file(tmp_path / "run").stat().st_size == FillingDisk.room
    run = read_run(tmp_path / "run")
    assert not run.complete
    assert run.cycles() > 200
    assert len(evaluate(run).errors) == run.cycles()


def test_a_disk_that_has_room_again_does_not_mix_up_the_file(recorded, tmp_path, monkeypatch):
    """The recorder tells the end of the run after the fault: that must not stand behind half a chunk."""
    _, written, _ = recorded
    with monkeypatch.context() as patch:
        fill_the_disk(patch)
        bag = BagWriter(tmp_path / "run", RECORDED)
        with pytest.raises(MachineFault):
            write_all(bag, written)
        patch.setattr(FillingDisk, "room", 10**9)
        with pytest.raises(MachineFault, match=r"No space left on device"):
            bag.close()
    run = read_run(tmp_path / "run")
    whole = read_run(recorded[0])
    assert run.cycles() > 200
    for topic, rows in run.servo.items():
        assert rows.tobytes() == whole.servo[topic][: len(rows)].tobytes()


def test_the_command_stops_with_one_line_where_the_disk_takes_no_more(tmp_path):
    (tmp_path / "lines.ngc").write_text(LINES)
    done = command(
        *("simulate", tmp_path / "lines.ngc", "--machine", "tripod", "--bag", tmp_path / "run"),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000)),
    )
    assert done.returncode == 1
    assert re.fullmatch(r"pkm_cnc: bag .*run: File too large; what was written before stays readable", one_line(done))
    assert read_run(tmp_path / "run").cycles() > 100
