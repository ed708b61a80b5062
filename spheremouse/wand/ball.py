"""Hand-held balls: their discs, their frame and their true motion.

The frame `ball` has its origin at the centre, z towards the pole (away from stick or robot), x at azimuth 0 and y at
azimuth 90°, counter-clockwise seen from above: right-handed. Balls after Grzonka 2005, sections 3.4.1 and 5.2.
"""

from dataclasses import dataclass

import numpy as np

from spheremouse.geometry.rotation import Array

_OUTER_POINTS = 0.65  # of a disc's radius, default of its four outer points: between the thesis' 0.48 and 0.69


@dataclass(frozen=True, slots=True)
class WandDisc:
    """Disc on a ball: a spherical cap."""

    direction: Array  # (3,) unit vector of its centre, ball
    angle: float  # rad, angular radius
    colour: str  # "red", "blue", "dark", "light": a key of the colour settings
    points_angle: float  # rad from the centre to the four outer points of the thesis' likelihood


@dataclass(frozen=True, slots=True)
class WandBall:
    """Ball with its discs."""

    name: str
    radius: float  # m
    discs: tuple[WandDisc, ...]
    body: str = "white"  # colour between the discs: "white" or "black"

    @property
    def colours(self) -> tuple[str, ...]:
        """Colours of the discs in alphabetical order."""
        return tuple(sorted({d.colour for d in self.discs}))


@dataclass(frozen=True, slots=True)
class WandTruth:
    """True motion of a ball, one row per frame."""

    stamp: Array  # (n,) s
    position: Array  # (n, 3) m, centre in cam
    rotation: Array  # (n, 3, 3) R_cam_ball

    def __len__(self) -> int:
        return len(self.stamp)


def wand_disc(
    azimuth: float, latitude: float, angle: float, colour: str, points_angle: float | None = None
) -> WandDisc:
    """Return a disc from azimuth, latitude and angular radius, rad."""
    direction = np.array([np.cos(latitude) * np.cos(azimuth), np.cos(latitude) * np.sin(azimuth), np.sin(latitude)])
    return WandDisc(direction, angle, colour, _OUTER_POINTS * angle if points_angle is None else points_angle)


def grzonka_ball() -> WandBall:
    """Return the ball of Grzonka 2005, section 3.4.1: 10 cm, red and blue discs of 2.1 and 3.5 cm at four azimuths.

    The colours of upper and lower disc are a Gray code: (red, red), (red, blue), (blue, blue), (blue, red). The thesis
    prints no latitudes; those of the shared recording are 55° and 15°. A disc's diameter is that of its rim.
    """
    radius = 0.05
    upper, lower = np.arcsin(0.0105 / radius), np.arcsin(0.0175 / radius)
    code = (("red", "red"), ("red", "blue"), ("blue", "blue"), ("blue", "red"))
    discs = []
    for i, (above, below) in enumerate(code):
        azimuth = i * np.pi / 2
        discs.append(wand_disc(azimuth, np.deg2rad(55), upper, above, 0.005 / radius))
        discs.append(wand_disc(azimuth, np.deg2rad(15), lower, below, 0.012 / radius))
    return WandBall("grzonka", radius, tuple(discs))
