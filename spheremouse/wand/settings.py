"""Parameters of the wand's tracker, and the bounds of its colours."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from spheremouse.settings import HAND, HAND_TURN, PART, SECONDS, Bounds, param

# m or rad in 1.25 s: 0.1 mm is below the resolution of the pictures, 3 is across the room or half a turn
WALK: Bounds = {"ge": 1e-4, "le": 3.0}
# m from the camera: a nearer ball is out of focus, a farther one of 1 m radius is a few pixels across
DISTANCE: Bounds = {"ge": 0.01, "le": 100.0}


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
    proposal: Literal["peaks", "motion"] = param(
        "peaks",
        "-",
        "peaks: draw particles near the likelihood's peaks; motion: from the motion alone, as in the thesis",
    )
    likelihood: Literal["rims", "product", "edges"] = param(
        "rims",
        "-",
        "with `proposal` motion: rims is the default likelihood, product that of the thesis, edges ignores colours",
    )
    region: bool = param(True, "-", "search only the part of the picture that the ball can reach")
    outline: bool = param(True, "-", "measure the ball's outline too, which gives the distance")
    adaptive: bool = param(
        True, "-", "predict by the last velocity, rest and sudden starts; false: by a random walk alone"
    )
    sigma_x: float = param(
        0.045, "m", "standard deviation along x of the random walk in 1.25 s, as the thesis' robot", **WALK
    )
    sigma_y: float = param(0.045, "m", "the same downwards (the thesis' robot: 0.005)", **WALK)
    sigma_z: float = param(0.045, "m", "the same away from the camera", **WALK)
    sigma_pitch: float = param(
        0.15 * np.pi, "rad", "the same of the rotation about x (the thesis' robot: 0.005 pi)", **WALK
    )
    sigma_yaw: float = param(0.15 * np.pi, "rad", "the same of the rotation about y", **WALK)
    sigma_roll: float = param(
        0.15 * np.pi, "rad", "the same of the rotation about z (the thesis' robot: 0.005 pi)", **WALK
    )
    acceleration: float = param(
        2.5, "m/s²", "greatest acceleration of a hand: 0.4 m/s to and fro once a second", **HAND
    )
    turn_acceleration: float = param(
        20.0, "rad/s²", "greatest angular acceleration of a wrist: 180 °/s to and fro once a second", **HAND_TURN
    )
    fastest: float = param(1.0, "m/s", "speed of a sudden start between two frames", **HAND)
    fastest_turn: float = param(6.0, "rad/s", "angular speed of a sudden start", **HAND_TURN)
    nearest: float = param(0.2, "m", "least distance at which the tracker searches", **DISTANCE)
    farthest: float = param(
        8.0, "m", "greatest distance; at 8 m and a focal length of 2100 px the ball is 26 px across", **DISTANCE
    )
    match: float = param(
        0.65,
        "-",
        "fraction of the visible coloured points that must show their colour: a hand can hide a third",
        **PART,
    )
    evidence: float = param(
        25.0,
        "-",
        "least log-likelihood ratio of a ball; the search compares e^23 poses, so 25 excludes chance",
        ge=1,
        le=1e4,
    )
    lost_after: float = param(0.5, "s", "after this time without a measurement the ball is lost", **SECONDS)
    look_around: float = param(1.0, "s", "time between two searches of the whole picture for a better pose", **SECONDS)

    def __post_init__(self) -> None:
        if self.nearest >= self.farthest:
            raise ValueError(f"nearest: {self.nearest:g} m is not below farthest, {self.farthest:g} m: no room is left")
