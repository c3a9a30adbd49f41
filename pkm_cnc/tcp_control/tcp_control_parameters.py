"""Which controllers look at the TCP: the section `tcp_control` of a machine file."""

from __future__ import annotations

import dataclasses

from pkm_cnc.parameters import parameter

__all__ = ["TcpControlParameters"]


@dataclasses.dataclass(frozen=True)
class TcpControlParameters:
    """Section `tcp_control.*`. All off: the drives are alone, as on an ordinary machine."""

    cross_coupling: float = parameter(
        0.0,
        "gain of cross-coupled control: the contour error that the controller believes, times this, is commanded back "
        "as a velocity of the TCP through the Jacobian; 0 = off. Together with drive.kv it must stay well below half "
        "the bandwidth of the velocity loop (some 1200 1/s for the default drive)",
        unit="1/s",
        minimum=0.0,
        maximum=1000.0,
    )
    direct_feedback: bool = parameter(
        False,
        "close the position loops at the TCP, which a measuring system of its own reads (thesis 2.1.3), instead of at "
        "the linear scales; drive.kv stays the gain",
    )
    adapted_gain: bool = parameter(
        False,
        "command the velocities that let the TCP lag exactly along the path by speed / Kv: all drives follow their "
        "setpoints of one and the same earlier place. Not with a velocity or acceleration feed-forward",
    )

    @property
    def active(self) -> bool:
        """Whether there is anything to do."""
        return self.cross_coupling > 0.0 or self.direct_feedback or self.adapted_gain
