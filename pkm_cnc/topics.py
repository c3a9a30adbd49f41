"""The one table of the graph: which topic carries what, from whom to whom."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from pkm_cnc import records
from pkm_cnc.messages import Codec, codec

__all__ = [
    "ANYONE",
    "BASE_FRAME",
    "CONTOUR_MONITOR",
    "INTERPOLATOR",
    "INVERSE_KINEMATICS",
    "RECORDER",
    "RUN_END",
    "SERVO_FRAMES",
    "STATUS",
    "TCP_CONTROLLER",
    "WAITING",
    "Topic",
    "nodes",
    "recorded_topics",
    "topics",
]

BASE_FRAME = "base_link"
INTERPOLATOR, INVERSE_KINEMATICS = "interpolator", "inverse_kinematics"
CONTOUR_MONITOR, RECORDER = "contour_monitor", "recorder"
TCP_CONTROLLER = "tcp_controller"
"""Only in the graph of a machine whose `tcp_control` is on."""
ANYONE = "*"
RUN_END, WAITING, STATUS = "run_end", "waiting", "status"


SERVO_FRAMES = {
    f"pkm_cnc_msgs/msg/{name}": frame
    for name, frame in {
        "TcpSetpoint": BASE_FRAME,
        "AxisSetpoint": "",
        "AxisCommand": "",
        "AxisCorrection": "",
        "AxisState": "",
        "TcpState": BASE_FRAME,
        "ContourError": BASE_FRAME,
    }.items()
}
"""The message types of the servo rate and the frame that each carries."""


class Topic(NamedTuple):
    """One topic: relative name, message type, constant frame, the node that publishes it and those that must hear it.

    `frame_id` is that of a topic of fixed size; the messages of the others carry their own. `record` is the record of
    a servo-rate topic (one message a cycle), None for everything slower.
    """

    name: str
    typename: str
    frame_id: str
    publisher: str
    subscribers: tuple[str, ...]
    record: type | None = None

    @property
    def recorded(self) -> bool:
        """Whether the bag holds it."""
        return RECORDER in self.subscribers and self.name != WAITING

    @property
    def fixed_size(self) -> bool:
        """Whether it is packed by `codec`: one of the servo rate, or a progress."""
        return self.record is not None or self.typename == _ours("Progress")

    @property
    def codec(self) -> Codec:
        """The codec of a topic of fixed size."""
        return codec(self.typename, self.frame_id)


def nodes(axes: Sequence[str], tcp_control: bool = False) -> tuple[str, ...]:
    """Full names of the nodes of a machine with these axes, relative to its namespace, in the order data flows.

    `tcp_control`: with the controller that looks at the TCP.
    """
    drives = tuple(f"{axis}/{name}" for axis in axes for name in ("servo_drive", "plant"))
    controller = (TCP_CONTROLLER,) if tcp_control else ()
    return (INTERPOLATOR, INVERSE_KINEMATICS, *controller, *drives, CONTOUR_MONITOR, RECORDER)


def topics(axes: Sequence[str], tcp_control: bool = False, coupled: bool = False) -> dict[str, Topic]:
    """The topics of a machine with these axes, by name, in the order data flows; `tcp_control` as of `nodes`.

    `coupled`: every plant hears of all axes, because of what they carry together.
    """
    servo, everyone = _servo_topics(axes, tcp_control, coupled), nodes(axes, tcp_control)
    monitor = (CONTOUR_MONITOR, (RECORDER,))
    table = [
        Topic("run_info", _ours("RunInfo"), "", INTERPOLATOR, (RECORDER,)),
        Topic("toolpath/segment", _ours("ToolpathSegment"), "", INTERPOLATOR, (CONTOUR_MONITOR, RECORDER)),
        Topic("operator/command", _ours("OperatorCommand"), "", INTERPOLATOR, (RECORDER,)),
        Topic("program/event", _ours("ProgramEvent"), "", INTERPOLATOR, (RECORDER,)),
        Topic(STATUS, _ours("ControllerStatus"), "", INTERPOLATOR, (RECORDER,)),
        *servo,
        Topic("contour_monitor/segment_summary", _ours("SegmentSummary"), "", *monitor),
        Topic("joint_states", "sensor_msgs/msg/JointState", "", *monitor),
        Topic("tcp/pose", "geometry_msgs/msg/PoseStamped", "", *monitor),
        Topic("tcp/path", "nav_msgs/msg/Path", "", *monitor),
        Topic("markers", "visualization_msgs/msg/MarkerArray", "", *monitor),
        Topic("contour_monitor/progress", _ours("Progress"), "", CONTOUR_MONITOR, (INTERPOLATOR,)),
        Topic("recorder/progress", _ours("Progress"), "", RECORDER, (INTERPOLATOR,)),
        Topic(RUN_END, _ours("RunEnd"), "", ANYONE, everyone),
        Topic(WAITING, _ours("Waiting"), "", ANYONE, everyone),
    ]
    return {topic.name: topic for topic in table}


def recorded_topics(axes: Sequence[str], tcp_control: bool = False) -> list[Topic]:
    """The topics that a bag holds."""
    return [topic for topic in topics(axes, tcp_control).values() if topic.recorded]


def _servo_topics(axes: Sequence[str], tcp_control: bool, coupled: bool) -> Iterator[Topic]:
    def servo(name: str, record: type, publisher: str, *subscribers: str) -> Topic:
        typename = _ours(record.__name__)
        return Topic(name, typename, SERVO_FRAMES[typename], publisher, (*subscribers, RECORDER), record)

    controller = (TCP_CONTROLLER,) if tcp_control else ()
    yield servo("tcp/setpoint", records.TcpSetpoint, INTERPOLATOR, INVERSE_KINEMATICS, *controller, CONTOUR_MONITOR)
    for axis in axes:
        drive, plant = f"{axis}/servo_drive", f"{axis}/plant"
        yield servo(f"{axis}/setpoint", records.AxisSetpoint, INVERSE_KINEMATICS, *controller, drive)
        yield servo(f"{axis}/command", records.AxisCommand, drive, plant)
        others = [f"{other}/plant" for other in axes if coupled and other != axis]
        yield servo(f"{axis}/actual", records.AxisState, plant, drive, *others, *controller, CONTOUR_MONITOR)
        if tcp_control:
            yield servo(f"{axis}/correction", records.AxisCorrection, TCP_CONTROLLER, drive)
    yield servo("tcp/state", records.TcpState, CONTOUR_MONITOR, *controller)
    yield servo("contour_error", records.ContourError, CONTOUR_MONITOR)


def _ours(name: str) -> str:
    return f"pkm_cnc_msgs/msg/{name}"
