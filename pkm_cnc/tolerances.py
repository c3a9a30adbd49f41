"""Every tolerance of the project, named once, with its reason."""

TIE = 1e-9
"""m. Two distances to the contour closer than this are a tie: part programs resolve 1 nm (six decimals of a mm)."""

ARC_RADII = 5e-6
"""m. Circles whose centers and radii differ by less than this are one circle (a program with three decimals of a mm
rounds each coordinate by 0.5 um; corner to corner that is below 2 um, doubled for the sum of both ends)."""

ARC_RADII_MM, ARC_RADII_INCH = 2e-5 * 2**0.5, 5.08e-5 * 2**0.5
"""m. Difference that is always allowed between the radii at an arc's start and end, in a program in mm and in inches:
both ends and the center rounded to 0.01 mm, 0.001 inch. These four are LinuxCNC's (rs274ngc, interp_internal.hh)."""

ARC_RADII_RELATIVE = 1e-3
"""1. Difference of the radii that is allowed relative to the larger one."""

ARC_RADII_RATIO = 100.0
"""1. The relative allowance ends at this many times the absolute one: 2.83 mm is a wrong center, not rounding."""

ARC_RADIUS = 1.27e-6
"""m. A smaller radius is none; and what half the distance of an arc's ends may exceed its radius R by: 0.00005 inch."""

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

OFF_MACHINE, OFF_MACHINE_RATE = 1e-12, 1e-6
"""m; m/s and m/s^2. A coordinate that a machine of fewer than three coordinates does not move is 0 up to this: rounding
of sums and of arcs' end points, but not the last decimal of a part program. A path that ends so near to 0 has rates
below the other one along all elements of 2 um and more (at 2 m/s^2), so what passes as a path passes as a motion."""

EQUAL_TIMES = 1e-12
"""1. Relative difference of two times of a controller that is rounding alone: they were multiplied and divided a few
times."""

NO_OVERSHOOT = 1e-6
"""1. An overshoot up to this share of the step is none: rounding, and the slow poles of a drive (3e-11), make some."""

LIMIT_EXCESS = 3e-4
"""1. A motion counts as slow enough up to this part of its time: a jerk is then 0.09 % over its limit, of 0.1 %."""
