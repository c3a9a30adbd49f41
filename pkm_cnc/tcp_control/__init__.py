"""What a controller that looks at the TCP adds to the velocity commands of the drives, cycle by cycle.

`TcpController` is the step object: cross-coupled control, direct feedback of the TCP, adapted gain, each switched on
in the section `tcp_control` of a machine file (`TcpControlParameters`). The sum of their corrections goes to the drives
as one velocity for each; without any of them there is no controller and no correction.
"""

from pkm_cnc.tcp_control.controller import TcpController
from pkm_cnc.tcp_control.lagging_place import LaggingPlace, Place
from pkm_cnc.tcp_control.tcp_control_parameters import TcpControlParameters

__all__ = ["LaggingPlace", "Place", "TcpControlParameters", "TcpController"]
