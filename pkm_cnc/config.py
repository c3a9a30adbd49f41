"""A machine as its YAML file describes it: read, overridden, checked, and written back in full.

The file has the form of a ROS parameter file (`/**: ros__parameters: ...`) and serves as one. Keys are dotted paths:
`machine`, `servo_period`, ..., then sections (`geometry.*`, `motion.*`, `drive.*`, ...). A section that belongs to an
axis may be overridden for one axis by putting the axis in front: `u1.drive.kv`. What the machine truly is where that
differs from what its controller believes stands in the same way under `actual`: `actual.geometry.strut_length`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from pkm_cnc.errors import InputError
from pkm_cnc.kinematics import Machine, in_space, load_kinematics
from pkm_cnc.motion import DriveLimits, LimitParameters, MotionParameters, refuse_long_ramp
from pkm_cnc.parameters import Parameter, Value, parameter, parameters_of, read_section
from pkm_cnc.plant import (
    AxisParts,
    DisturbanceParameters,
    FrictionParameters,
    LoadParameters,
    PlantParameters,
    ScaleParameters,
    ScrewParameters,
    SliderParameters,
    TravelParameters,
    imperfect,
)
from pkm_cnc.program import ProgramParameters
from pkm_cnc.records import NANOSECONDS, Vector
from pkm_cnc.servo import DriveParameters
from pkm_cnc.tcp_control import TcpController, TcpControlParameters

__all__ = [
    "AxisSetup",
    "GraphParameters",
    "Setup",
    "load_setup",
    "machine_files",
    "setup_from_parameters",
    "setup_from_text",
]


@dataclass(frozen=True)
class ControllerParameters:
    """The parameters without a section."""

    servo_period: float = parameter(
        0.001, "servo period T; a whole number of nanoseconds", unit="s", minimum=1e-5, maximum=0.1
    )
    start_pose: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "TCP in base_link at rest in cycle 0", unit="m", minimum=-100.0, maximum=100.0
    )
    program_zero: tuple[float, ...] = parameter(
        (0.0, 0.0, 0.0), "zero of part programs, in base_link", unit="m", minimum=-100.0, maximum=100.0
    )


@dataclass(frozen=True)
class GraphParameters:
    """How the nodes keep together. None of it changes a result."""

    window: int = parameter(
        16,
        "W: the interpolator runs at most this many cycles ahead of the slowest of contour_monitor and recorder; "
        "enough for every process to find work whenever it wakes (with 8 a run of one process per node is a fifth "
        "slower, with 32 no faster), little enough to stop within 20 ms of machine time at 1 kHz",
        unit="cycles",
        minimum=1,
        maximum=1000,
    )
    watchdog: float = parameter(
        5.0,
        "wall time without an awaited input after which a node is declared missing; well above what a busy machine or "
        "a slow disk delays a message by",
        unit="s",
        minimum=0.1,
        maximum=3600.0,
    )


@dataclass(frozen=True)
class TiltParameters:
    """Section `actual.tilt.*`: the platform tilts as it leaves the axis, and the TCP below it is displaced by that.

    Thesis 6.5.2: the struts hold the platform level only if they are alike and their joints have no play.
    """

    about_y: float = parameter(
        0.0,
        "tilt about y for each metre that the TCP is off the axis in x",
        unit="rad/m",
        minimum=-1.0,
        maximum=1.0,
    )
    about_x: float = parameter(
        0.0,
        "tilt about x for each metre that the TCP is off the axis in y",
        unit="rad/m",
        minimum=-1.0,
        maximum=1.0,
    )
    lever: float = parameter(
        0.0,
        "height of the TCP over the centre of the tilt; below: negative",
        unit="m",
        minimum=-10.0,
        maximum=10.0,
    )

    @property
    def active(self) -> bool:
        """Whether the TCP is displaced at all."""
        return self.lever != 0.0 and (self.about_x != 0.0 or self.about_y != 0.0)

    def displaced(self, tcp: NDArray[np.float64]) -> NDArray[np.float64]:
        """The TCP (..., 3), m, of a platform that would have it at `tcp` if it were level; to first order."""
        x, y, z = tcp[..., 0], tcp[..., 1], tcp[..., 2]
        return np.stack((x + self.lever * (self.about_y * x), y - self.lever * (self.about_x * y), z), axis=-1)


ACTUAL_GEOMETRY = "actual.geometry"
ACTUAL_TILT = "actual.tilt"
AXIS_SECTIONS: dict[str, type] = {
    "drive": DriveParameters,
    "screw": ScrewParameters,
    "slider": SliderParameters,
    "friction": FrictionParameters,
    "disturbance": DisturbanceParameters,
    "scale": ScaleParameters,
    "travel": TravelParameters,
    "limits": LimitParameters,
}


@dataclass(frozen=True)
class AxisSetup:
    """One axis: drive, screw, slider, friction, disturbance, linear scale, travel, and limits of its setpoint."""

    drive: DriveParameters
    screw: ScrewParameters
    slider: SliderParameters
    friction: FrictionParameters
    disturbance: DisturbanceParameters
    scale: ScaleParameters
    travel: TravelParameters
    limits: LimitParameters

    @property
    def parts(self) -> AxisParts:
        """What the plant is made of."""
        return AxisParts(self.drive, self.screw, self.slider, self.friction, self.disturbance, self.scale, self.travel)


@dataclass(frozen=True)
class Setup:
    """Everything that a run depends on but the part program. SI units, TCP in base_link.

    `machine` is the nominal one, which the controller knows, for poses in space; `kinematics` the same in its own
    coordinates. `actual` is the one that the drives move: the same object as `machine` unless the file says otherwise.
    """

    machine_name: str
    kinematics: Machine
    machine: Machine
    actual: Machine
    servo_period_ns: int
    start_pose: Vector
    program_zero: Vector
    program: ProgramParameters
    motion: MotionParameters
    graph: GraphParameters
    tcp_control: TcpControlParameters
    plant: PlantParameters
    load: LoadParameters
    tilt: TiltParameters
    axes: dict[str, AxisSetup]
    parameters: dict[str, tuple[Value, Parameter]]
    """All parameters by key, defaults included, each with its description."""

    @property
    def servo_period(self) -> float:
        """Servo period T, s."""
        return self.servo_period_ns / NANOSECONDS

    @property
    def drive_limits(self) -> DriveLimits:
        """What the planner of the motion needs to know of the drives."""
        return DriveLimits.of(self.machine.motion, [axis.limits for axis in self.axes.values()])

    @property
    def coupled(self) -> bool:
        """Whether an axis feels what the others do."""
        return self.load.mass > 0.0

    def imperfect(self, axis: str) -> str:
        """The first parameter by which the plant of `axis` is no longer ideal, "" if there is none."""
        return "load.mass" if self.coupled else imperfect(self.axes[axis].parts)

    def true_tcp(self, joints: ArrayLike) -> NDArray[np.float64]:
        """Where the TCP truly is, (..., 3), m, with the sliders at `joints` (..., n), m. Raises UnreachableError."""
        tcp = self.actual.forward(joints)
        return self.tilt.displaced(tcp) if self.tilt.active else tcp

    def tcp_controller(self) -> TcpController:
        """A controller at the TCP for one run, where `tcp_control` asks for one. Raises InputError."""
        drives = [axis.drive for axis in self.axes.values()]
        return TcpController(self.tcp_control, self.machine, drives, self.servo_period)

    def to_yaml(self) -> str:
        """The machine file that makes this setup again, every default written out."""
        values = {
            key: list(value) if isinstance(value, tuple) else value for key, (value, _) in self.parameters.items()
        }
        return yaml.safe_dump({"/**": {"ros__parameters": _nested(values)}}, sort_keys=False)


def machine_files() -> dict[str, Path]:
    """The machine files that come with the package, by bare name."""
    package = Path(__file__).resolve().parent
    installed = [parent / "share" / "pkm_cnc" / "config" for parent in package.parents]
    source_tree = [package.parent / "config"] if (package.parent / "setup.py").is_file() else []
    candidates = [*source_tree, *installed]
    for folder in candidates:
        if folder.is_dir():
            return {path.stem: path for path in sorted(folder.glob("*.yaml"))}
    return {}


def load_setup(machine: str, overrides: Iterable[str] = ()) -> Setup:
    """Read a machine file by path or bare name, then apply overrides of the form "drive.kv=25".

    Raises InputError naming file, key, value and bound.
    """
    path = machine_files().get(machine, Path(machine))
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        known = ", ".join(machine_files())
        raise InputError(f"machine {machine}: {error.strerror}; by name there are: {known}") from None
    except UnicodeDecodeError:
        raise InputError(f"machine {machine}: not a text file") from None
    try:
        return setup_from_text(text, overrides)
    except InputError as error:
        raise InputError(f"machine {path}: {error}") from None


def setup_from_text(text: str, overrides: Iterable[str] = ()) -> Setup:
    """Build a setup from the text of a machine file and overrides. Raises InputError naming key, value and bound."""
    values = _flat_file(text)
    for override in overrides:
        key, value = _parse_override(override)
        values[key] = value
    return setup_from_parameters(values)


class _UniqueKeys(yaml.SafeLoader):
    """YAML that refuses a key given twice: the last would win without a word."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """As of the base class."""
        seen = set()
        for key, _ in node.value:
            if str(key.value) in seen:
                raise yaml.constructor.ConstructorError(None, None, f"{key.value} is given twice", key.start_mark)
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)


def _flat_file(text: str) -> dict[str, object]:
    try:
        content = yaml.load(text, _UniqueKeys)
    except (yaml.YAMLError, ValueError) as error:  # ValueError: what looks like a date or a number and is none
        raise InputError("not valid YAML: " + " ".join(str(error).split())) from None
    if not isinstance(content, dict) or list(content) != ["/**"] or not isinstance(content["/**"], dict):
        raise InputError("the top level must be '/**:' with 'ros__parameters:' below it")
    parameters = content["/**"].get("ros__parameters")
    if list(content["/**"]) != ["ros__parameters"] or not isinstance(parameters, dict):
        raise InputError("below '/**:' there must be 'ros__parameters:' alone")
    return dict(_flatten(parameters))


def _flatten(tree: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for key, value in values.items():
        *path, leaf = key.split(".")
        branch = tree
        for name in path:
            branch = branch.setdefault(name, {})
        branch[leaf] = value
    return tree


def _parse_override(text: str) -> tuple[str, object]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise InputError(f"--set {text}: must be KEY=VALUE, e.g. drive.kv=25")
    try:
        return key.strip(), yaml.safe_load(value)
    except (yaml.YAMLError, ValueError):
        raise InputError(f"--set {text}: {value!r} is not a value") from None


def setup_from_parameters(values: Mapping[str, object]) -> Setup:
    """Build a setup from parameters by dotted key; what is missing takes its default, but `machine` must be there.

    Raises InputError naming the key and the bound, for unknown keys too.
    """
    if not isinstance(values.get("machine"), str):
        found = repr(values["machine"]) if "machine" in values else "nothing"
        raise InputError(f"machine: {found} given; it must name the kinematics, e.g. tripod")
    name = str(values["machine"])
    kinematics = load_kinematics(name)
    sections: dict[str, Any] = {"": ControllerParameters, "geometry": kinematics.Geometry}
    sections |= {"program": ProgramParameters, "motion": MotionParameters, "graph": GraphParameters}
    sections |= {"tcp_control": TcpControlParameters, "plant": PlantParameters, "load": LoadParameters}
    sections |= {**AXIS_SECTIONS, ACTUAL_TILT: TiltParameters}
    given = _by_section({key: value for key, value in values.items() if key != "machine"}, kinematics.axes, sections)
    common: dict[str, Any] = {
        section: read_section(kind, given.pop(section, {}), f"{section}." if section else "")
        for section, kind in sections.items()
    }
    axes = {}
    own: dict[str, Any] = {}
    for axis in kinematics.axes:
        parts = {section: (common[section], given.pop(f"{axis}.{section}", {})) for section in AXIS_SECTIONS}
        axes[axis] = AxisSetup(
            **{section: _override(base, extra, f"{axis}.{section}.") for section, (base, extra) in parts.items()}
        )
        own |= {
            f"{axis}.{section}": (getattr(axes[axis], section), extra) for section, (_, extra) in parts.items() if extra
        }
    actual = given.pop(ACTUAL_GEOMETRY, {})
    for spec in parameters_of(kinematics.Geometry):
        if spec.decided and spec.name in actual:
            raise InputError(
                f"{ACTUAL_GEOMETRY}.{spec.name}: the controller decides it, the actual machine has none of its own; "
                f"set geometry.{spec.name}"
            )
    actual_geometry = _override(common["geometry"], actual, f"{ACTUAL_GEOMETRY}.")
    if actual:
        own[ACTUAL_GEOMETRY] = (actual_geometry, actual)
    nominal = _machine(kinematics, common["geometry"], "")
    machine = in_space(nominal)
    controller, motion, graph = common[""], common["motion"], common["graph"]
    period = round(controller.servo_period * NANOSECONDS)
    if abs(period - controller.servo_period * NANOSECONDS) > 1e-3:  # ns; decimals read as a double miss it by less
        raise InputError(f"servo_period: {controller.servo_period} s is not a whole number of nanoseconds")
    refuse_long_ramp("motion", motion)
    for axis, axis_setup in axes.items():
        refuse_long_ramp(f"{axis}.limits", axis_setup.limits)
    setup = Setup(
        machine_name=name,
        kinematics=nominal,
        machine=machine,
        actual=in_space(_machine(kinematics, actual_geometry, "actual.")) if actual else machine,
        servo_period_ns=period,
        start_pose=controller.start_pose,
        program_zero=controller.program_zero,
        program=common["program"],
        motion=motion,
        graph=graph,
        tcp_control=common["tcp_control"],
        plant=common["plant"],
        load=common["load"],
        tilt=common[ACTUAL_TILT],
        axes=axes,
        parameters=_described(name, common, own),
    )
    if setup.tcp_control.active:
        setup.tcp_controller()  # refuses what does not go together
    return setup


def _machine(kinematics: type[Machine], geometry: Any, prefix: str) -> Machine:
    try:
        return kinematics(geometry)
    except InputError as error:
        raise InputError(f"{prefix}{error}") from None


def _by_section(
    values: Mapping[str, object], axes: tuple[str, ...], sections: Mapping[str, type]
) -> dict[str, dict[str, object]]:
    allowed = {*sections, ACTUAL_GEOMETRY, *(f"{axis}.{section}" for axis in axes for section in AXIS_SECTIONS)}
    given: dict[str, dict[str, object]] = {}
    for key, value in values.items():
        section, _, name = key.rpartition(".")
        if section not in allowed:
            raise InputError(f"{key}: unknown parameter; sections are {', '.join(sorted(allowed - {''}))}")
        given.setdefault(section, {})[name] = value
    return given


def _override(base: Any, values: Mapping[str, object], prefix: str) -> Any:
    common = {spec.name: getattr(base, spec.name) for spec in parameters_of(type(base))}
    return read_section(type(base), {**common, **values}, prefix)


def _described(name: str, common: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, tuple[Value, Parameter]]:
    kind = parameter(name, "the kinematics: name of its module")
    described: dict[str, tuple[Value, Parameter]] = {
        "machine": (name, dataclasses.replace(kind.metadata["parameter"], name="machine"))
    }
    for section, content in common.items():
        for spec in parameters_of(type(content)):
            key = f"{section}.{spec.name}" if section else spec.name
            described[key] = (getattr(content, spec.name), spec)
    for prefix, (content, extra) in own.items():
        for spec in parameters_of(type(content)):
            if spec.name in extra:
                described[f"{prefix}.{spec.name}"] = (getattr(content, spec.name), spec)
    return described
