"""Where on the path of the setpoints the TCP ought to be: behind the setpoint by a first-order lag along the path.

With the setpoints' path length s, the gain Kv of the position loops and the servo period T

    s*[k+1] = s*[k] + Kv T (s[k] - s*[k]),

which is s - v / Kv at a steady speed v, and never before the beginning of the path nor beyond the setpoint.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from pkm_cnc.records import AxisSetpoint, TcpSetpoint, Vector

__all__ = ["LaggingPlace", "Place"]


class Place(NamedTuple):
    """A place on the path: joint positions, m; TCP, m, in `base_link`."""

    joints: tuple[float, ...]
    tcp: Vector


class _Setpoint(NamedTuple):
    """Of one cycle: path length so far, m; path speed, m/s; x, y, z and the joints, m; their velocities, m/s."""

    s: float
    speed: float
    positions: tuple[float, ...]
    velocities: tuple[float, ...]


class LaggingPlace:
    """Follows the setpoints of one run; `kv` in 1/s, `period` in s, their product at most 1.

    Between two setpoints the path is the cubic by path length through both with their directions, for joints and TCP
    alike.
    """

    def __init__(self, kv: float, period: float) -> None:
        self._share = kv * period
        self._path: deque[_Setpoint] = deque()  # from the one at or before the lagging place on
        self._s = 0.0
        self.here: Place | None = None
        """Of this cycle; None before the first."""

    def step(self, tcp: TcpSetpoint, axis_setpoints: Sequence[AxisSetpoint]) -> tuple[Place, Place]:
        """The lagging place of this cycle, whose setpoints are given, and that of the next."""
        joints, rates, _ = zip(*axis_setpoints, strict=True)
        point = (tcp.x, tcp.y, tcp.z)
        s = self._path[-1].s + math.dist(point, self._path[-1].positions[:3]) if self._path else 0.0
        speed = math.sqrt(tcp.vx * tcp.vx + tcp.vy * tcp.vy + tcp.vz * tcp.vz)
        self._path.append(_Setpoint(s, speed, (*point, *joints), (tcp.vx, tcp.vy, tcp.vz, *rates)))
        here = self.here or Place(joints, point)
        self._s += self._share * (s - self._s)
        x, y, z, *later = self._at(self._s)
        self.here = Place(tuple(later), (x, y, z))
        return here, self.here

    def _at(self, s: float) -> Sequence[float]:
        """x, y, z and joints at the path length `s`, which never falls; what lies behind it is forgotten."""
        path = self._path
        while len(path) > 1 and path[1].s <= s:
            path.popleft()
        if len(path) == 1:
            return path[0].positions
        before, after = path[0], path[1]
        length = after.s - before.s
        part = (s - before.s) / length
        time0 = length / before.speed if before.speed else 0.0
        time1 = length / after.speed if after.speed else 0.0
        columns = zip(before.positions, before.velocities, after.positions, after.velocities, strict=True)
        return [_between(part, *column, time0, time1) for column in columns]


def _between(x: float, u0: float, v0: float, u1: float, v1: float, time0: float, time1: float) -> float:
    """u at the part x of the way from u0 to u1: the cubic with the slopes v0 `time0` and v1 `time1` at the ends.

    At rest (a time of 0) a slope is not known: there the curve is the parabola with the other, or the chord.
    """
    rise = u1 - u0
    slope0, slope1 = v0 * time0, v1 * time1
    if time0 == 0.0:
        slope0 = 2.0 * rise - slope1 if time1 else rise
    if time1 == 0.0:
        slope1 = 2.0 * rise - slope0 if time0 else rise
    y = 1.0 - x
    return u0 + x * (x * (3.0 - 2.0 * x) * rise + y * (y * slope0 - x * slope1))
