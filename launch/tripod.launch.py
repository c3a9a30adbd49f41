"""The Tripod as a ROS graph, one process per node.

ros2 launch pkm_cnc tripod.launch.py program:=FILE.ngc bag:=FOLDER [pacing:=realtime] [parameters:=FILE.yaml]
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, Shutdown, TimerAction
from launch.event_handlers import OnProcessExit
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from pkm_cnc.bringup import LEAVE_TIMEOUT, describe_graph
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


def _leave(event: ProcessExited, context: LaunchContext) -> list[TimerAction] | None:
    """After a failure the other nodes have a moment to hear of it and to close the bag, then they are stopped."""
    if event.returncode == 0:
        return None
    reason = f"{event.process_name} ended with {event.returncode}"
    return [TimerAction(period=LEAVE_TIMEOUT, actions=[Shutdown(reason=reason)])]


def generate_launch_description() -> LaunchDescription:
    """At the end of a run every node ends by itself, and with the last of them the launch."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("program", description="part program (RS-274, mm)"),
            DeclareLaunchArgument("bag", description="folder to record to; must not exist"),
            DeclareLaunchArgument("pacing", default_value="fast", description="fast or realtime"),
            DeclareLaunchArgument(
                "parameters", default_value=str(machine_files()["tripod"]), description="machine file (YAML)"
            ),
            OpaqueFunction(function=_nodes),
            RegisterEventHandler(OnProcessExit(on_exit=_leave)),
        ]
    )
