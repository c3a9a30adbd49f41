"""What each imperfect part of a machine does alone to star and circle: the table of docs/imperfect_machine.md.

`python tools/imperfect_effects.py [MACHINE]` (a few minutes). Judged is what `evaluate` judges; "change" is the RMS
of the difference from the perfect machine's contour error, place by place.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pkm_cnc.compensation import nominal, observe
from pkm_cnc.config import Setup, load_setup, setup_from_parameters
from pkm_cnc.contour import circle_program, judged_range, star_program
from pkm_cnc.program import Program, ProgramSource

EFFECTS = {
    "none": (),
    "friction": ("friction.",),
    "backlash, with compliance": ("screw.backlash", "screw.stiffness", "screw.damping", "slider.mass"),
    "compliance": ("screw.stiffness", "screw.damping", "slider.mass"),
    "pitch error": ("screw.error_positions", "screw.pitch_error"),
    "weight and load": ("slider.", "load."),
    "dead time": ("drive.dead_time",),
    "back-EMF, limits": ("drive.back_emf", "drive.current_limit", "drive.voltage_limit"),
    "cogging": ("disturbance.",),
    "scale": ("scale.",),
    "drives that differ": ("u1.", "u2.", "u3.", "slider.mass", "screw.damping"),
    "geometry": ("actual.geometry.",),
    "tilt": ("actual.tilt.",),
    "all": ("",),
}
"""The parameters of the machine file that make each effect, by how their names begin."""
STAR = star_program(6000.0, [0.0, 15.0, 45.0, 75.0], (0.0, 0.0), 200.0)
CIRCLE = circle_program(
    feed_mm_min=3000.0,
    radius_mm=100.0,
    center_mm=(0.0, 0.0),
    direction="ccw",
    overshoot_deg=180.0,
    acceleration_mm_s2=2000.0,
)
SPACING = 1e-4
"""m, along the contour."""


class Errors(NamedTuple):
    """Largest and RMS error, m, and the errors at equal places of the contour (n, 3), m."""

    largest: float
    rms: float
    vectors: NDArray[np.float64]


def errors(setup: Setup, program: Program) -> Errors:
    """The contour errors of a run over what is judged."""
    contour = ProgramSource(program, setup.start_pose, setup.program_zero, setup.motion.rapid, setup.program).toolpath()
    s, vectors = observe(setup, program).error_vectors()
    parts = []
    for element, start in zip(contour.elements, contour.starts, strict=True):
        if element.evaluated:
            places = np.arange(*judged_range(element, start), SPACING)
            parts.append(np.stack([np.interp(places, s, column) for column in vectors.T], axis=1))
    found = np.concatenate(parts)
    sizes = np.sqrt((found**2).sum(axis=1))
    return Errors(float(sizes.max()), float(np.sqrt((sizes**2).mean())), found)


def with_effect(setup: Setup, beginnings: tuple[str, ...]) -> Setup:
    """The perfect machine with those of its imperfect parameters."""
    values = {key: value for key, (value, _) in nominal(setup).parameters.items()}
    for key, (value, _) in setup.parameters.items():
        if any(key.startswith(beginning) for beginning in beginnings):
            values[key] = value
    if beginnings:
        values["plant.steps"] = setup.parameters["plant.steps"][0]
    return setup_from_parameters(values)


def main() -> None:
    """Print the table."""
    setup = load_setup(sys.argv[1] if len(sys.argv) > 1 else "tripod_real")
    programs = [Program("star.ngc", STAR), Program("circle.ngc", CIRCLE)]
    before: list[Errors] = []
    print("| effect | star max | rms | change | circle max | rms | change |\n|---|---|---|---|---|---|---|")
    for name, beginnings in EFFECTS.items():
        row = []
        for index, program in enumerate(programs):
            found = errors(with_effect(setup, beginnings), program)
            before += [found] if not beginnings else []
            change = float(np.sqrt(((found.vectors - before[index].vectors) ** 2).sum(axis=1).mean()))
            row += [f"{1e6 * found.largest:.2f}", f"{1e6 * found.rms:.2f}"]
            row += [f"{1e6 * change:.2f}" if beginnings else "-"]
        print(f"| {name} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
