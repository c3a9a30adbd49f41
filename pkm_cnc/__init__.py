"""CNC controller of a parallel kinematic machine, as a ROS 2 graph and as a simulation without ROS."""

__version__ = "0.1.0"
