"""Parameters of the wand's tracking."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from spheremouse.settings import HAND, HAND_TURN, PART, SECONDS, Bounds, param

# A random walk in 1.25 s, m or rad: a tenth of a millimetre is less than the pictures tell, 3 is across the room or to
# the ball's other side.
WALK: Bounds = {"ge": 1e-4, "le": 3.0}
# From a camera, m: nearer it is out of focus; farther, the largest ball (1 m radius) is a few pixels across.
DISTANCE: Bounds = {"ge": 0.01, "le": 100.0}


@dataclass(frozen=True, slots=True)
class WandSettings:
    """Parameters of the wand's tracker."""

    particles: int = param(
        350, "-", "particles; the thesis needs as many to keep the ball; each takes its time", ge=10, le=5000
    )
    proposal: Literal["peaks", "motion"] = param(
        "peaks", "-", "particles are drawn towards the likelihood's peaks, or by motion alone as in the thesis"
    )
    likelihood: Literal["rims", "product", "edges"] = param(
        "rims",
        "-",
        "by motion alone: ours; the thesis' product of the blurred pictures at its five points a disc; edges",
    )
    region: bool = param(True, "-", "look only at the region where the ball can be")
    outline: bool = param(True, "-", "the ball's outline as a further cue for the distance")
    adaptive: bool = param(True, "-", "motion goes on with the last velocity, besides resting and starting anew")
    sigma_x: float = param(0.045, "m", "random walk in 1.25 s, as the thesis' robot", **WALK)
    sigma_y: float = param(0.045, "m", "the same downward: a hand moves every way (the thesis' robot: 0.005)", **WALK)
    sigma_z: float = param(0.045, "m", "the same away from the camera", **WALK)
    sigma_pitch: float = param(0.15 * np.pi, "rad", "about x in 1.25 s (the thesis' robot: 0.005 pi)", **WALK)
    sigma_yaw: float = param(0.15 * np.pi, "rad", "about y", **WALK)
    sigma_roll: float = param(0.15 * np.pi, "rad", "about z (the thesis' robot: 0.005 pi)", **WALK)
    acceleration: float = param(2.5, "m/s²", "of a hand: 0.4 m/s to and fro once a second", **HAND)
    turn_acceleration: float = param(20.0, "rad/s²", "of a wrist: 180 °/s to and fro once a second", **HAND_TURN)
    fastest: float = param(1.0, "m/s", "a start from rest between two frames", **HAND)
    fastest_turn: float = param(6.0, "rad/s", "the same for rotation", **HAND_TURN)
    nearest: float = param(0.2, "m", "least distance at which the ball is looked for", **DISTANCE)
    farthest: float = param(
        8.0, "m", "greatest distance: the ball is then 26 px across at a focal length of 2100", **DISTANCE
    )
    match: float = param(
        0.65, "-", "part of the coloured points in view that must show: a hand may hide a third", **PART
    )
    evidence: float = param(
        25.0, "-", "log-likelihood ratio that no background reaches: there are e^23 poses to choose from", ge=1, le=1e4
    )
    lost_after: float = param(0.5, "s", "unseen for so long the prediction is a guess", **SECONDS)
    look_around: float = param(1.0, "s", "between searches of the whole picture for a better ball", **SECONDS)

    def __post_init__(self) -> None:
        if self.nearest >= self.farthest:
            raise ValueError(f"nearest: {self.nearest:g} m is not below farthest, {self.farthest:g} m: no room is left")
