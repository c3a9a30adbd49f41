"""Step, impulse and ramp responses: first and second order, and the drive as transfer function and as it runs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.errors import InputError
from pkm_cnc.experiments._axis import follow
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.parameters import parameter
from pkm_cnc.report.figure import Curve, Figure, Note, Panel, Table
from pkm_cnc.servo import (
    ResponseFigures,
    TransferFunction,
    impulse_response,
    position_loop,
    ramp_response,
    response_figures,
    step_response,
)

__all__ = ["EXPERIMENT", "Options", "Response"]

Array = NDArray[np.float64]

_SAMPLES = 4001  # of a computed response
_FINENESS = 20  # samples at least in the time constant of what is computed: its figures then hold to 1e-3
_HEIGHT = 1e-3  # m, of the step that the axis is given: far within any limit
MS = 1e3


@dataclass(frozen=True)
class Options:
    """Options of step."""

    time_constant: float = parameter(0.05, "of the first-order system", unit="s", above=0.0)
    natural_frequency: float = parameter(40.0, "omega_n of the second-order system", unit="rad/s", above=0.0)
    damping: float = parameter(0.4, "zeta of the second-order system", unit="1", minimum=0.01, maximum=0.99)
    seconds: float = parameter(1.0, "length of the responses", unit="s", above=0.0, maximum=60.0)
    band: float = parameter(2.0, "half width of the band for the settling time", unit="%", above=0.0, maximum=49.0)


@dataclass(frozen=True)
class Response:
    """Responses (n,) to unit step (1), impulse (1/s) and ramp (s) at `times`, s, and the figures of the first.

    The impulse response of a sampled loop is its mean over the period that follows.
    """

    name: str
    times: Array
    step: Array
    impulse: Array
    ramp: Array
    figures: ResponseFigures

    def area_to_peak(self) -> float | None:
        """Area under the impulse response up to its first return to zero, t_p: 1 + M_p. None if there is no peak."""
        if math.isnan(self.figures.peak_time):
            return None
        after = int(np.argmax((self.impulse <= 0.0) & (self.step > 1.0)))
        share = self.impulse[after - 1] / (self.impulse[after - 1] - self.impulse[after])
        t, h = self.times[: after + 1].copy(), self.impulse[: after + 1].copy()
        t[-1], h[-1] = t[-2] + share * (t[-1] - t[-2]), 0.0
        return float((0.5 * (h[1:] + h[:-1]) * np.diff(t)).sum())

    def to_json(self) -> dict[str, Any]:
        """Figures with units; None where there is none."""
        figures = self.figures
        return {
            "system": self.name,
            "t_d_ms": MS * figures.delay_time,
            "t_r_ms": MS * figures.rise_time,
            "t_p_ms": None if math.isnan(figures.peak_time) else MS * figures.peak_time,
            "t_s_ms": MS * figures.settling_time,
            "M_p_percent": 100.0 * figures.overshoot,
            "e_ss_percent": 100.0 * figures.steady_state_error,
            "impulse_area_to_t_p": self.area_to_peak(),
            "ramp_lag_ms": MS * float(self.times[-1] - self.ramp[-1]),
        }


def _computed(name: str, system: TransferFunction, options: Options) -> Response:
    times = np.asarray(np.linspace(0.0, options.seconds, _SAMPLES), dtype=np.float64)
    step = step_response(system, times)
    figures = response_figures(times, step, 1.0, options.band / 100.0)
    return Response(name, times, step, impulse_response(system, times), ramp_response(system, times), figures)


def _simulated(lab: Lab, options: Options) -> Response:
    """The first axis as it runs: sampled position controller, plant between the ticks."""
    setup = lab.setup()
    axis = next(iter(setup.axes))
    cycles = np.arange(round(options.seconds / setup.servo_period) + 1)
    times = np.asarray(cycles * setup.servo_period, dtype=np.float64)
    if len(times) < 3:
        raise InputError(f"seconds: {options.seconds:g} s hold no three servo periods of {setup.servo_period:g} s")
    step = follow(setup, axis, np.full(len(times), _HEIGHT)).position / _HEIGHT
    speed = _HEIGHT / options.seconds
    ramp = follow(setup, axis, speed * times, speed).position / speed
    impulse = np.diff(step, append=step[-1]) / setup.servo_period
    figures = response_figures(times, step, 1.0, options.band / 100.0)
    return Response(f"{setup.machine_name} {axis}, as it runs", times, step, impulse, ramp, figures)


def _run(lab: Lab, options: Options) -> Findings:
    setup = lab.setup()
    axis, parts = next(iter(setup.axes.items()))
    _require_resolved(options)
    omega, zeta = options.natural_frequency, options.damping
    first = _computed("first order", TransferFunction((1.0,), (options.time_constant, 1.0)), options)
    square = omega * omega
    second = _computed("second order", TransferFunction((square,), (1.0, 2.0 * zeta * omega, square)), options)
    lab.tell(0.3, "drive")
    drive = _computed(f"{setup.machine_name} {axis}, transfer function 7-1", position_loop(parts.drive), options)
    lab.tell(0.6, "simulated drive")
    runs = _simulated(lab, options)
    responses = [first, second, drive, runs]
    entries = [response.to_json() for response in responses]
    damped = omega * math.sqrt(1.0 - zeta * zeta)
    data = {
        "systems": entries,
        "band_percent": options.band,
        "kv_per_s": parts.drive.kv,
        "largest_difference_simulated_to_transfer_function_percent": 100.0
        * float(np.abs(runs.step - np.interp(runs.times, drive.times, drive.step)).max()),
        "closed_form": {
            "first_order": {
                "t_d_ms": MS * options.time_constant * math.log(2.0),
                "t_r_ms": MS * options.time_constant * math.log(9.0),
            },
            "second_order": {
                "t_p_ms": MS * math.pi / damped,
                "M_p_percent": 100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta * zeta)),
            },
        },
    }
    columns = list(entries[0])
    rows: list[list[str | float | None]] = [list(entry.values()) for entry in entries]
    figures = [_typical_figure(second, options), _impulse_figure(first, second), _drive_figure(drive, runs)]
    return Findings([Table("Step responses", columns, rows)], figures, data, _remarks(data, setup.servo_period))


def _require_resolved(options: Options) -> None:
    """Raise InputError if a system is too fast for the samples of its response."""
    shortest = _FINENESS * options.seconds / (_SAMPLES - 1)
    for name, time in (
        ("time_constant", options.time_constant),
        ("natural_frequency", 1.0 / options.natural_frequency),
    ):
        if time < shortest:
            raise InputError(
                f"{name}: {getattr(options, name):g} is too fast to be seen in responses of {options.seconds:g} s: its "
                f"time is {time:.3g} s, below {shortest:.3g} s; take fewer seconds"
            )


def _typical_figure(second: Response, options: Options) -> Figure:
    figures, step = second.figures, second.step
    marks = [("t_d", figures.delay_time), ("t_p", figures.peak_time), ("t_s", figures.settling_time)]
    notes = [
        Note(MS * time, float(np.interp(time, second.times, step)), f"{name} {MS * time:.4g} ms")
        for name, time in marks
    ]
    band = options.band / 100.0
    ends = MS * second.times[[0, -1]]
    curves = [Curve(f"final value +- {options.band:g} %", ends, np.full(2, 1.0 + band), role="programmed")]
    curves += [
        Curve("", ends, np.full(2, 1.0 - band), role="programmed"),
        Curve("step response", MS * second.times, step),
    ]
    title = (
        f"Typical step response: second order, zeta {options.damping:g}, omega_n {options.natural_frequency:g} rad/s"
    )
    return Figure("step_typical", title, [Panel("", "time (ms)", "response (1)", curves, notes=notes)], "Figure 2-2.")


def _impulse_figure(first: Response, second: Response) -> Figure:
    panels = [
        Panel(response.name, "time (ms)", "impulse response (1/s)", [Curve("", MS * response.times, response.impulse)])
        for response in (first, second)
    ]
    caption = "Figure 2-3: the area under the second up to its first zero, t_p, is 1 + M_p."
    return Figure("impulse", "Impulse responses of first and second order", panels, caption, share_x=True)


def _drive_figure(drive: Response, runs: Response) -> Figure:
    panels = []
    for title, label, part in (
        ("Unit step", "response (1)", "step"),
        ("Unit impulse", "response (1/s)", "impulse"),
        ("Unit ramp", "response (s)", "ramp"),
    ):
        curves = [Curve(response.name, MS * response.times, getattr(response, part)) for response in (drive, runs)]
        if part == "ramp":
            curves.insert(0, Curve("setpoint", MS * drive.times, drive.times, role="programmed"))
        panels.append(Panel(title, "time (ms)", label, curves))
    return Figure("step_drive", "Responses of the drive's position loop", panels, "Figure 7-6.", share_x=True)


def _remarks(data: dict[str, Any], servo_period: float) -> list[str]:
    drive, runs = data["systems"][2:]
    difference = data["largest_difference_simulated_to_transfer_function_percent"]
    return [
        "Definitions (thesis 2.2.2, after Ogata): t_d to 50 % of the final value, t_r from 10 % to 90 %, t_p to the "
        f"highest point above it, t_s until it stays within {data['band_percent']:g} %, M_p how far that point is "
        "above it, e_ss setpoint less final value.",
        "Thesis 7.4 gives no overshoot and a delay time of 0.035 s: the time to 50 % of a step is "
        f"{drive['t_d_ms']:.3f} ms, the overshoot {drive['M_p_percent']:.3g} %. The lag behind a ramp is another, "
        f"{drive['ramp_lag_ms']:.3f} ms; 1/Kv = {1e3 / data['kv_per_s']:.3f} ms.",
        f"As it runs, the position controller is sampled every {1e3 * servo_period:g} ms: its step response differs "
        f"from the transfer function's by up to {difference:.3g} %, its t_d is {runs['t_d_ms']:.3f} ms.",
    ]


EXPERIMENT = Experiment(
    name="step",
    question="How do first- and second-order systems and the drive answer a step, an impulse and a ramp? "
    "(thesis 2.2.2 and 7.4: figures 2-2, 2-3, 7-6)",
    machine="tripod",
    options=Options,
    run=_run,
)
