"""Maps of the workspace: contour error of a star at every pivot of a grid, condition, velocity gain."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from pkm_cnc.array_path import linear
from pkm_cnc.config import Setup, setup_from_text
from pkm_cnc.contour import star_program
from pkm_cnc.errors import InputError
from pkm_cnc.experiments._machine import place, resting
from pkm_cnc.experiments._star_array import LineMotion, StarErrors, line_motion, star_errors
from pkm_cnc.experiments._workers import starting_workers
from pkm_cnc.experiments.experiment import Experiment, Findings, Lab
from pkm_cnc.parameters import parameter
from pkm_cnc.report.figure import Array, Curve, Figure, Map, Panel, Table

__all__ = ["EXPERIMENT"]

STARS = (
    "Error of a star: largest size over the headings of the mean contour error over the middle half of each line, in "
    "the plane and in z. Lines begin at rest; the drives are computed by the exact array path, and some lines nearest "
    "to the start pose are run once more as a part program. A pivot with a line that cannot be run is left out, the "
    "table says why."
)
GAINS = (
    "Condition number of J = du/dP: 1 isotropic, infinite singular. Velocity gain: speed of the fastest drive per "
    "speed of the TCP, in the direction of the plane in which it is largest. Both at the pose itself, geometry alone."
)
X, Y = "x (mm)", "y (mm)"
CHECKED = 4
"""Lines, about, that are run as a part program to compare with."""


@dataclass(frozen=True)
class Options:
    """The grid about the start pose, the star at each of its points, and where it is computed."""

    half_width: float = parameter(150.0, "half the width of the square grid about the start pose", unit="mm", above=0.0)
    points: int = parameter(41, "points of the grid in each direction", minimum=2, maximum=1001)
    headings: tuple[float, ...] = parameter(
        tuple(float(heading) for heading in range(0, 360, 15)),
        "headings of the lines of each star: first:last:step or a comma list",
        unit="deg",
        minimum=-3600.0,
        maximum=3600.0,
        any_length=True,
    )
    feed: float = parameter(6000.0, "feed of the lines", unit="mm/min", above=0.0)
    length: float = parameter(200.0, "length of each line", unit="mm", above=0.0)
    jobs: int = parameter(
        -1, "processes that share the work, -1 = one for each core; the result is the same", minimum=-1
    )
    cluster: str = parameter(
        "", "address of a Dask scheduler to compute on, e.g. tcp://host:8786; needs the extra cluster"
    )


@dataclass(frozen=True)
class Grid:
    """The pivots in part-program coordinates, mm, and where their origin lies in base_link, m."""

    x: Array
    y: Array
    zero: Array

    def row(self, y: float) -> Array:
        """The pivots of one row in base_link, (nx, 3), m."""
        return np.asarray(self.zero + 1e-3 * np.stack([self.x, np.full_like(self.x, y), 0.0 * self.x], axis=1))


@dataclass(frozen=True)
class Stars:
    """Mean errors by pivot and heading, um, (ny, nx, n), NaN where a line of the star cannot be run, and why."""

    by_heading: dict[str, Array]
    """`left` and `up`."""
    reasons: Counter[str]

    @property
    def left(self) -> Array:
        """Largest size over the headings in the plane, (ny, nx)."""
        return np.asarray(np.abs(self.by_heading["left"]).max(axis=-1))

    @property
    def up(self) -> Array:
        """Largest size over the headings in z, (ny, nx)."""
        return np.asarray(np.abs(self.by_heading["up"]).max(axis=-1))


def _run(lab: Lab, options: Options) -> Findings:
    if options.jobs == 0:
        raise InputError("--jobs: 0 processes do no work: from 1 on, or -1 for one for each core")
    setup = lab.setup(resting(lab.setup()))
    grid = _grid(setup, options)
    gains = _gains(setup, grid)
    if len(grid.y) == 1:
        remark = f"{setup.machine_name} moves its TCP in x only: no stars can be run."
        return Findings(
            _gain_tables(gains), [_gain_figure(setup, grid, gains)], _gain_data(grid, gains), [GAINS, remark]
        )
    linear(setup)
    stars = _stars(lab, setup, grid, options)
    lab.tell(0.98, "one star as a part program")
    checked = _checked(lab, setup, grid, stars, options)
    return Findings(
        [*_star_tables(grid, stars, checked), *_gain_tables(gains)],
        [_star_figure(setup, grid, stars, options), _gain_figure(setup, grid, gains)],
        {**_gain_data(grid, gains), **_star_data(stars, checked)},
        [STARS, GAINS],
    )


def _grid(setup: Setup, options: Options) -> Grid:
    """About the start pose; a machine that does not move in y has the one row y = 0."""
    moved = setup.kinematics.coordinates
    if "x" not in moved:
        raise InputError(
            f"experiment workspace-map: it needs a machine that moves its TCP in x; has {', '.join(moved)}"
        )
    offsets = np.linspace(-options.half_width, options.half_width, options.points)
    x, y, _ = (1e3 * (start - zero) for start, zero in zip(setup.start_pose, setup.program_zero, strict=True))
    zero = np.array([*setup.program_zero[:2], setup.start_pose[2]])
    return Grid(x + offsets, y + offsets if "y" in moved else np.array([y]), zero)


def _gains(setup: Setup, grid: Grid) -> dict[str, Array]:
    """Condition number of J, and largest speed of a drive per speed of the TCP in the plane, (ny, nx); NaN outside."""
    rows = np.stack([grid.row(y) for y in grid.y]).reshape(-1, 3)
    outside = {violation.row for violation in setup.machine.violations(rows)}
    inside = np.array([row not in outside for row in range(len(rows))])
    condition, gain = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    if inside.any():
        condition[inside] = 1.0 / setup.machine.reciprocal_condition(rows[inside])
        in_plane = setup.machine.jacobian(rows[inside])[..., :2]
        gain[inside] = np.sqrt((in_plane**2).sum(axis=-1)).max(axis=-1)
    shape = len(grid.y), len(grid.x)
    return {"condition_number": condition.reshape(shape), "velocity_gain": gain.reshape(shape)}


def _stars(lab: Lab, setup: Setup, grid: Grid, options: Options) -> Stars:
    from joblib import Parallel, delayed

    motion = line_motion(setup, 1e-3 * options.length, options.feed / 60e3)
    text = setup.to_yaml()
    tasks = (delayed(_row)(text, grid.row(y), options.headings, motion) for y in grid.y)
    rows: list[list[StarErrors]] = []
    with _backend(options):
        with starting_workers():
            computed = Parallel(return_as="generator")(tasks)
        for row in computed:
            rows.append(row)
            lab.tell(0.98 * len(rows) / len(grid.y), f"row {len(rows)} of {len(grid.y)}")

    by_heading = {
        part: np.array([[1e6 * getattr(errors, part) for errors in row] for row in rows]) for part in ("left", "up")
    }
    reasons = Counter(errors.reason for row in rows for errors in row if errors.reason)
    return Stars(by_heading, reasons)


@contextmanager
def _backend(options: Options) -> Iterator[None]:
    """Where joblib runs its tasks: processes of this computer, or a Dask cluster."""
    from joblib import parallel_config

    if not options.cluster:
        with parallel_config(backend="loky", n_jobs=options.jobs, inner_max_num_threads=1):
            yield
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--cluster: Dask is not installed: pip install pkm_cnc[cluster]") from None
    try:
        client: Any = Client(options.cluster, timeout=10.0)
    except (OSError, ValueError) as error:
        raise InputError(f"--cluster: {options.cluster} does not answer: {error}") from None
    with client, parallel_config(backend="dask"):
        yield


@functools.lru_cache(maxsize=1)
def _setup(text: str) -> Setup:
    return setup_from_text(text)


def _row(text: str, pivots: Array, headings: Sequence[float], motion: LineMotion) -> list[StarErrors]:
    """The stars of one row of the grid; the machine comes as the text of its file, which any process can read."""
    return [star_errors(_setup(text), pivot, headings, motion) for pivot in pivots]


def _checked(lab: Lab, setup: Setup, grid: Grid, stars: Stars, options: Options) -> dict[str, Any] | None:
    """The star nearest to the start pose, the middle of the grid, run as a part program; None if none can be run."""
    if np.isnan(stars.left).all():
        return None
    x, y = grid.x - grid.x.mean(), grid.y - grid.y.mean()
    distance = np.where(np.isnan(stars.left), np.inf, np.hypot(x, y[:, None]))
    row, column = np.unravel_index(int(distance.argmin()), distance.shape)
    pivot = float(grid.x[column]), float(grid.y[row])
    some = slice(None, None, max(1, len(options.headings) // CHECKED))
    text = star_program(options.feed, options.headings[some], pivot, options.length)
    summaries = lab.run(setup, text, f"star about {place(pivot)}").evaluation.summaries.values()
    left, up = (1e6 * np.array([getattr(summary, f"{part}_mean") for summary in summaries]) for part in ("left", "up"))
    differences = [
        np.abs(run - stars.by_heading[part][row, column, some]).max() for part, run in (("left", left), ("up", up))
    ]
    return {
        "pivot_mm": pivot,
        "headings_deg": options.headings[some],
        "left_um": left,
        "z_um": up,
        "difference_um": float(max(differences)),
    }


def _star_tables(grid: Grid, stars: Stars, checked: dict[str, Any] | None) -> list[Table]:
    rows: list[list[str | float | None]] = []
    for name, values in (("in the plane", stars.left), ("z", stars.up)):
        if not np.isnan(values).all():
            row, column = np.unravel_index(int(np.nanargmax(values)), values.shape)
            worst = place((float(grid.x[column]), float(grid.y[row])))
            rows.append([name, *(float(each(values)) for each in (np.nanmin, np.nanmedian, np.nanmax)), worst])
    reasons: list[list[str | float | None]] = [["run", int(np.isfinite(stars.left).sum())]]
    reasons += [[reason, count] for reason, count in sorted(stars.reasons.items())]
    tables = [
        Table(
            "Error of the stars over the grid", ["part", "smallest_um", "median_um", "largest_um", "largest_at"], rows
        ),
        Table("Pivots", ["what came of it", "pivots"], reasons),
    ]
    if checked is not None:
        title = f"Lines about {place(checked['pivot_mm'])} as a part program"
        title += f": at most {checked['difference_um']:.2g} um from the map's"
        lines = zip(*(np.array(checked[key]).tolist() for key in ("headings_deg", "left_um", "z_um")), strict=True)
        tables.append(Table(title, ["heading_deg", "left_um", "z_um"], list(lines)))
    return tables


def _star_figure(setup: Setup, grid: Grid, stars: Stars, options: Options) -> Figure:
    title = f"{setup.machine_name}: error of a star of {len(options.headings)} lines, {options.feed:g} mm/min"
    panels = [
        Panel(name, X, Y, map=Map(grid.x, grid.y, values, label), equal=True)
        for name, label, values in (
            ("In the plane", "largest |left| (um)", stars.left),
            ("In z", "largest |z| (um)", stars.up),
        )
    ]
    return Figure(
        "workspace-error", title, panels, f"Each point is the middle of lines of {options.length:g} mm.", columns=2
    )


def _gain_tables(gains: dict[str, Array]) -> list[Table]:
    rows: list[list[str | float | None]] = [
        [name.replace("_", " "), *(float(each(values)) for each in (np.nanmin, np.nanmedian, np.nanmax))]
        for name, values in gains.items()
        if not np.isnan(values).all()
    ]
    return [Table("The machine over the grid", ["", "smallest", "median", "largest"], rows)]


def _gain_figure(setup: Setup, grid: Grid, gains: dict[str, Array]) -> Figure:
    titles = {"condition_number": "Condition number of J (1)", "velocity_gain": "Largest |du/dx| (m/s per m/s)"}
    panels = []
    for name, label in titles.items():
        if len(grid.y) == 1:
            panels.append(Panel(label, X, label, [Curve(name.replace("_", " "), grid.x, gains[name][0])]))
        else:
            panels.append(Panel(label, X, Y, map=Map(grid.x, grid.y, gains[name], label), equal=True))
    caption = "Where the gain is high the drives are fast for a given feed; empty = out of reach."
    return Figure("workspace-gain", f"{setup.machine_name}: workspace with the local gain", panels, caption, columns=2)


def _gain_data(grid: Grid, gains: dict[str, Array]) -> dict[str, Any]:
    return {"x_mm": grid.x, "y_mm": grid.y, **gains}


def _star_data(stars: Stars, checked: dict[str, Any] | None) -> dict[str, Any]:
    reasons = dict(sorted(stars.reasons.items()))
    return {"left_um": stars.left, "z_um": stars.up, "not_run": reasons, "checked": checked}


EXPERIMENT = Experiment(
    name="workspace-map",
    question="Where in the workspace is the contour error of a star large, and how fast must the drives be there? "
    "(thesis figs 6-17 to 6-22 for any pivot; condition and velocity gain of any machine)",
    machine="tripod",
    options=Options,
    run=_run,
)
