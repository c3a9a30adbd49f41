"""What every launch file describes: the graph, one process per node. Needs the launch packages of a ROS system."""

from __future__ import annotations

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, Shutdown, TimerAction
from launch.event_handlers import OnProcessExit
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from pkm_cnc.bringup.description import describe_graph
from pkm_cnc.config import load_setup, machine_files
from pkm_cnc.errors import InputError
from pkm_cnc.run_messages import RunOptions

__all__ = ["launch_description"]

ARGUMENTS = ("program", "bag", "pacing", "attended", "from_line", "parameters")
LEAVE_TIMEOUT = 3.0
"""s of wall time that the other nodes have after a failure to hear of it and to close the bag."""


def _typed(parameters: dict[str, str | bool | int]) -> dict[str, ParameterValue]:
    """Parameters that keep their types: launch would read a bag called 1.10 as a number."""
    return {name: ParameterValue(value, value_type=type(value)) for name, value in parameters.items()}


def _options(attended: str, from_line: str) -> RunOptions:
    if attended.lower() not in ("true", "false"):
        raise InputError(f"attended: {attended!r} is not true or false")
    if not from_line.isdecimal():
        raise InputError(f"from_line: {from_line!r} is not a line number")
    return RunOptions(attended.lower() == "true", int(from_line))


def _nodes(context: LaunchContext) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    setup = load_setup(given["parameters"])
    options = _options(given["attended"], given["from_line"])
    return [
        Node(
            package="pkm_cnc",
            executable=spec.executable,
            name=spec.executable,
            namespace=spec.namespace,
            parameters=[given["parameters"], _typed(spec.parameters)],
            output="screen",
        )
        for spec in describe_graph(
            *(tuple(setup.axes), given["program"], given["bag"], given["pacing"]), setup.tcp_control.active, options
        )
    ]


def _leave(event: ProcessExited, context: LaunchContext) -> list[TimerAction] | None:
    """After a failure whoever has not ended by itself is stopped, e.g. nodes that wait for one that never started."""
    if event.returncode == 0:
        return None
    reason = f"{event.process_name} ended with {event.returncode}"
    return [TimerAction(period=LEAVE_TIMEOUT, actions=[Shutdown(reason=reason)])]


def launch_description(machine: str) -> LaunchDescription:
    """What starts the graph of the machine file called `machine`.

    Launch arguments: `program` and `bag`, and with defaults `pacing`, `attended`, `from_line` and `parameters`, another
    machine file. At the end of a run every node ends by itself, and with the last of them the launch.
    """
    return LaunchDescription(
        [
            DeclareLaunchArgument("program", description="part program (RS-274, mm)"),
            DeclareLaunchArgument("bag", description="folder to record to; must not exist"),
            DeclareLaunchArgument("pacing", default_value="fast", description="fast or realtime"),
            DeclareLaunchArgument(
                "attended", default_value="false", description="true: an operator starts the program, and it waits"
            ),
            DeclareLaunchArgument(
                "from_line", default_value="0", description="line of the program to begin at; 0 = its first"
            ),
            DeclareLaunchArgument(
                "parameters", default_value=str(machine_files()[machine]), description="machine file (YAML)"
            ),
            OpaqueFunction(function=_nodes),
            RegisterEventHandler(OnProcessExit(on_exit=_leave)),
        ]
    )
