"""From toolpath and feed to the TCP setpoint of every cycle.

`Interpolator` groups the elements of a toolpath into runs from stop to stop, plans the path speed of each as a
`FeedProfile`, and answers cycle by cycle; `MotionParameters` is the section `motion` of a machine file.
"""

from pkm_cnc.motion.feed_profile import FeedProfile
from pkm_cnc.motion.interpolator import Interpolator, MotionParameters

__all__ = ["FeedProfile", "Interpolator", "MotionParameters"]
