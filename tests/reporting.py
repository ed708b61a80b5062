"""Reports made up for tests of outputs, and counts of what was tracked."""

import numpy as np

from spheremouse.output import Report
from spheremouse.output.counts import Counter, MotionSettings
from spheremouse.tracker import Motion


def report(
    x=0, y=0, z=0, *, stamp=0.0, rotation=(0, 0, 0), rate=(0, 0, 0), counts_rate=(0.0, 0.0, 0.0), confirmed=True
):
    """One of counts x, y, z, which a ball's rotation (3,) rad and rate (3,) rad/s may go with."""
    turning = np.array([*rate, 0.0, 0.0, 0.0], dtype=float)
    motion = Motion(stamp, np.array(rotation, dtype=float), np.zeros(3), turning, np.zeros((12, 12)), confirmed)
    return Report((x, y, z), counts_rate, motion)


def counts_of(motions, rig, settings=MotionSettings()):  # noqa: B008  frozen
    """Counts of the motions of a run, (n, 3): x, y and third axis."""
    counter = Counter(settings.matrix(rig.radius_m))
    return np.array([counter.report(m).counts for m in motions])
