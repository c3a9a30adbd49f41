"""A node's ROS parameters: the machine's, checked as a whole, declared with description, unit and range, read-only.

All are read-only while a node lives, because its run must be repeatable from what the bag holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from pkm_cnc.config import Setup, setup_from_parameters
from pkm_cnc.parameters import Parameter

__all__ = ["RUN_PARAMETERS", "overrides", "read_parameters"]

RUN_PARAMETERS = {
    "program": "part program to run: path of a file (interpolator)",
    "pacing": "fast = as fast as possible, realtime = one cycle per servo period of wall time (interpolator)",
    "bag": "folder to record to; must not exist (recorder)",
    "autostart": "configure and activate at start; false = wait for life cycle commands (every node)",
}
"""Parameters of a run, beside those of the machine: which file, how paced, recorded to where."""


def overrides(parameters: Mapping[str, Any]) -> list[RosParameter]:
    """Parameters by dotted key, as a node's constructor takes them."""
    return [RosParameter(key, value=_ros_value(value)) for key, value in parameters.items()]


def read_parameters(node: Node) -> tuple[Setup, dict[str, str]]:
    """The machine and the run parameters that `node` was given; all of them are declared anew with their descriptions.

    Needs automatically_declare_parameters_from_overrides. Raises InputError naming the key.
    """
    given = {
        name: parameter.value
        for name, parameter in node.get_parameters_by_prefix("").items()
        if name not in ("use_sim_time", "start_type_description_service") and not name.startswith("qos_overrides.")
    }
    run = {name: given[name] for name in RUN_PARAMETERS if name in given}
    setup = setup_from_parameters({name: value for name, value in given.items() if name not in run})
    for name in given:
        node.undeclare_parameter(name)
    for key, (value, spec) in setup.parameters.items():
        node.declare_parameter(key, _ros_value(value), _descriptor(spec), ignore_override=True)
    for name, value in run.items():
        descriptor = ParameterDescriptor(description=RUN_PARAMETERS[name], read_only=True)
        node.declare_parameter(name, value, descriptor, ignore_override=True)
    return setup, {name: str(value) for name, value in run.items()}


def _ros_value(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _descriptor(spec: Parameter) -> ParameterDescriptor:
    text = f"{spec.doc} [{spec.unit}]" if spec.unit else spec.doc
    if spec.choices:
        text += f" (one of {', '.join(spec.choices)})"
    if spec.above is not None:
        text += f" (above {spec.above:g})"
    descriptor = ParameterDescriptor(description=text, read_only=True)
    if spec.minimum is not None and spec.maximum is not None:
        if type(spec.default) is int:
            descriptor.integer_range = [IntegerRange(from_value=int(spec.minimum), to_value=int(spec.maximum), step=1)]
        elif type(spec.default) is float:
            descriptor.floating_point_range = [FloatingPointRange(from_value=spec.minimum, to_value=spec.maximum)]
    return descriptor
