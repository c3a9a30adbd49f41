"""The codec against the two other implementations of CDR at hand: that of ROS itself, and rosbags."""

import math
import re
import struct
import typing
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

import pkm_cnc_msgs.msg
from pkm_cnc import records, run_messages
from pkm_cnc.messages import codec, deserialize, message, serialize, typestore
from pkm_cnc.nodes.message_types import message_class
from pkm_cnc.topics import SERVO_FRAMES, topics

FRAMES = {**SERVO_FRAMES, "pkm_cnc_msgs/msg/Progress": ""}
TYPES = sorted(FRAMES)
AXES = ("u1", "u2", "u3")
VALUES = {
    "boolean": st.booleans(),
    "bool": st.booleans(),
    "uint32": st.integers(0, 2**32 - 1),
    "uint64": st.integers(0, 2**64 - 1),
    "double": st.floats(),
    "float64": st.floats(),
}
RECORD_FIELDS = {
    "TcpSetpoint": {"position.": "", "velocity.": "v", "acceleration.": "a"},
    "TcpState": {"believed.": "believed_", "position.": "", "tracking_error.": "tracking_error_"},
    "ContourError": {"vector.": ""},
}
"""How the nested fields of a message are written out in its record."""


def leaves(kind):
    """Paths and primitive types of a ROS message class, depth first, as ROS itself tells them."""
    for name, typename in kind.get_fields_and_field_types().items():
        if "/" in typename:
            package, nested = typename.split("/")
            for path, primitive in leaves(message_class(f"{package}/msg/{nested}")):
                yield f"{name}.{path}", primitive
        else:
            yield name, typename


def payload(kind):
    return [(path, primitive) for path, primitive in leaves(kind) if not path.startswith("header.")]


def put(target, path, value):
    *parents, leaf = path.split(".")
    for parent in parents:
        target = getattr(target, parent)
    setattr(target, leaf, value)


def get(target, path):
    for name in path.split("."):
        target = getattr(target, name)
    return target


def bits(value):
    return struct.pack("<d", value) if isinstance(value, float) else int(value)


@st.composite
def samples(draw):
    """Type, stamp in ns, cycle, record, and the same as a message of ROS."""
    typename = draw(st.sampled_from(TYPES))
    kind = message_class(typename)
    time = draw(st.integers(0, 2**31 * 10**9 - 1))
    cycle, *values = [draw(VALUES[primitive]) for _, primitive in payload(kind)]
    ros = kind()
    ros.header.frame_id = FRAMES[typename]
    ros.header.stamp.sec, ros.header.stamp.nanosec = divmod(time, 10**9)
    for (path, _), value in zip(payload(kind), [cycle, *values], strict=True):
        put(ros, path, value)
    return typename, time, cycle, tuple(values), ros


def padded(data):
    """Bytes as they go over the wire, their end padded to four."""
    return data + bytes(-len(data) % 4)


@settings(derandomize=True, max_examples=150, deadline=None)
@given(samples())
def test_ros_reads_what_the_codec_packs(sample):
    typename, time, cycle, values, ros = sample
    received = deserialize_message(codec(typename, FRAMES[typename]).pack(cycle, time, values), type(ros))
    assert received.header == ros.header
    assert [bits(get(received, path)) for path, _ in payload(type(ros))] == [bits(value) for value in (cycle, *values)]


@settings(derandomize=True, max_examples=150, deadline=None)
@given(samples())
def test_the_codec_reads_what_ros_serializes(sample):
    typename, _, cycle, values, ros = sample
    received_cycle, received = codec(typename, FRAMES[typename]).unpack(padded(serialize_message(ros)))
    assert received_cycle == cycle
    assert [bits(value) for value in received] == [bits(value) for value in values]


@settings(derandomize=True, max_examples=150, deadline=None)
@given(samples())
def test_the_codec_packs_what_rosbags_packs_so_that_every_padding_byte_is_zero(sample):
    typename, time, cycle, values, ros = sample
    packed = codec(typename, FRAMES[typename]).pack(cycle, time, values)
    read = typestore().deserialize_cdr(packed, typename)
    assert [bits(get(read, path)) for path, _ in payload(type(ros))] == [bits(value) for value in (cycle, *values)]
    assert packed == padded(bytes(typestore().serialize_cdr(read, typename)))


@pytest.mark.parametrize("typename", TYPES)
def test_padding_is_zero_where_ros_has_none_of_its_own(typename):
    """With every bit of every field set, a byte that is still zero is padding, or of the stamp, or of the frame."""
    ours = codec(typename, FRAMES[typename])
    kinds = [primitive for _, primitive in payload(message_class(typename))]
    full = {"uint32": 2**32 - 1, "boolean": True, "double": struct.unpack("<d", b"\xff" * 8)[0]}
    packed = ours.pack(2**64 - 1, 0, [full[kind] for kind in kinds[1:]])
    size = {"uint64": 8, "double": 8, "uint32": 4, "boolean": 1}
    assert packed.count(b"\xff") == sum(size[kind] for kind in kinds if kind != "boolean")
    header = 4 + 8 + 4 + len(FRAMES[typename]) + 1
    fields = sum(size[kind] for kind in kinds)
    assert packed[header:].count(b"\0") == len(packed) - header - fields


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.sampled_from(TYPES), st.lists(st.integers(0, 2**63), min_size=1, max_size=5))
def test_many_messages_are_read_at_once_as_one_array(typename, cycles):
    ours = codec(typename, FRAMES[typename])
    paths = [path for path, _ in payload(message_class(typename))]
    packed = [ours.pack(cycle, cycle % 10**9, [place % 2 for place in range(len(paths) - 1)]) for cycle in cycles]
    rows = np.frombuffer(b"".join(packed), ours.dtype)
    assert list(rows.dtype.names) == paths
    assert rows["cycle"].tolist() == cycles
    for place, path in enumerate(paths[1:]):
        assert rows[path].tolist() == [place % 2] * len(cycles)


@settings(derandomize=True, max_examples=60, deadline=None)
@given(samples())
def test_an_end_without_padding_is_read_too(sample):
    """As a typed publisher of ROS sends it."""
    typename, _, cycle, values, ros = sample
    received_cycle, received = codec(typename, FRAMES[typename]).unpack(serialize_message(ros))
    assert received_cycle == cycle
    assert [bits(value) for value in received] == [bits(value) for value in values]


@pytest.mark.parametrize("typename", TYPES)
@pytest.mark.parametrize("change", [-4, -1, 1, 4])
def test_another_length_is_refused_with_both_lengths(typename, change):
    ours = codec(typename, FRAMES[typename])
    packed = ours.pack(0, 0, [0] * (len(payload(message_class(typename))) - 1))
    wrong = packed[:change] if change < 0 else packed + bytes(change)
    with pytest.raises(ValueError, match=f"{typename}: {len(wrong)} bytes received, {len(packed)} expected"):
        ours.unpack(wrong)


def test_another_frame_is_refused():
    values = [0.0] * 11 + [0, 0]
    packed = codec("pkm_cnc_msgs/msg/TcpSetpoint", "base_lonk").pack(0, 0, values)
    with pytest.raises(ValueError, match=r"base_lonk.*base_link"):
        codec("pkm_cnc_msgs/msg/TcpSetpoint", "base_link").unpack(packed)


def test_a_type_without_fixed_size_has_no_codec():
    with pytest.raises(ValueError, match=r"RunInfo.machine: not of fixed size"):
        codec("pkm_cnc_msgs/msg/RunInfo", "")


@pytest.mark.parametrize("typename", sorted(SERVO_FRAMES))
def test_a_record_has_the_fields_of_its_message_in_order(typename):
    name = typename.rpartition("/")[2]
    record = getattr(records, name)
    kind = message_class(typename)
    written_out = []
    for path, _ in payload(kind)[1:]:
        for nested, prefix in RECORD_FIELDS.get(name, {}).items():
            path = re.sub(f"^{re.escape(nested)}", prefix, path)
        written_out.append(path)
    assert list(record._fields) == written_out
    python = {"double": float, "uint32": int}
    assert list(typing.get_type_hints(record).values()) == [python[primitive] for _, primitive in payload(kind)[1:]]


def test_the_records_of_the_topic_table_are_those_of_its_types():
    for topic in topics(AXES).values():
        if topic.record is not None:
            assert topic.typename == f"pkm_cnc_msgs/msg/{topic.record.__name__}"


def test_constants_are_those_of_the_messages():
    for name in ("PHASE_MOVE", "PHASE_HOLD", "PHASE_END"):
        assert getattr(records, name) == getattr(pkm_cnc_msgs.msg.TcpSetpoint, name)
    for name in ("STATUS_NORMAL", "STATUS_TRAVEL_END"):
        assert getattr(records, name) == getattr(pkm_cnc_msgs.msg.AxisState, name)
    assert (run_messages.LINE, run_messages.ARC) == (
        pkm_cnc_msgs.msg.ToolpathSegment.KIND_LINE,
        pkm_cnc_msgs.msg.ToolpathSegment.KIND_ARC,
    )


def test_every_field_of_every_message_tells_its_meaning():
    for path in Path(get_package_share_directory("pkm_cnc_msgs"), "msg").glob("*.msg"):
        for line in path.read_text(encoding="utf-8").splitlines():
            declaration, _, comment = line.partition("#")
            told = declaration.strip() in ("", "std_msgs/Header header", "uint64 cycle") or "=" in declaration
            if not told:
                assert comment.strip(), f"{path.name}: {line}"


@pytest.mark.parametrize("typename", sorted({topic.typename for topic in topics(AXES).values()}))
def test_the_type_store_and_ros_have_the_same_types(typename):
    """And what is left out is zero, empty or false, but where ROS has a default of its own."""
    kind = message_class(typename)
    expected = kind()
    if typename == "geometry_msgs/msg/PoseStamped":
        expected.pose.orientation.w = 0.0
    assert deserialize_message(serialize(message(typename)), kind) == expected
    assert typestore().hash_rihs01(typename) == type_hash(kind)


def type_hash(kind):
    folder = Path(get_package_share_directory(kind.__module__.split(".")[0]), "msg")
    return re.search(r"RIHS01_[0-9a-f]{64}", (folder / f"{kind.__name__}.json").read_text(encoding="utf-8")).group()


def test_slower_messages_cross_to_ros_and_back():
    end = run_messages.End(1841, "u2/servo_drive", "following error 20.1 mm", 1)
    data = run_messages.run_end(end, 1_841_000_000)
    ros = deserialize_message(data, pkm_cnc_msgs.msg.RunEnd)
    assert (ros.header.stamp.sec, ros.header.stamp.nanosec) == (1, 841_000_000)
    assert (ros.cycle, ros.completed, ros.node, ros.reason) == (1841, False, "u2/servo_drive", end.reason)
    assert run_messages.end_of(serialize_message(ros)) == end


def test_text_that_is_not_ascii_survives():
    text = "ä µm ⌀"
    data = serialize(message("std_msgs/msg/String", data=text))
    ros = deserialize_message(data, message_class("std_msgs/msg/String"))
    assert ros.data == text
    assert deserialize(serialize_message(ros), "std_msgs/msg/String").data == text


def test_a_field_that_a_message_does_not_have_is_refused():
    with pytest.raises(ValueError, match="has no field feedrate"):
        message("pkm_cnc_msgs/msg/Progress", feedrate=math.inf)
