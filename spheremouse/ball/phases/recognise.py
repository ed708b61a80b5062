"""The attitude from a saved map of discs."""

import numpy as np

from spheremouse.ball.associate import identify
from spheremouse.ball.filters.so3 import So3Filter, relocate
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.geometry.rotation import rotation_between
from spheremouse.tracker import Status

IDENTIFY_SIGMA = 0.003  # rad, of a direction when the map is searched; at a tenth any disc may be any other


def recognised_attitude(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter]
) -> tuple[So3State, int] | None:
    """The filter with its attitude found by the map alone, and by how many discs; None where it is not certain.

    `identify` weighs all points, also those that meet no disc, so no further rule on their number is needed.
    After a short gap the rate is that from the last attitude confirmed; after a long one it is unknown.
    """
    points = state.points
    placed = state.filter.map_sigma() < IDENTIFY_SIGMA  # a disc founded at a doubtful attitude tells no attitude
    known = identify(
        points.direction,
        state.filter.discs[placed],
        sigma=IDENTIFY_SIGMA,
        view_axis=tracker.filter.towards_camera,
        horizon=tracker.filter.horizon,
        risk=1e-3,
    )
    if known is None:
        return None
    gap = stamp - state.confirmed_at
    rate = None
    if state.status is Status.TRACKING and 0.0 < gap <= tracker.settings.loss.lost_after:
        rate = rotation_between(state.reported_attitude, known.rotation) / gap
    located = relocate(state.filter, known.rotation, IDENTIFY_SIGMA, tracker.settings.so3, stamp, rate)
    return tracker.filter.update(located, points, np.zeros(len(points), dtype=bool)), len(known.pairs)
