"""The Tripod as a ROS graph, one process per node.

ros2 launch pkm_cnc tripod.launch.py program:=FILE.ngc bag:=FOLDER [pacing:=realtime] [parameters:=FILE.yaml]
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from pkm_cnc.bringup import describe_graph
from pkm_cnc.config import load_setup, machine_files


def _nodes(context: LaunchContext) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ("program", "bag", "pacing", "parameters")}
    setup = load_setup(given["parameters"])
    return [
        Node(
            package="pkm_cnc",
            executable=spec.executable,
            name=spec.executable,
            namespace=spec.namespace,
            parameters=[given["parameters"], spec.parameters],
            output="screen",
        )
        for spec in describe_graph(tuple(setup.axes), given["program"], given["bag"], given["pacing"])
    ]


def generate_launch_description() -> LaunchDescription:
    """Every node ends by itself at the end of the run or after a fault, and with the last of them the launch."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("program", description="part program (RS-274, mm)"),
            DeclareLaunchArgument("bag", description="folder to record to; must not exist"),
            DeclareLaunchArgument("pacing", default_value="fast", description="fast or realtime"),
            DeclareLaunchArgument(
                "parameters", default_value=str(machine_files()["tripod"]), description="machine file (YAML)"
            ),
            OpaqueFunction(function=_nodes),
        ]
    )
