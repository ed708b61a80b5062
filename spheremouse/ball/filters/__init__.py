"""Filters: SpherePoints in, attitude and angular velocity with covariance out.

Each filter is a frozen settings object with `initial`, `predict` and `update`; its state is a named tuple that
satisfies `FilterState`. The stamps are the only source of time.
"""

from collections.abc import Mapping
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.points import SpherePoints
from spheremouse.geometry.rotation import Array


class FilterState(Protocol):
    """Public interface of any filter's state."""

    @property
    def stamp(self) -> float:
        """s, the time of the state."""
        ...

    @property
    def attitude(self) -> Array:
        """R_obj_ball, (3, 3)."""
        ...

    @property
    def rate(self) -> Array:
        """w_obj, (3,) rad/s."""
        ...

    @property
    def covariance(self) -> Array:
        """(6, 6) of the rotation error vector (rad, obj, exp(e) @ attitude) and of w_obj (rad/s)."""
        ...

    @property
    def discs(self) -> Array:
        """(m, 3) unit vectors in `ball`: the discs on the filter's map."""
        ...

    @property
    def used(self) -> NDArray[np.intp]:
        """Indices, (k,), of the points that the last update used."""
        ...

    def clone_attitude(self) -> Self:
        """Return the state with its current attitude as the reference of the next increment."""
        ...

    def with_reference_of(self, other: Self) -> Self:
        """Return the state with the error of the reference of `other`, which is independent of this state's errors.

        The reference is the attitude from which the next reported motion counts (`TrackState.reported_attitude`).
        """
        ...

    def with_cameras_of(self, other: Self) -> Self:
        """Return the state, of one camera, with the other cameras of `other`."""
        ...

    @property
    def rig_error(self) -> Array:
        """(4,) of the focal length and the point that the ball turns about."""
        ...

    @property
    def seen_rig(self) -> Array:
        """(4,) of the focal length and the ball's centre at this attitude, as `SpherePoints` has it."""
        ...

    @property
    def centre_noise(self) -> float:
        """m²/s per axis, by which the centre moves at random; 0 in a good bearing."""
        ...

    @property
    def statistics(self) -> Mapping[str, float]:
        """Statistics of the last update that only this filter has."""
        ...

    def increment_covariance(self, turn: Array) -> Array:
        """Return the covariance, (6, 6), of the rotation vector `turn`, (3,) rad, since the reference, and the rate."""
        ...


S = TypeVar("S", bound=FilterState)


class Filter(Protocol[S]):
    """Interface of a filter."""

    def initial(self, stamp: float, attitude: Array) -> S:
        """Return the state before the first point, at rest at `attitude` (3, 3)."""
        ...

    def predict(self, state: S, stamp: float) -> S:
        """Return the state predicted for `stamp` (s); `used` is empty."""
        ...

    def update(self, state: S, points: SpherePoints, may_start_landmark: NDArray[np.bool_] | None = None) -> S:
        """Return the state after the points of one frame, which the filter associates.

        A point without a known disc starts a new one if `may_start_landmark` (n,) allows it (None: all).
        """
        ...

    def adopt(self, state: S, before: Self) -> S:
        """Return the state of the filter `before`, which had other settings, for use by this one."""
        ...

    def gate_radius(self, state: S, which: NDArray[np.intp], interval: float) -> Array:
        """Return the radius, (k,) rad on the ball, around each disc `which` for points `interval` s after `state`."""
        ...

    def is_significant(self, predicted: S, used: int, points: int) -> bool:
        """Return whether chance does not explain so many pairs among a frame's points."""
        ...
