"""The node classes by executable name."""

from pkm_cnc.nodes.contour_monitor import ContourMonitorNode
from pkm_cnc.nodes.graph_node import GraphNode
from pkm_cnc.nodes.interpolator import InterpolatorNode
from pkm_cnc.nodes.inverse_kinematics import InverseKinematicsNode
from pkm_cnc.nodes.plant import PlantNode
from pkm_cnc.nodes.recorder import RecorderNode
from pkm_cnc.nodes.servo_drive import ServoDriveNode
from pkm_cnc.nodes.tcp_controller import TcpControllerNode

__all__ = ["NODE_CLASSES"]

NODE_CLASSES: dict[str, type[GraphNode]] = {
    "interpolator": InterpolatorNode,
    "inverse_kinematics": InverseKinematicsNode,
    "servo_drive": ServoDriveNode,
    "plant": PlantNode,
    "tcp_controller": TcpControllerNode,
    "contour_monitor": ContourMonitorNode,
    "recorder": RecorderNode,
}
