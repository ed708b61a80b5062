"""The attitude from a saved map of discs."""

import numpy as np

from spheremouse.ball.associate import identify
from spheremouse.ball.filters.so3 import So3Filter, relocate
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.geometry.rotation import rotation_between
from spheremouse.tracker import Status


def recognised_attitude(
    state: TrackState[So3State], stamp: float, tracker: Tracker[So3Filter]
) -> tuple[So3State, int] | None:
    """The filter with its attitude found by the map alone, and by how many discs; None where it is not certain.

    `identify` weighs all points, also those that meet no disc, so no further rule on their number is needed.
    After a short gap the rate is that from the last attitude confirmed; after a long one it is unknown.
    """
    points, s = state.points, tracker.settings.loss
    placed = state.filter.map_sigma() < s.identify_sigma  # a disc founded at a doubtful attitude tells no attitude
    known = identify(
        points.direction,
        state.filter.discs[placed],
        sigma=s.identify_sigma,
        view_axis=tracker.filter.towards_camera,
        horizon=tracker.filter.horizon,
        risk=1e-3,
    )
    if known is None:
        return None
    gap = stamp - state.confirmed_at
    rate = None
    if state.status is Status.TRACKING and 0.0 < gap <= s.lost_after:
        rate = rotation_between(state.reported_attitude, known.rotation) / gap
    located = relocate(state.filter, known.rotation, s.identify_sigma, tracker.settings.so3, stamp, rate)
    return tracker.filter.update(located, points, np.zeros(len(points), dtype=bool)), len(known.pairs)
