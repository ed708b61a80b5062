"""Parameters of the so3 filter, with the acceleration that they mean."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from spheremouse.ball.rig import MOST_DISCS
from spheremouse.geometry.rotation import Array
from spheremouse.settings import FACTOR, FRAMES, HAND_TURN, SECONDS, SIGMAS, param


@dataclass(frozen=True, slots=True)
class So3Settings:
    """Motion model, gates and map."""

    acceleration_sigma: float = param(
        0.1,
        "rad/s²",
        "standard deviation of the angular acceleration per axis at the quiet level: a ball left to roll",
        ge=1e-3,  # slower than the friction of any bearing
        le=100,  # a stop by hand
    )
    persistence: float = param(
        0.2,
        "s",
        "mean time between two steps of the acceleration, as a hand takes hold, lets go or stops the ball",
        ge=0.01,
        le=10,
    )
    start_rate_sigma: float = param(
        2.0,
        "rad/s",
        "standard deviation of the rate at the start, about zero: the ball may be rolling by then",
        **HAND_TURN,
    )
    gate: float = param(
        13.8, "-", "squared Mahalanobis distance of a pair: 99.9 % of chi-square with 2 degrees", **SIGMAS
    )
    levels: tuple[float, ...] = param(
        (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0),
        "-",
        "factors on that acceleration that the player may be at, each as rare as it is large: roll, turn, push, flick, "
        "and a stop by hand (100 rad/s²)",
        ge=1,
        le=1e4,  # of the quietest ball, a stop by hand
        most=12,  # a factor of two apart; each takes its time
    )
    dwell: float = param(1.0, "s", "mean time the player stays at a level: a gesture takes about a second", **SECONDS)
    trial: int = param(3, "frames", "sightings until a disc is kept for good", **FRAMES)
    misses: int = param(3, "frames", "a disc on trial is dropped when it is not seen where it should be", **FRAMES)
    patience: float = param(
        5.0,
        "-",
        "a kept disc is dropped when missed in a row so many times as often as seen: no disc after all",
        **FACTOR,
    )
    most_discs: int = param(
        120,
        "discs",
        "the map grows no larger: the time per frame, which grows with the square, stays bounded",
        ge=4,
        le=MOST_DISCS,
    )

    def __post_init__(self) -> None:
        if not self.levels or list(self.levels) != sorted(self.levels):
            raise ValueError("levels: factors from 1 to 10000 in rising order")


@cache
def squared_levels(levels: tuple[float, ...]) -> Array:
    """Variances of the levels over that of the first."""
    return np.square(np.array(levels) / levels[0])


@cache
def variances(settings: So3Settings) -> Array:
    """Return the variance of the angular acceleration at each level, (l,) (rad/s²)² per axis."""
    return np.square(settings.acceleration_sigma * np.array(settings.levels))


@cache
def prior_of_levels(levels: tuple[float, ...]) -> Array:
    """Probabilities of the levels before anything is seen: the livelier the rarer."""
    usual = 1.0 / np.array(levels)
    return usual / usual.sum()


def usual_acceleration(settings: So3Settings) -> float:
    """Standard deviation per axis, rad/s², before anything is seen: the levels' mean square."""
    return float(np.sqrt(variances(settings) @ prior_of_levels(settings.levels)))
