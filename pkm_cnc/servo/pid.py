"""The PID controller: its three forms, as a continuous system, and sampled with a limited output.

Thesis eq. 2-3..2-5 and table 2-1, for an error e and an output u:

    ideal       u = K (e + 1/Ti int e + Td de/dt)
    parallel    u = K e + 1/Ti int e + Td de/dt
    serial      u = K (1 + Td d/dt) (e + 1/Ti int e)

2-5 prints the second factor with the error inside; it is an operator on the first. Multiplied out, each is

    u = P e + I int e + D de/dt,

and these three gains are what a controller needs; the forms are three ways to write them. In every form the derivative
is filtered by 1/(1 + s filter_time), the other two parts are not. The cascade states its gains directly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.errors import InputError
from pkm_cnc.tolerances import EQUAL_TIMES

__all__ = ["PID_FORMS", "Controller", "Pid", "PidController", "PidGains", "SampledPid"]

Array = NDArray[np.float64]

PID_FORMS = ("ideal", "parallel", "serial")
"""Eq. 2-3, 2-4 and 2-5."""


class Controller(NamedTuple):
    """dx/dt = A x + B e, u = C x + D e for an error e. Shapes (n, n), (n,), (n,); D is a number."""

    A: Array
    B: Array
    C: Array
    D: float

    def connect(self, error: Array, states: Array) -> tuple[Array, Array]:
        """Output and derivatives of the states, for an error and states given as rows of coefficients.

        Shapes (m,) and (n, m); the result has (m,) and (n, m).
        """
        return self.C @ states + self.D * error, self.A @ states + np.outer(self.B, error)


def _check_not_negative(name: str, value: float) -> None:
    if not 0.0 <= value < math.inf:
        raise InputError(f"PID {name}: {value} is not a finite number of 0 or more")


class SampledPid(NamedTuple):
    """One period of a PID controller, e = e[k]:

    u[k] = proportional e + i[k] + d[k]
    i[k+1] = i[k] + integral e
    d[k] = decay d[k-1] + derivative (e - e[k-1])
    """

    proportional: float
    integral: float
    decay: float
    derivative: float


@dataclass(frozen=True)
class PidGains:
    """P + I/s + D s/(1 + s filter_time).

    Raises InputError for a gain that is negative or not finite, and for a derivative without a filter time.
    """

    proportional: float
    integral: float = 0.0
    derivative: float = 0.0
    filter_time: float = 0.0
    """s."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            _check_not_negative(name, value)
        if self.derivative > 0.0 and self.filter_time == 0.0:
            raise InputError("PID filter_time: 0 s given; a derivative part needs a filter time above 0 s")

    def continuous(self) -> Controller:
        """The states are the integral part and, where there is a derivative, the filtered error."""
        if self.derivative == 0.0:
            return Controller(np.zeros((1, 1)), np.array([self.integral]), np.ones(1), self.proportional)
        rate = 1.0 / self.filter_time
        slope = self.derivative * rate
        return Controller(
            np.diag([0.0, -rate]),
            np.array([self.integral, rate]),
            np.array([1.0, -slope]),
            self.proportional + slope,
        )

    def sampled(self, period: float) -> SampledPid:
        """For an error sampled every `period` (s) and an output held between.

        Forward difference for the integral, so that an output at its limit can still keep the error of this very period
        out of it; backward for the derivative, which never rings, however short the filter time (Tustin's rule does
        below half a period). Both are the rule of Astrom and Hagglund, PID Controllers, 1995, section 3.6.
        """
        memory = self.filter_time + period
        return SampledPid(
            self.proportional, self.integral * period, self.filter_time / memory, self.derivative / memory
        )


@dataclass(frozen=True)
class Pid:
    """A PID controller as it is written down. `form` is one of PID_FORMS.

    The times are in s, in the parallel form in what makes its terms one sum: 1/integral_time is the integral gain and
    derivative_time the derivative gain. integral_time = inf is no integral action, derivative_time = 0 no derivative.
    Raises InputError naming the value that is out of bounds.
    """

    form: str
    gain: float
    integral_time: float = math.inf
    derivative_time: float = 0.0
    filter_time: float = 0.0
    """Of the derivative part, s."""

    def __post_init__(self) -> None:
        if self.form not in PID_FORMS:
            raise InputError(f"PID form: {self.form!r} is not one of {', '.join(PID_FORMS)}")
        if not self.integral_time > 0.0:
            raise InputError(f"PID integral_time: {self.integral_time} is not above 0; inf is no integral action")
        for name in ("gain", "derivative_time", "filter_time"):
            _check_not_negative(name, getattr(self, name))
        _ = self.gains  # refuses a derivative without a filter

    @property
    def gains(self) -> PidGains:
        """The gains of the form multiplied out."""
        integral, derivative = 1.0 / self.integral_time, self.derivative_time
        if self.form == "parallel":
            return PidGains(self.gain, integral, derivative, self.filter_time)
        proportional = self.gain
        if self.form == "serial":
            proportional = self.gain * (1.0 + derivative * integral)
        return PidGains(proportional, self.gain * integral, self.gain * derivative, self.filter_time)

    def to_form(self, form: str) -> Pid:
        """The same controller in another form.

        Raises InputError where there is none: the ideal and the serial form have no integral or derivative part without
        a proportional one, and the zeros of the serial form are real, which takes Ti >= 4 Td of the ideal form. Of the
        two serial forms that then exist, the one with Ti >= Td is returned.
        """
        gain, integral, derivative = self.gains.proportional, self.gains.integral, self.gains.derivative
        if form == "parallel":
            return Pid(form, gain, 1.0 / integral if integral else math.inf, derivative, self.filter_time)
        if gain == 0.0 and (integral or derivative):
            raise InputError(f"PID: without a proportional part there is no {form} form")
        integral_time = gain / integral if integral else math.inf
        derivative_time = derivative / gain if derivative else 0.0
        if form == "serial":
            ratio = 4.0 * derivative_time / integral_time
            if ratio > 1.0 + EQUAL_TIMES:
                raise InputError(
                    f"PID: integral_time {integral_time:.6g} s of the ideal form is below 4 times its derivative_time "
                    f"{derivative_time:.6g} s, so there is no serial form"
                )
            share = 0.5 * (1.0 + math.sqrt(max(0.0, 1.0 - ratio)))
            return Pid(form, gain * share, integral_time * share, derivative_time / share, self.filter_time)
        return Pid(form, gain, integral_time, derivative_time, self.filter_time)


class PidController:
    """A sampled PID controller whose output stays within +-`limit`; a feed-forward is added before the limit.

    Anti-windup by clamping: while the output is at its limit, the integral part takes up no error that would drive it
    further beyond, so the output leaves the limit in the period in which the linear law does, and without a jump. It
    starts with no integral part, and as if the first error had stood before: a derivative part does not kick.
    """

    def __init__(self, pid: SampledPid, limit: float = math.inf) -> None:
        self._pid = pid
        self._limit = limit
        self._integral = 0.0
        self._derivative = 0.0
        self._error: float | None = None

    def step(self, error: float, feed_forward: float = 0.0) -> float:
        """The output for the period that begins with this error."""
        pid, before = self._pid, error if self._error is None else self._error
        self._error = error
        self._derivative = pid.decay * self._derivative + pid.derivative * (error - before)
        wanted = pid.proportional * error + self._integral + self._derivative + feed_forward
        growth = pid.integral * error
        if abs(wanted) > self._limit:
            if wanted * growth < 0.0:
                self._integral += growth
            return math.copysign(self._limit, wanted)
        self._integral += growth
        return wanted
