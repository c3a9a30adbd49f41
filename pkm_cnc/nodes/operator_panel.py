"""What an operator commands by ROS: services, and the overrides as parameters."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from pkm_cnc.records import (
    CMD_ABORT,
    CMD_FEED_OVERRIDE,
    CMD_HOLD,
    CMD_RAPID_OVERRIDE,
    CMD_RESET,
    CMD_RESUME,
    CMD_SINGLE_BLOCK,
    CMD_START,
    Command,
)

__all__ = ["OVERRIDES", "OperatorPanel"]

TRIGGERS = {"start": CMD_START, "hold": CMD_HOLD, "resume": CMD_RESUME, "abort": CMD_ABORT, "reset": CMD_RESET}
OVERRIDES = {"feed_override": CMD_FEED_OVERRIDE, "rapid_override": CMD_RAPID_OVERRIDE}
"""Parameters that are commands when they are set."""


class OperatorPanel:
    """Offers services and takes parameters of a node; each becomes a call of `command`, which says why it refuses."""

    def __init__(self, node: Node, command: Callable[[Command], str]) -> None:
        self._command = command
        for name, kind in TRIGGERS.items():
            node.create_service(Trigger, f"~/{name}", partial(self._serve, kind))
        node.create_service(SetBool, "~/single_block", partial(self._serve, CMD_SINGLE_BLOCK))
        node.add_on_set_parameters_callback(self._set)

    def _serve(self, kind: int, request: Any, response: Any) -> Any:
        response.message = self._command(Command(kind, float(getattr(request, "data", 0.0))))
        response.success = not response.message
        return response

    def _set(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name in OVERRIDES:
                reason = self._command(Command(OVERRIDES[parameter.name], parameter.value))
                if reason:
                    return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)
