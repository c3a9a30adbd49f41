"""A node's ROS parameters: the machine's, checked as a whole, declared with description, unit and range, read-only.

Read-only while a node lives, because its run must be repeatable from what the bag holds. The overrides alone may be
changed: each change is a command of the operator, and so is in the bag.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from pkm_cnc.config import Setup, setup_from_parameters
from pkm_cnc.parameters import Parameter, parameter, parameters_of, read_section

__all__ = ["RunParameters", "overrides", "read_parameters"]


@dataclass(frozen=True)
class RunParameters:
    """Parameters of a run, beside those of the machine: which file, how paced, who starts it, recorded to where."""

    program: str = parameter("", "part program to run: path of a file (interpolator)")
    pacing: str = parameter(
        "fast",
        "fast = as fast as possible, realtime = one cycle per servo period of wall time (interpolator)",
        choices=("fast", "realtime"),
    )
    attended: bool = parameter(
        False, "an operator starts the program and is waited for; false = it starts by itself (interpolator)"
    )
    from_line: int = parameter(
        0, "line of the part program to begin at; 0 = its first (interpolator)", minimum=0, maximum=2**31 - 1
    )
    feed_override: float = parameter(
        1.0, "factor of the programmed feed; may be changed at any time (interpolator)", minimum=0.0, maximum=2.0
    )
    rapid_override: float = parameter(
        1.0, "factor of the speed of rapids; may be changed at any time (interpolator)", minimum=0.0, maximum=2.0
    )
    bag: str = parameter("", "folder to record to; must not exist (recorder)")
    autostart: bool = parameter(
        True, "configure and activate at start; false = wait for life cycle commands (every node)"
    )


def overrides(parameters: Mapping[str, Any]) -> list[RosParameter]:
    """Parameters by dotted key, as a node's constructor takes them."""
    return [RosParameter(key, value=_ros_value(value)) for key, value in parameters.items()]


def read_parameters(node: Node, changeable: tuple[str, ...] = ()) -> tuple[Setup, RunParameters]:
    """The machine and the run parameters that `node` was given; all of them are declared anew with their descriptions.

    `changeable` are the run parameters that may be set while the node lives. Needs
    automatically_declare_parameters_from_overrides. Raises InputError naming the key.
    """
    given = {
        name: parameter.value
        for name, parameter in node.get_parameters_by_prefix("").items()
        if name not in ("use_sim_time", "start_type_description_service") and not name.startswith("qos_overrides.")
    }
    specs = {spec.name: spec for spec in parameters_of(RunParameters)}
    of_run = {name: value for name, value in given.items() if name in specs}
    setup = setup_from_parameters({name: value for name, value in given.items() if name not in of_run})
    run = read_section(RunParameters, of_run, "")
    for name in given:
        node.undeclare_parameter(name)
    for key, (value, spec) in setup.parameters.items():
        node.declare_parameter(key, _ros_value(value), _descriptor(spec), ignore_override=True)
    for name in {**of_run, **dict.fromkeys(changeable)}:
        descriptor = _descriptor(specs[name], read_only=name not in changeable)
        node.declare_parameter(name, getattr(run, name), descriptor, ignore_override=True)
    return setup, run


def _ros_value(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _descriptor(spec: Parameter, read_only: bool = True) -> ParameterDescriptor:
    text = f"{spec.doc} [{spec.unit}]" if spec.unit else spec.doc
    if spec.choices:
        text += f" (one of {', '.join(spec.choices)})"
    if spec.above is not None:
        text += f" (above {spec.above:g})"
    descriptor = ParameterDescriptor(description=text, read_only=read_only)
    if spec.minimum is not None and spec.maximum is not None:
        if type(spec.default) is int:
            descriptor.integer_range = [IntegerRange(from_value=int(spec.minimum), to_value=int(spec.maximum), step=1)]
        elif type(spec.default) is float:
            descriptor.floating_point_range = [FloatingPointRange(from_value=spec.minimum, to_value=spec.maximum)]
    return descriptor
