"""Parameters of the so3 filter, with the acceleration that they mean."""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels
from spheremouse.settings import param

PERSISTENCE_S = 0.2  # mean time between two steps of the acceleration: a hand takes hold, lets go or stops the ball
DRIFT = 0.1  # share of a level by which the acceleration drifts between two steps: no hand pushes evenly
DWELL_S = 1.0  # mean time at a level of acceleration: a gesture takes about a second
HIDDEN_SHARE = kernels.HIDDEN_SHARE  # of the discs that face the camera: struts and hands before them
FALSE_SHARE = 0.25  # of the points that found a disc: half a false point in view beside the one or two of a few discs
UNKNOWN_RATE_FACTOR = 2.5  # on `start_rate_sigma`, for a ball that may be in motion: 5 rad/s per axis
ESTABLISHED_HITS = kernels.ESTABLISHED_HITS  # frames in which a disc is seen until it is established


@dataclass(frozen=True, slots=True)
class So3Settings:
    """Motion model of the default filter."""

    acceleration_sigma: float = param(
        0.1,
        "rad/s²",
        "standard deviation of the angular acceleration per axis at the quiet level: a ball left to roll",
        ge=1e-3,  # slower than the friction of any bearing
        le=100,  # a stop by hand
    )
    # Not a setting, since it follows from chance: squared Mahalanobis distance of a pair, 99.9 % of chi-square with 2
    # degrees of freedom.
    gate: float = 13.8
    # Not a setting, since the filter finds the level by itself: rising factors on that acceleration that the player may
    # be at, each as rare as it is large: roll, turn, push, flick, and a stop by hand (100 rad/s²).
    levels: tuple[float, ...] = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0)
    # Not a setting: size of the map, since the time per frame grows with its square. Half of 120 discs are in view.
    most_discs: int = 120
    # Not a setting, since no user can know it: rad/s per axis about zero; the ball may roll at the start.
    start_rate_sigma: float = 2.0


@cache
def squared_levels(levels: tuple[float, ...]) -> Array:
    """Variances of the levels over that of the first, (l,)."""
    return np.square(np.array(levels) / levels[0])


@cache
def prior_of_levels(levels: tuple[float, ...]) -> Array:
    """Probabilities of the levels, (l,), before the first observation; they fall with the acceleration."""
    usual = 1.0 / np.array(levels)
    return usual / usual.sum()


class Activity(NamedTuple):
    """Levels of the player's acceleration, and their changes."""

    gate: float
    persistence: float  # s, mean time between two steps
    dwell: float  # s, mean time at a level
    variances: Array  # (l,) (rad/s²)² per axis, of the acceleration
    drift: Array  # (l,) process noise by the drift of the acceleration, over that of the first level
    usual: Array  # (l,) probabilities before the first observation


@cache
def activity_of(settings: So3Settings) -> Activity:
    """Return the activity of a player that the settings describe, for the kernels."""
    levels = settings.levels
    steps, drift = np.square(settings.acceleration_sigma * np.array(levels)), DRIFT**2 * squared_levels(levels)
    return Activity(settings.gate, PERSISTENCE_S, DWELL_S, steps, drift, prior_of_levels(levels))


def usual_acceleration(settings: So3Settings) -> float:
    """Standard deviation per axis, rad/s², before anything is seen: the levels' mean square."""
    activity = activity_of(settings)
    return float(np.sqrt(activity.variances @ activity.usual))
