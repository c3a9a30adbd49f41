"""compensation_preprocessor: a part program in, the compensated one out, as a file and as toolpath for whoever looks.

It is no part of the servo graph: it needs no cycle and nobody waits for it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from std_srvs.srv import Trigger

from pkm_cnc.bag import read_run
from pkm_cnc.compensation import METHODS, Compensated, CompensationOptions, compensate
from pkm_cnc.config import load_setup, setup_from_parameters
from pkm_cnc.errors import InputError, PkmError
from pkm_cnc.nodes.message_types import message_class
from pkm_cnc.nodes.ros_parameters import overrides
from pkm_cnc.parameters import read_section
from pkm_cnc.program import read_program
from pkm_cnc.report import write_whole
from pkm_cnc.run_messages import segment

__all__ = ["CompensationPreprocessorNode", "main"]

NAME = "compensation_preprocessor"
SEGMENT = "toolpath/compensated"
RUN_PARAMETERS = {
    "program": "part program to compensate: path of a file",
    "output": "the compensated part program: path of a file",
    "method": f"one of {', '.join(METHODS)}",
    "model": "machine file of the model; empty = the machine's own parameters",
    "bags": "bags with runs of the program whose errors count; none = those of the model",
}
OPTIONS = "compensation."


class CompensationPreprocessorNode(Node):
    """Service `~/compensate` (std_srvs/Trigger) does the work; the elements come latched on `toolpath/compensated`.

    Parameters are those of the machine, those of RUN_PARAMETERS, and the options as `compensation.*`; they are read
    when the service is called.
    """

    def __init__(self, *, context: Context | None = None, parameters: Mapping[str, Any] | None = None) -> None:
        super().__init__(
            NAME,
            context=context,
            use_global_arguments=parameters is None,
            parameter_overrides=overrides(parameters or {}),
            automatically_declare_parameters_from_overrides=True,
        )
        for name, text in RUN_PARAMETERS.items():
            if not self.has_parameter(name):
                default = [""] if name == "bags" else "mirror" if name == "method" else ""
                self.declare_parameter(name, default, ParameterDescriptor(description=text))
        latched = QoSProfile(history=HistoryPolicy.KEEP_ALL, depth=0, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._segments = self.create_publisher(message_class("pkm_cnc_msgs/msg/ToolpathSegment"), SEGMENT, latched)
        self.create_service(Trigger, "~/compensate", self._compensate)

    def _compensate(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            done = self.compensate()
        except PkmError as error:
            response.success, response.message = False, str(error)
            return response
        response.success = True
        response.message = (
            f"largest contour error {done.before.largest * 1e6:.5g} um, predicted {done.after.largest * 1e6:.5g} um"
        )
        return response

    def compensate(self) -> Compensated:
        """Do the work and publish the elements. Raises PkmError; no file is written then."""
        given = {
            name: parameter.value
            for name, parameter in self.get_parameters_by_prefix("").items()
            if name not in ("use_sim_time", "start_type_description_service") and not name.startswith("qos_overrides.")
        }
        run = {name: given.pop(name) for name in RUN_PARAMETERS}
        chosen = {name.removeprefix(OPTIONS): given.pop(name) for name in list(given) if name.startswith(OPTIONS)}
        for name in ("program", "output"):
            if not run[name]:
                raise InputError(f"parameter {name} is missing; give -p {name}:=FILE")
        if run["method"] not in METHODS:
            raise InputError(f"parameter method: {run['method']!r} is not one of {', '.join(METHODS)}")
        done = compensate(
            setup_from_parameters(given),
            read_program(run["program"]),
            run["method"],
            model=load_setup(run["model"]) if run["model"] else None,
            bags=[read_run(bag) for bag in run["bags"] if bag],
            options=read_section(CompensationOptions, chosen, OPTIONS),
        )
        write_whole(Path(run["output"]), done.program.text.encode())
        for index, (element, start) in enumerate(zip(done.toolpath.elements, done.toolpath.starts, strict=True)):
            self._segments.publish(segment(index, element, start, 0))
        return done


def main() -> None:
    """Entry point of `ros2 run pkm_cnc compensation_preprocessor`."""
    context = Context()
    rclpy.init(args=sys.argv, context=context)
    node = CompensationPreprocessorNode(context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        context.try_shutdown()
