"""What RViz, Foxglove and PlotJuggler show of a run: joint states, pose, path and markers, decimated."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pkm_cnc.kinematics import Machine
from pkm_cnc.messages import message, serialize, stamp
from pkm_cnc.program import Element, Line
from pkm_cnc.records import AxisState, TcpState, Vector
from pkm_cnc.topics import BASE_FRAME

__all__ = ["Visuals"]

STATE_PERIOD_NS = 40_000_000
"""ns of machine time between two joint states and poses: 25 Hz, what an eye follows."""
STATES_PER_DRAWING = 5
"""Joint states between two drawings, which cost more."""
ACTUAL_POINTS = 200
"""Points of the actual path that are kept: the last 8 s."""
PROGRAMMED_ELEMENTS = 200
"""Elements of the programmed path that are kept."""
ARC_STEP = math.radians(5.0)
"""rad between two points by which an arc is drawn."""

LINE_STRIP, LINE_LIST, SPHERE_LIST = 4, 5, 7
GREY, BLUE, ORANGE, GREEN = (0.5, 0.5, 0.5), (0.12, 0.47, 0.71), (1.0, 0.5, 0.05), (0.17, 0.63, 0.17)


class Visuals:
    """Makes the decimated messages of one run. Memory is bounded."""

    def __init__(self, machine: Machine, axes: Sequence[str], servo_period_ns: int) -> None:
        self._machine = machine
        self._axes = list(axes)
        self._period = servo_period_ns
        self._state_cycles = max(1, STATE_PERIOD_NS // servo_period_ns)
        self._drawing_cycles = STATES_PER_DRAWING * self._state_cycles
        self._programmed: deque[list[Vector]] = deque(maxlen=PROGRAMMED_ELEMENTS)
        self._actual: deque[Vector] = deque(maxlen=ACTUAL_POINTS)

    def add(self, element: Element) -> None:
        """Take an element of the programmed contour into the drawing."""
        steps = 1 if isinstance(element, Line) else math.ceil(abs(element.sweep) / ARC_STEP)
        self._programmed.append([element.position(element.length * step / steps) for step in range(steps + 1)])

    def step(self, cycle: int, states: Sequence[AxisState], tcp: TcpState) -> Iterator[tuple[str, bytes]]:
        """The messages due in this cycle: topic and CDR bytes."""
        if cycle % self._state_cycles == 0:
            header = (cycle * self._period, BASE_FRAME)
            self._actual.append((tcp.x, tcp.y, tcp.z))
            yield "joint_states", serialize(self._joint_state(header, states))
            yield "tcp/pose", serialize(_pose(header, self._actual[-1]))
            if cycle % self._drawing_cycles == 0:
                yield "tcp/path", serialize(self._path(header))
                yield "markers", serialize(self._markers(header[0], states, tcp))

    def _joint_state(self, header: tuple[int, str], states: Sequence[AxisState]) -> Any:
        return message(
            "sensor_msgs/msg/JointState",
            header=header,
            name=self._axes,
            position=np.array([state.position for state in states]),
            velocity=np.array([state.slider_velocity for state in states]),
        )

    def _path(self, header: tuple[int, str]) -> Any:
        poses = [_pose(header, point) for point in self._actual]
        return message("nav_msgs/msg/Path", header=header, poses=poses)

    def _markers(self, time: int, states: Sequence[AxisState], tcp: TcpState) -> Any:
        sketch = self._machine.sketch([state.slider_position for state in states], (tcp.x, tcp.y, tcp.z))
        lines: dict[str, list[Any]] = {"column": [], "strut": []}
        outlines, sliders = [], []
        for name, points in sketch:
            kind = name.partition(" ")[0]
            if kind in lines:
                lines[kind] += points.tolist()
            else:
                outlines += [
                    point for pair in zip(points[:-1].tolist(), points[1:].tolist(), strict=True) for point in pair
                ]
            if kind == "strut":
                sliders.append(points[0].tolist())
        programmed = [point for line in self._programmed for pair in itertools.pairwise(line) for point in pair]
        drawings = [
            ("frame", LINE_LIST, 0.01, GREY, lines["column"]),
            ("sliders", SPHERE_LIST, 0.05, BLUE, sliders),
            ("struts", LINE_LIST, 0.01, BLUE, lines["strut"]),
            ("platform", LINE_LIST, 0.008, BLUE, outlines),
            ("programmed path", LINE_LIST, 0.002, GREEN, programmed),
            ("actual path", LINE_STRIP, 0.001, ORANGE, list(self._actual)),
        ]
        return message(
            "visualization_msgs/msg/MarkerArray",
            markers=[_marker(time, *drawing) for drawing in drawings],
        )


def _pose(header: tuple[int, str], point: Vector) -> Any:
    return message(
        "geometry_msgs/msg/PoseStamped",
        header=header,
        pose=message(
            "geometry_msgs/msg/Pose",
            position=_point(point),
            orientation=message("geometry_msgs/msg/Quaternion", w=1.0),
        ),
    )


def _point(point: Sequence[float]) -> Any:
    return message("geometry_msgs/msg/Point", x=point[0], y=point[1], z=point[2])


def _marker(time: int, name: str, kind: int, width: float, color: Vector, points: Sequence[Sequence[float]]) -> Any:
    red, green, blue = color
    return message(
        "visualization_msgs/msg/Marker",
        header=message("std_msgs/msg/Header", stamp=stamp(time), frame_id=BASE_FRAME),
        ns=name,
        type=kind,
        pose=message("geometry_msgs/msg/Pose", orientation=message("geometry_msgs/msg/Quaternion", w=1.0)),
        scale=message("geometry_msgs/msg/Vector3", x=width, y=width, z=width),
        color=message("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        points=[_point(point) for point in points],
    )
