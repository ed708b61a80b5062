"""The first turn of the ball told from two discs."""

import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.lookalikes import MOVED_PX, STILL_PX
from spheremouse.ball.points import SpherePoints
from spheremouse.ball.state import BufferedFrame, Tracker
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import Array, align

_PATH = 5.0  # times MOVED_PX: over so long a path, a turn and a shift of the picture differ by many deviations
_FITS = 10.83  # chi-square with one degree of freedom, 99.9 %
_BETTER = 30.0  # squared deviations by which a turn must fit better than a shift of the picture: odds of 3e6
_CENTRE_SIGMA = 0.1  # px, floor of the standard deviation of a path's length: unevenness of light


def follow_points(views: tuple[BufferedFrame, ...], centre: Array, next_track: int) -> tuple[NDArray[np.intp], int]:
    """Number the points of a frame, at `centre` (n, 2) px: as in the view before where it shows them nearby.

    Each is looked for where its last step leads. Returns the numbers, (n,), and the next one that is free.
    """
    track = np.full(len(centre), -1, dtype=np.intp)
    if views and len(centre) and len(views[-1].track):
        last = views[-1]
        expected = last.centre.copy()
        if len(views) > 1:
            _, before, now = np.intersect1d(views[-2].track, last.track, return_indices=True)
            step = last.centre[now] - views[-2].centre[before]
            expected[now] += step * (views[-1].stamp - views[-2].stamp < 0.1)
        distance = np.linalg.norm(centre[:, None] - expected[None], axis=2)
        nearest = distance.argmin(axis=1)
        mutual = distance.argmin(axis=0)[nearest] == np.arange(len(centre))
        same = mutual & (distance[np.arange(len(centre)), nearest] < 6.0)
        track[same] = last.track[nearest[same]]
    new = np.flatnonzero(track < 0)
    track[new] = next_track + np.arange(len(new))
    return track, next_track + len(new)


def still_while_two_turned(views: tuple[BufferedFrame, ...], tracker: Tracker) -> Array | None:
    """Places, (k, 2) px, of points that stayed while two others moved as the ball makes them move.

    None while there is no such pair. Two points on a ball that turns keep their angle; two that are carried past it
    keep their offset in the picture. Over a long path only one of the two holds.
    """
    now = views[-1]
    for view in views[:-1]:
        _, first, last = np.intersect1d(view.track, now.track, return_indices=True)
        path = np.linalg.norm(now.centre[last] - view.centre[first], axis=1)
        moved, still = path > _PATH * MOVED_PX, path < STILL_PX
        if np.count_nonzero(moved) != 2 or np.count_nonzero(still) > (view is views[0]):
            continue  # both kinds must be in view from the first frame: a later one passed by
        pair = view.points.take(first[moved]), now.points.take(last[moved])
        rotation = align(pair[0].direction, pair[1].direction)
        turned = pair[0].direction @ rotation.T - pair[1].direction
        variance = sum(_variance(points, tracker.rig.ball.radius) for points in pair)
        as_turn = float(np.sum(np.sum(turned**2, axis=1) / variance))
        step = now.centre[last[moved]] - view.centre[first[moved]]
        as_shift = float(np.sum((step - step.mean(axis=0)) ** 2) / (2.0 * _CENTRE_SIGMA**2))
        if as_turn < _FITS and as_shift > as_turn + _BETTER:
            index = last[still]
            return now.centre[index][would_move(now.points.take(index), rotation, tracker, MOVED_PX)]
    return None


def _variance(points: SpherePoints, radius: float) -> Array:
    """Variance, (n,) rad², of a direction along one axis."""
    return np.trace(points.image_covariance, axis1=1, axis2=2) / (2.0 * radius**2)


def would_move(points: SpherePoints, rotation: Array, tracker: Tracker, least: float) -> NDArray[np.bool_]:
    """Return a mask, (n,), of the points that `rotation`, (3, 3), would have moved by `least` px or more."""
    radius, centre = tracker.rig.ball.radius, tracker.rig.ball.centre
    uv = [
        project(tracker.pose.to_cam(centre + radius * d), tracker.rig.camera)[0]
        for d in (points.direction, points.direction @ rotation)
    ]
    return np.linalg.norm(uv[0] - uv[1], axis=1) > least
