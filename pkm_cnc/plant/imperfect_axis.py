"""An axis with what a real one has: friction, backlash, compliance, pitch error, limits, dead time, loads.

Between two ticks of the servo clock it is integrated in steps. In a step the axis is one of few linear systems -
current or voltage at a limit or neither, slider on a flank of the screw or on none, stuck or sliding - whose exact
solution (matrix exponential) is known beforehand; which one it is, and every force that is no linear function of the
state, is decided at the step's beginning. So the error falls with the length of a step, and without nonlinear effects
there is none.

Anti-windup: an integrator stands still while what it commands is at its limit. A slider whose velocity would change
sign under friction is stopped, and stays where it is until more than the static friction pulls at it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.plant.linear_scale import LinearScale
from pkm_cnc.plant.plant_parameters import (
    DisturbanceParameters,
    FrictionParameters,
    ScaleParameters,
    ScrewParameters,
    SliderParameters,
    TravelParameters,
)
from pkm_cnc.records import STATUS_NORMAL, STATUS_TRAVEL_END, AxisCommand, AxisState
from pkm_cnc.servo import DriveParameters

__all__ = ["DEAD_TIME", "STANDARD_GRAVITY", "AxisParts", "ImperfectAxis", "imperfect"]

STANDARD_GRAVITY = 9.80665
"""m/s^2, ISO 80000-3."""

DEAD_TIME = "drive.dead_time"

FREE, LIMITED_CURRENT, LIMITED_VOLTAGE = range(3)
RIGID, ON_FLANK, NO_FLANK = range(3)

States = tuple[float, float, float, float, float, float, float]
"""Velocity integrator A, current integrator V, current A, motor speed rad/s, its travel m; slider velocity m/s and
position m, which rest where the screw is rigid."""
STATES = 7
Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class AxisParts:
    """The parameters of one axis. `drive.kind` must be cascade."""

    drive: DriveParameters
    screw: ScrewParameters
    slider: SliderParameters
    friction: FrictionParameters
    disturbance: DisturbanceParameters
    scale: ScaleParameters
    travel: TravelParameters


def imperfect(parts: AxisParts) -> str:
    """The first parameter by which an axis is no longer ideal, "" if there is none; of the scale it does not speak."""
    drive, screw, slider, friction, disturbance = (
        parts.drive,
        parts.screw,
        parts.slider,
        parts.friction,
        parts.disturbance,
    )
    values = {
        "drive.back_emf": drive.back_emf,
        "drive.current_limit": drive.current_limit,
        "drive.voltage_limit": drive.voltage_limit,
        "screw.backlash": screw.backlash,
        "screw.stiffness": screw.stiffness,
        "screw.pitch_error": any(screw.pitch_error),
        "slider.mass": slider.mass * math.sin(slider.incline),
        "friction.coulomb": friction.coulomb,
        "friction.static": friction.static,
        "friction.viscous": friction.viscous,
        "disturbance.torque": disturbance.torque,
        "disturbance.cogging": disturbance.cogging,
        DEAD_TIME: drive.dead_time,  # last: an axis with nothing else is a linear one
    }
    return next((name for name, value in values.items() if value), "")


class _Inputs(NamedTuple):
    """Held over a step: command m/s; the limit that rules, A or V; torque N m; force at the slider N; offset m."""

    command: float
    level: float
    torque: float
    force: float
    offset: float


class _Part(NamedTuple):
    """A part of the servo period: its steps, the length of each (s), and how many periods old its command is."""

    steps: int
    length: float
    age: int


class ImperfectAxis:
    """The axis `name` at rest at `start_position` (m) under the force `load` (N, along the travel) of what it carries.

    `steps` a servo period (s). Raises InputError for parts that do not go together and for a start beyond the travel.
    """

    def __init__(
        self, name: str, parts: AxisParts, servo_period: float, steps: int, start_position: float, load: float = 0.0
    ) -> None:
        _refuse(parts, start_position)
        self._parts = parts
        self._turn = parts.screw.pitch / (2.0 * math.pi)
        self._half_backlash = 0.5 * parts.screw.backlash
        self._weight = -parts.slider.mass * STANDARD_GRAVITY * math.sin(parts.slider.incline)
        self._scale = LinearScale(parts.scale, name)
        self._rigid = parts.screw.stiffness == 0.0
        self._systems: dict[tuple[float, int, int, bool], Rows] = {}
        self._schedule, oldest = _schedule(parts.drive.dead_time, servo_period, steps)
        self._commands = deque([0.0] * (oldest + 1), maxlen=oldest + 1)
        self._stuck = parts.friction.breakaway > 0.0
        self._slider = start_position
        self._x = self._at_rest(start_position, load + self._weight)
        self.state = self._state(0.0)
        """The axis at the present instant t_k."""

    def step(self, command: AxisCommand, load: float = 0.0) -> AxisState:
        """Hold `command` and `load` (N) over [t_k, t_k+1), the command late by the dead time; the state at t_k+1.

        Raises MachineFault when the velocity command is not a finite number.
        """
        if not math.isfinite(command.velocity):
            raise MachineFault(f"velocity command {command.velocity} m/s is not a finite number")
        self._commands.appendleft(command.velocity)
        before = self._slider
        for part in self._schedule:
            for _ in range(part.steps):
                self._advance(part.length, self._commands[part.age], load + self._weight)
        velocity = self._x[5] if not self._rigid else (self._turn * self._x[3] if self._slider != before else 0.0)
        self.state = self._state(velocity)
        return self.state

    def _at_rest(self, position: float, force: float) -> States:
        """Everything in balance with `force` at the slider: the motor holds it, the screw is strained by it."""
        drive, screw = self._parts.drive, self._parts.screw
        current = -(self._turn * force + self._parts.disturbance.torque) / drive.torque_constant
        travel = position - screw.error_at(position)
        if self._rigid:
            flank = math.copysign(self._half_backlash, -force) if force else 0.0
            return current, drive.resistance * current, current, 0.0, travel + flank, 0.0, position
        flank = -math.copysign(self._half_backlash, force) - force / screw.stiffness if force else 0.0
        return current, drive.resistance * current, current, 0.0, travel + flank, 0.0, position

    def _advance(self, length: float, command: float, force: float) -> None:
        drive, x = self._parts.drive, self._x
        velocity_integrator, current_integrator, current, speed, travel, slider_velocity, _ = x
        rule, level = FREE, 0.0
        wanted = drive.velocity_gain * (command / self._turn - speed) + velocity_integrator
        if drive.current_limit and abs(wanted) > drive.current_limit:
            rule, level = LIMITED_CURRENT, math.copysign(drive.current_limit, wanted)
            wanted = level
        voltage = drive.current_gain * (wanted - current) + current_integrator
        if drive.voltage_limit and abs(voltage) > drive.voltage_limit:
            rule, level = LIMITED_VOLTAGE, math.copysign(drive.voltage_limit, voltage)
        torque = self._disturbance(travel)
        error = self._parts.screw.error_at(travel)
        contact, offset, pull, velocity = RIGID, 0.0, 0.0, self._turn * speed
        if self._rigid:
            pull = (drive.torque_constant * current + torque) / self._turn
        else:
            contact, offset, pull = self._contact(travel + error, velocity)
            offset += error
            velocity = slider_velocity
        direction, friction = self._friction(velocity, pull + force)
        inputs = _Inputs(command, level, torque, force - direction * friction, offset)
        new = _applied(self._system(length, rule, contact, self._stuck), x, inputs)
        body = 3 if self._rigid else 5
        if direction and new[body] * direction <= 0.0:
            new[body] = 0.0
            self._stuck = True
        self._x = tuple(new)  # type: ignore[assignment]  # as many as before
        self._slider = self._follow(new[4]) if self._rigid else new[6]

    def _follow(self, travel: float) -> float:
        """Where a rigid screw with backlash has the slider: it moves when a flank reaches it."""
        nut = travel + self._parts.screw.error_at(travel)
        return min(max(self._slider, nut - self._half_backlash), nut + self._half_backlash)

    def _contact(self, nut: float, nut_velocity: float) -> tuple[int, float, float]:
        """Whether the slider is on a flank, the offset of that flank, m, and its force on the slider, N."""
        screw, gap = self._parts.screw, nut - self._x[6]
        if self._half_backlash > 0.0 and abs(gap) <= self._half_backlash:
            return NO_FLANK, 0.0, 0.0
        offset = -math.copysign(self._half_backlash, gap)
        force = screw.stiffness * (gap + offset) + screw.damping * (nut_velocity - self._x[5])
        return ON_FLANK, offset, force

    def _friction(self, velocity: float, pull: float) -> tuple[float, float]:
        """Direction in which the slider slides (0: no friction, or stuck), and the friction against it, N."""
        friction = self._parts.friction
        if friction.breakaway == 0.0:
            return 0.0, 0.0
        if self._stuck:
            if abs(pull) <= friction.breakaway:
                return 0.0, 0.0
            self._stuck = False
            return math.copysign(1.0, pull), friction.breakaway
        ratio = velocity / friction.stribeck_velocity
        kinetic = friction.coulomb + (friction.breakaway - friction.coulomb) * math.exp(-ratio * ratio)
        return math.copysign(1.0, velocity if velocity else pull), kinetic

    def _disturbance(self, travel: float) -> float:
        disturbance = self._parts.disturbance
        if disturbance.cogging == 0.0:
            return disturbance.torque
        angle = disturbance.cogging_periods * travel / self._turn
        return disturbance.torque + disturbance.cogging * math.sin(angle)

    def _system(self, length: float, rule: int, contact: int, stuck: bool) -> Rows:
        key = (length, rule, contact, stuck)
        if key not in self._systems:
            self._systems[key] = _discrete(*_equations(self._parts, rule, contact, stuck), length)
        return self._systems[key]

    def _state(self, velocity: float) -> AxisState:
        position, travel = self._slider, self._parts.travel
        return AxisState(
            self._scale.read(position),
            position,
            velocity,
            self._x[3],
            self._x[2],
            self._parts.drive.torque_constant * self._x[2],
            STATUS_NORMAL if travel.minimum < position < travel.maximum else STATUS_TRAVEL_END,
        )


def _applied(rows: Rows, states: States, inputs: _Inputs) -> list[float]:
    """The states a step later. Written out, it takes a third of the time of a loop over the columns."""
    s, t, u, v, w, x, y = states
    command, level, torque, force, offset = inputs
    return [
        (a * s + b * t + c * u + d * v + e * w + f * x + g * y)
        + (h * command + i * level + j * torque + k * force + m * offset)
        for a, b, c, d, e, f, g, h, i, j, k, m in rows
    ]


def _equations(
    parts: AxisParts, rule: int, contact: int, stuck: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(A, B) of dx/dt = A x + B u with the states `States` and the inputs `_Inputs`.

    Each signal is a row: its coefficients over states and inputs, so the lines below are the equations.
    """
    drive, screw = parts.drive, parts.screw
    states, (command, level, disturbance, force, offset) = np.split(np.eye(STATES + 5), [STATES])
    velocity_integrator, current_integrator, current, speed, travel, slider_velocity, slider = states
    zero, turn = np.zeros(STATES + 5), screw.pitch / (2.0 * math.pi)
    speed_error = command / turn - speed
    velocity_integration = drive.velocity_integral * speed_error if rule == FREE else zero
    wanted = drive.velocity_gain * speed_error + velocity_integrator if rule != LIMITED_CURRENT else level
    current_error = wanted - current
    voltage, current_integration = level, zero
    if rule != LIMITED_VOLTAGE:
        voltage = drive.current_gain * current_error + current_integrator
        current_integration = drive.current_integral * current_error
    current_rate = (voltage - drive.resistance * current - drive.back_emf * speed) / drive.inductance
    torque = drive.torque_constant * current + disturbance
    if contact == RIGID:
        force_at_screw = force - parts.friction.viscous * turn * speed
        speed_rate = zero if stuck else (torque + turn * force_at_screw) / drive.inertia
        rows = [velocity_integration, current_integration, current_rate, speed_rate, zero if stuck else turn * speed]
        rows += [zero, zero]
    else:
        strain, strain_rate = travel - slider + offset, turn * speed - slider_velocity
        pull = zero if contact == NO_FLANK else screw.stiffness * strain + screw.damping * strain_rate
        motor_inertia = drive.inertia - parts.slider.mass * turn * turn
        slider_rate = (pull + force - parts.friction.viscous * slider_velocity) / parts.slider.mass
        rows = [velocity_integration, current_integration, current_rate, (torque - turn * pull) / motor_inertia]
        rows += [turn * speed, zero if stuck else slider_rate, zero if stuck else slider_velocity]
    equations = np.array(rows)
    return equations[:, :STATES], equations[:, STATES:]


def _discrete(a: NDArray[np.float64], b: NDArray[np.float64], length: float) -> Rows:
    """The rows of [Ad, Bd] of x[k+1] = Ad x[k] + Bd u[k] for inputs held over `length`, s."""
    from scipy.linalg import expm  # slow to import, and most processes of a graph have no plant

    states, inputs = b.shape
    exponent = np.zeros((states + inputs, states + inputs))
    exponent[:states, :states], exponent[:states, states:] = a, b
    rows: list[list[float]] = expm(exponent * length)[:states].tolist()
    return tuple(map(tuple, rows))


def _schedule(dead_time: float, period: float, steps: int) -> tuple[list[_Part], int]:
    """How a period is run: its first part with an older command where the dead time is no whole number of periods.

    Also the age of the oldest command. Both parts together have `steps` steps, or one more.
    """
    whole = math.floor(dead_time / period * (1.0 + 1e-12))
    late = dead_time - whole * period
    if late <= 1e-9 * period:
        return [_Part(steps, period / steps, whole)], whole
    first = max(1, round(steps * late / period))
    second = max(1, steps - first)
    return [_Part(first, late / first, whole + 1), _Part(second, (period - late) / second, whole)], whole + 1


def _refuse(parts: AxisParts, start_position: float) -> None:
    parts.travel.require(start_position)
    turn = parts.screw.pitch / (2.0 * math.pi)
    if parts.drive.kind != "cascade":
        raise InputError(f"drive.kind: {parts.drive.kind} has no motor for what makes the axis imperfect; take cascade")
    if parts.screw.stiffness > 0.0 and not parts.slider.mass > 0.0:
        raise InputError("slider.mass: 0 kg given; a screw with a stiffness needs a slider with a mass")
    if not parts.slider.mass * turn * turn < parts.drive.inertia:
        raise InputError(
            f"slider.mass: {parts.slider.mass} kg is {parts.slider.mass * turn * turn:.6g} kg m^2 at the shaft, "
            f"not less than drive.inertia, {parts.drive.inertia} kg m^2, which has all of the axis"
        )
