"""Order of the errors in the default filter, and the integrals of an acceleration that fades.

The errors have this order:
- rotation (3, rad, obj), rate (3, rad/s), acceleration (3, rad/s²),
- the eccentricity: the ball's centre from the point that it turns about (3, m, ball),
- the rig: the focal length (1, relative), and that point at that focal length (3, m, obj),
- the axes of obj (3, rad), which are considered,
- rig, axes and rolling shutter of each other camera (8), which are considered while it shows no frame,
- the rolling shutter's time (s),
- two for each disc in its own tangent axes (rad),
- the reference, from whose attitude the next increment counts (3, rad, obj).
"""

import math

KINEMATIC_DIM = 9  # rotation, rate, acceleration
RIG_ROW = KINEMATIC_DIM + 3  # of the rig, after the eccentricity
RIG_DIM = 4  # focal length and the point that the ball turns about
AXES = RIG_ROW + RIG_DIM  # of obj, after the rig
READOUT = AXES + 3  # of the rolling shutter of one camera; the errors of others come before it
MAP_OFFSET = READOUT + 1  # of the discs' errors with one camera
CAMERA_DIM = 8  # of another camera: rig, axes, readout
CLONE_DIM = 3  # at the end: of the attitude that the next motion counts from


def integrals(t: float, tau: float) -> tuple[float, float]:
    """Return the integrals over t of exp(-t/tau), first and second: rate and turn by a unit acceleration that fades."""
    gain = -tau * math.expm1(-t / tau)
    return gain, tau * (t - gain)
