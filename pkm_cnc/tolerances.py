"""Every tolerance of the project, named once, with its reason."""

TIE = 1e-9
"""m. Two distances to the contour closer than this are a tie: part programs resolve 1 nm (six decimals of a mm)."""

ARC_RADII = 5e-6
"""m. Largest difference between the radii of an arc's start and end point (a program with three decimals of a mm
rounds each coordinate by 0.5 um; corner to corner that is below 2 um, doubled for the sum of both ends)."""

ZERO_LENGTH = 1e-12
"""m. A motion shorter than this is none: a thousandth of the resolution of a part program."""

FEED_REACHED = 1e-6
"""1. Relative difference to the programmed feed below which the feed counts as reached."""

NEWTON = 1e-14
"""m. A Newton step below this ends the iteration of the forward kinematics: some rounding errors of a metre."""

SINGULAR = 1e-9
"""1. A reciprocal condition number of the Jacobian below this counts as singular."""

VERTICAL = 1e-9
"""1. A unit tangent whose horizontal part is below this is parallel to z: left and right of it have no meaning (a
vertical line of a part program has none but rounding)."""

SPEED_ROUNDING = 1e-15
"""1. Relative difference of two path speeds that is rounding alone: some units in the last place of a double."""

OFF_MACHINE = 1e-9
"""m, m/s, m/s^2. A coordinate that a machine of fewer than three coordinates does not move is 0 up to this: what a part
program's decimals and an arc's end points leave."""

EQUAL_TIMES = 1e-12
"""1. Relative difference of two times of a controller that is rounding alone: they were multiplied and divided a few
times."""

NO_OVERSHOOT = 1e-6
"""1. An overshoot up to this share of the step is none: rounding, and the slow poles of a drive (3e-11), make some."""
