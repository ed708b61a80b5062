"""Parameters of the wand's tracker, and the bounds of its colours."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from spheremouse.settings import HAND, HAND_TURN, SECONDS, param


@dataclass(frozen=True, slots=True)
class ColourSettings:
    """Six bounds that select a colour (Grzonka 2005, section 3.4.2)."""

    hue_min: float = param(0.0, "deg", "least hue, 0 to 360; above hue_max the range passes through 0", ge=0, le=360)
    hue_max: float = param(360.0, "deg", "greatest hue", ge=0, le=360)
    saturation_min: float = param(0.0, "-", "least saturation, 0 to 255", ge=0, le=255)
    saturation_max: float = param(255.0, "-", "greatest saturation", ge=0, le=255)
    value_min: float = param(0.0, "-", "least brightness after normalisation to a mean of 127", ge=0, le=1e4)
    value_max: float = param(1e4, "-", "greatest brightness after normalisation", ge=0, le=1e4)


@dataclass(frozen=True, slots=True)
class WandSettings:
    """Parameters of the wand's tracker."""

    particles: int = param(
        350, "-", "number of particles; the time for a frame grows with it; the thesis uses 350", ge=10, le=5000
    )
    method: Literal["peaks", "product", "rims"] = param(
        "peaks",
        "-",
        "peaks: draw particles near the likelihood's peaks. The others draw from the motion alone, as in the thesis: "
        "product has its likelihood, rims has the default likelihood",
    )
    acceleration: float = param(
        2.5, "m/s²", "greatest acceleration of a hand: 0.4 m/s to and fro once a second", **HAND
    )
    turn_acceleration: float = param(
        20.0, "rad/s²", "greatest angular acceleration of a wrist: 180 °/s to and fro once a second", **HAND_TURN
    )
    farthest: float = param(
        8.0,
        "m",
        "greatest distance; at 8 m and a focal length of 2100 px the ball is 26 px across",
        ge=0.3,  # beyond `nearest`
        le=100,  # a ball of 1 m radius is a few pixels across
    )
    lost_after: float = param(0.5, "s", "after this time without a measurement the ball is lost", **SECONDS)
    # Not settings: parts of the published method, which the experiments change.
    region: bool = True  # search only the part of the picture that the ball can reach
    outline: bool = True  # measure the ball's outline too, which gives the distance
    adaptive: bool = True  # predict by the last velocity, rest and sudden starts; False: by a random walk alone
    # Standard deviations of that walk in 1.25 s along x, y, z (m) and about them (rad). The thesis' robot has 0.005 m
    # downwards and 0.005 pi in pitch and roll.
    sigma_x: float = 0.045
    sigma_y: float = 0.045
    sigma_z: float = 0.045
    sigma_pitch: float = 0.15 * np.pi
    sigma_yaw: float = 0.15 * np.pi
    sigma_roll: float = 0.15 * np.pi
    # Not settings, since they follow from a lens, a hand and chance.
    nearest: float = 0.2  # m, least distance; a nearer ball is out of focus
    fastest: float = 1.0  # m/s, of a sudden start between two frames
    fastest_turn: float = 6.0  # rad/s, of a sudden start
    match: float = 0.65  # fraction of the visible coloured points that must show their colour; a hand can hide a third
    evidence: float = 25.0  # least log-likelihood ratio of a ball; the search compares e^23 poses
    look_around: float = 1.0  # s between two searches of the whole picture for a better pose
