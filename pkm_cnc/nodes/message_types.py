"""ROS message classes by name."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["message_class"]


def message_class(typename: str) -> Any:
    """The class of e.g. "pkm_cnc_msgs/msg/TcpSetpoint", for publishers and subscriptions."""
    package, folder, name = typename.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), name)
