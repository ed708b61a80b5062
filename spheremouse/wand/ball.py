"""The hand-held ball: its discs in the ball's own frame, and Grzonka's left-handed frame converted once.

The frame `ball`: origin at the centre, z towards the pole (away from stick or robot), x at azimuth 0, y at azimuth 90°,
counter-clockwise seen from above: right-handed. Balls after Grzonka 2005, sections 3.4.1 and 5.2.
"""

from dataclasses import dataclass

import numpy as np

from spheremouse.geometry.rotation import Array

_POINTS_AT = 0.65  # of a disc's radius, its four outer points, where nobody says: between the thesis' 0.48 and 0.69
_FLIP = np.diag([1.0, -1.0, 1.0])  # x right, y up, z away (left-handed) to x right, y down, z forward


@dataclass(frozen=True, slots=True)
class WandDisc:
    """A disc on the ball: a spherical cap."""

    direction: Array  # (3,) unit vector of its centre, ball
    angle: float  # rad, angular radius
    colour: str  # "red", "blue", "dark", "light": a key of the colour settings
    points_angle: float  # rad from the centre to the four outer points of the thesis' likelihood


@dataclass(frozen=True, slots=True)
class WandBall:
    """A ball with its discs."""

    name: str
    radius: float  # m
    discs: tuple[WandDisc, ...]
    body: str = "white"  # of the ball between the discs: "white" or "black"

    @property
    def colours(self) -> tuple[str, ...]:
        """Colours of the discs, each once, in alphabetical order."""
        return tuple(sorted({d.colour for d in self.discs}))


def wand_disc(
    azimuth: float, latitude: float, angle: float, colour: str, points_angle: float | None = None
) -> WandDisc:
    """A disc by azimuth, latitude and angular radius, rad."""
    direction = np.array([np.cos(latitude) * np.cos(azimuth), np.cos(latitude) * np.sin(azimuth), np.sin(latitude)])
    return WandDisc(direction, angle, colour, _POINTS_AT * angle if points_angle is None else points_angle)


def grzonka_ball() -> WandBall:
    """The ball of Grzonka 2005, section 3.4.1: 10 cm, discs of 2.1 and 3.5 cm at four azimuths, red and blue.

    The colours of upper and lower disc go through the Gray code, (red, red), (red, blue), (blue, blue), (blue, red).
    The latitudes, which the thesis does not print, are those of the shared recording: 55° and 15°. A disc's diameter
    is that of its rim.
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


# Azimuth, latitude, angular radius in degrees. One colour carries no code, so the places do: sizes in turn, gaps along
# each row all different, rows that reach both halves, so that four or more are in view from wherever one looks.
_UNEVEN = (
    (0, 52, 14), (75, 48, 9), (130, 58, 11), (215, 45, 15), (290, 55, 8),
    (25, 8, 12), (62, 0, 8), (112, 12, 15), (165, -2, 9), (205, 5, 11), (262, 10, 14), (318, 2, 9),
    (10, -42, 9), (85, -38, 14), (150, -50, 11), (235, -36, 8), (300, -45, 15),
)  # fmt: skip


def contrast_ball() -> WandBall:
    """One colour, dark on white, after the outlook of Grzonka 2005 (section 5.2, figure 25): marks at uneven places.

    The thesis sketches lines whose heights follow the Gray code, with blocks at uneven distances. Discs of three sizes
    at uneven distances carry the same information, and their rims measure in every direction.
    """
    return _uneven("contrast", "dark", "white")


def led_ball() -> WandBall:
    """Lit discs (light-emitting diodes behind diffusers) on a black ball, at the places of `contrast_ball`."""
    return _uneven("led", "light", "black")


def _uneven(name: str, colour: str, body: str) -> WandBall:
    rows = np.deg2rad(np.array(_UNEVEN, dtype=float))
    discs = tuple(wand_disc(azimuth, latitude, angle, colour) for azimuth, latitude, angle in rows)
    return WandBall(name, 0.05, discs, body)


def from_left_handed(position: Array, rotation: Array) -> tuple[Array, Array]:
    """Position, (..., 3) m, and rotation, (..., 3, 3), from Grzonka's frame (x right, y up, z away) to `cam`.

    The flip of one axis turns the sense of every rotation: R = F R_left F with F = diag(1, -1, 1). It is its own
    inverse, so this is also the way back.
    """
    return position @ _FLIP, _FLIP @ rotation @ _FLIP
