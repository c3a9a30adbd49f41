"""From toolpath and feed to the TCP setpoint of every cycle.

`Interpolator` takes a toolpath apart into pieces that are run and stops (`blending`), plans the path speed from stop
to stop within the limits of TCP and drives (`planner`), and answers cycle by cycle. `MotionParameters` and
`LimitParameters` are the sections `motion` and `limits` of a machine file, `DriveLimits` the drives as the planner
needs them; `pieces` is what the TCP is sent along. `Operator` is what an operator has commanded.
"""

from pkm_cnc.motion.blending import pieces
from pkm_cnc.motion.feed_profile import Cell, FeedProfile, speeds_squared
from pkm_cnc.motion.interpolator import Interpolator, Progress, Source
from pkm_cnc.motion.limits import DriveLimits, LimitParameters, MotionParameters, refuse_long_ramp
from pkm_cnc.motion.operator import STATE_NAMES, Operator
from pkm_cnc.motion.piece import Curve, Piece, Shape, frames_of
from pkm_cnc.motion.planner import Planner
from pkm_cnc.motion.supply import Segment

__all__ = [
    "STATE_NAMES",
    "Cell",
    "Curve",
    "DriveLimits",
    "FeedProfile",
    "Interpolator",
    "LimitParameters",
    "MotionParameters",
    "Operator",
    "Piece",
    "Planner",
    "Progress",
    "Segment",
    "Shape",
    "Source",
    "frames_of",
    "pieces",
    "refuse_long_ramp",
    "speeds_squared",
]
