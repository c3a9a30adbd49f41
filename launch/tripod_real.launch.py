"""The Tripod that differs from its model as a ROS graph, one process per node.

ros2 launch pkm_cnc tripod_real.launch.py program:=FILE.ngc bag:=FOLDER [pacing:=realtime] [parameters:=FILE.yaml]
    [attended:=true] [from_line:=N]
"""

from launch import LaunchDescription

from pkm_cnc.bringup.launch_file import launch_description


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    return launch_description("tripod_real")
