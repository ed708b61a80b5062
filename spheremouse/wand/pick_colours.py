"""Bounds of a ball's colours from one picture of the ball, and a picture of the selected pixels.

The tracker's search finds the ball, or the user gives its circle. The pixels of a colour are those near its hue inside
the circle. The bound on saturation is half way between body and discs; light mixes before the camera's gamma, so the
selected rims are some tenths of a pixel inside the discs. If a bound selects much beside the ball, it becomes as narrow
as the discs allow.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.errors import ConfigurationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame
from spheremouse.wand.ball import WandBall
from spheremouse.wand.build import build
from spheremouse.wand.colour import DEFAULT_COLOURS, MEAN_BRIGHTNESS, colour_fields, picture_colours
from spheremouse.wand.settings import ColourSettings, WandSettings
from spheremouse.wand.track import begin, step

HUES = {"red": 0.0, "orange": 30.0, "yellow": 55.0, "green": 125.0, "blue": 230.0, "purple": 285.0, "pink": 330.0}
_MAX_HUE_DISTANCE = 40.0  # deg of a print's red from red
_MIN_SATURATION = 60.0  # of 255, of a colour: less is plain
_MIN_PIXELS = 12  # of a colour
_HUE_MARGIN = 8.0  # deg around the measured hues: light varies more than in one picture
_INNER_RADIUS = 0.93  # of the ball's: edge pixels mix with the background
_MIN_RADIUS_PX = 8.0  # of a ball that the search finds
_MAX_RADIUS_PART = 0.45  # of the picture's shorter side: radius of a ball that the search finds
_MIN_SATURATIONS = (95.0, 150.0)  # of 255, least of discs in white light, and in light that colours all of the picture
_WIDE_HUE = 24.0  # deg around the hue of a name
_MIN_VALUE = 15.0  # normalised brightness of a disc
_MAX_SEARCHES = 12  # each of as many assignments of spots to discs as the tracker tries in a frame
_MAX_DARK_BRIGHTNESS = 40.0  # of 255, mean brightness of a dark picture
_MAX_FRACTION = 0.5  # of the picture: bounds that select more are useless
_NEGLIGIBLE_FRACTION = 0.02  # fraction of the pixels beside the ball, or of the discs
_OUTER_RADIUS = 1.15  # of the ball's: beyond is the background
_MARKS = {"red": (60, 60, 255), "blue": (255, 90, 40), "dark": (255, 0, 255), "light": (255, 0, 255)}  # BGR


@dataclass(frozen=True, slots=True)
class Circle:
    """Outline of the ball in a picture."""

    u: float  # px
    v: float  # px
    radius: float  # px


@dataclass(frozen=True, slots=True)
class PickedBounds:
    """Bounds, and the fractions of their picture that they select."""

    circle: Circle
    colours: dict[str, ColourSettings]
    inside: dict[str, float]  # fraction of the ball's pixels that each selects
    outside: dict[str, float]  # fraction of all other pixels

    def stray_colours(self) -> list[str]:
        """Return the colours that select more than a negligible part of the background."""
        return [name for name, fraction in self.outside.items() if fraction > _NEGLIGIBLE_FRACTION]


def pick_bounds(image: NDArray[np.uint8], ball: WandBall, circle: Circle | None = None) -> PickedBounds:
    """Return bounds for the colours of a ball's discs from a picture, (h, w, 3) BGR, that separate them from the rest.

    `circle` is the ball's outline; None: search for it. Hue in degrees and saturation of 255 are those of `hsv`;
    brightness is normalised as by the tracker. Raises ConfigurationError if the picture shows no ball or no discs of
    one of the colours, or if bounds select half of the picture.
    """
    circle = find_ball(image, ball) if circle is None else _check_circle(circle, image)
    hue, saturation, value = hsv(image)
    gain = MEAN_BRIGHTNESS / max(picture_colours(image, DEFAULT_COLOURS, ("light",)).mean, 1.0)
    inner = circle_mask(image.shape[:2], circle, _INNER_RADIUS)
    background = ~circle_mask(image.shape[:2], circle, _OUTER_RADIUS)
    ours, rest = ((hue[where], saturation[where], gain * value[where]) for where in (inner, background))
    colours = {}
    for name in ball.colours:
        if name in ("dark", "light"):
            colours[name] = _by_brightness(name, ours[2], rest[2])
        else:
            colours[name] = _by_hue(name, ours, rest)
    return check_bounds(
        image, colours, circle, "take a picture with more light on the ball, or with another background"
    )


def check_bounds(
    image: NDArray[np.uint8],
    colours: dict[str, ColourSettings],
    circle: Circle,
    remedy: str = "narrow them, or have others picked without --check",
) -> PickedBounds:
    """Return the fractions of a picture (h, w, 3) BGR that bounds select inside a circle and elsewhere.

    Raises ConfigurationError if they select nothing on the ball, or half of the picture; `remedy` advises on the
    latter.
    """
    selected = colour_fields(image, colours, tuple(colours))
    ball = circle_mask(image.shape[:2], circle, 1.0)
    inside, outside = {}, {}
    for name, binary in zip(colours, selected.binary, strict=True):
        inside[name] = float(np.mean(binary[ball] > 0))
        outside[name] = float(np.mean(binary[~ball] > 0)) if not ball.all() else 0.0
        fraction = float(np.mean(binary > 0))
        if not np.any(binary[ball]):
            raise ConfigurationError(
                f"{name}: the bounds select nothing on the ball; pick them again from this picture"
            )
        if fraction > _MAX_FRACTION:
            raise ConfigurationError(f"{name}: the bounds select {100 * fraction:.0f} % of the picture; {remedy}")
    return PickedBounds(circle, colours, inside, outside)


def hsv(image: NDArray[np.uint8]) -> tuple[Array, Array, Array]:
    """Return hue in degrees, saturation and brightness 0 to 255, (h, w) each, of a picture (h, w, 3) BGR."""
    converted = cv2.cvtColor(image.astype(np.float32) / 255.0, cv2.COLOR_BGR2HSV)
    hue, saturation, value = (converted[..., i].astype(float) for i in range(3))
    return hue, 255.0 * saturation, 255.0 * value


def hue_distance(hue: Array, name: str) -> Array:
    """Return the distance of hues (degrees, any shape) from the hue of a named colour, 0 to 180 degrees."""
    return np.abs((hue - HUES[name] + 180.0) % 360.0 - 180.0)


def circle_mask(shape: tuple[int, ...], circle: Circle, scale: float) -> NDArray[np.bool_]:
    """Return the pixels, (h, w), within `scale` radii of a circle's centre."""
    v, u = np.ogrid[: shape[0], : shape[1]]
    return np.asarray((u - circle.u) ** 2 + (v - circle.v) ** 2 < (scale * circle.radius) ** 2)


# ---- the ball ----


def find_ball(image: NDArray[np.uint8], ball: WandBall) -> Circle:
    """Return the outline of a ball in a picture (h, w, 3) BGR: the tracker's search, with wide bounds of its colours.

    The lens is unknown, and its focal length does not change the outline. Raises ConfigurationError if there is no
    ball.
    """
    h, w = image.shape[:2]
    focal = float(max(h, w))
    camera = InteriorOrientation(w, h, focal, focal, 0.5 * (w - 1), 0.5 * (h - 1))
    distances = WandSettings(
        nearest=ball.radius * focal / (_MAX_RADIUS_PART * min(h, w)), farthest=ball.radius * focal / _MIN_RADIUS_PX
    )
    for saturation in _MIN_SATURATIONS:
        bounds = {name: _wide_bounds(name, saturation) for name in ball.colours}
        tracker = build(camera, (ball,), distances, bounds)
        state = begin(tracker)
        for k in range(_MAX_SEARCHES):
            state = step(state, Frame(image, 0.0, k), tracker).state
            if (found := state.poses[0].position) is not None:
                x, y, z = found.tolist()
                radius = focal * ball.radius / math.sqrt(z * z - ball.radius**2)
                return Circle(camera.cx + focal * x / z, camera.cy + focal * y / z, radius)
            if state.tracks[0].next_spot == 0:
                break
    light, brightness = "", picture_colours(image, DEFAULT_COLOURS, ("light",)).mean
    if brightness < _MAX_DARK_BRIGHTNESS:
        light = f"the picture is dark (mean brightness {brightness:.0f} of 255): give more light or a longer exposure, "
    raise ConfigurationError(
        f"no ball with {' and '.join(ball.colours)} discs on {ball.body} is in view; {light}"
        "turn two discs of each colour to the camera, or give its place with --at U,V,RADIUS (px)"
    )


def _wide_bounds(name: str, saturation: float) -> ColourSettings:
    """Return bounds that a disc of a named colour meets in any light, if its saturation is above the given one."""
    if name in DEFAULT_COLOURS and name not in HUES:
        return DEFAULT_COLOURS[name]
    _check_name(name)
    low, high = ((HUES[name] + by) % 360.0 for by in (-_WIDE_HUE, _WIDE_HUE))
    return ColourSettings(hue_min=low, hue_max=high, saturation_min=saturation, value_min=_MIN_VALUE)


def _check_circle(circle: Circle, image: NDArray[np.uint8]) -> Circle:
    h, w = image.shape[:2]
    if not (0 <= circle.u < w and 0 <= circle.v < h and 4.0 <= circle.radius <= max(h, w)):
        raise ConfigurationError(
            f"--at {circle.u:g},{circle.v:g},{circle.radius:g}: not in a picture of {w}x{h} px; "
            "give the ball's centre and radius in px, from 4 px"
        )
    return circle


# ---- bounds ----


def _check_name(name: str) -> None:
    if name not in HUES:
        raise ConfigurationError(
            f"colour {name!r}: bounds are picked for dark, light, {', '.join(HUES)}; write those of others by hand"
        )


def _by_hue(name: str, ball: tuple[Array, Array, Array], rest: tuple[Array, Array, Array]) -> ColourSettings:
    """Return bounds around a hue from (n,) hues, saturations and normalised brightnesses on the ball, and beside it."""
    _check_name(name)
    hue, saturation, value = ball
    like = (hue_distance(hue, name) < _MAX_HUE_DISTANCE) & (saturation > _MIN_SATURATION)
    body = float(np.median(saturation))  # most pixels are body, which coloured light saturates
    if np.any(like):
        like &= saturation > body + 0.4 * (float(np.quantile(saturation[like], 0.98)) - body)
    if np.count_nonzero(like) < _MIN_PIXELS:
        raise ConfigurationError(
            f"{name}: no such disc on the ball ({np.count_nonzero(like)} px); turn one to the camera, or is the light "
            "so weak or coloured that it does not look like one?"
        )
    full = float(np.quantile(saturation[like], 0.75))  # of a disc's middle; rims mix with white
    deep = like & (saturation > 0.7 * full)
    off = (hue[deep] - HUES[name] + 180.0) % 360.0 - 180.0
    low, high = np.quantile(off, [0.02, 0.98]) + HUES[name]
    low, high = low - _HUE_MARGIN, high + _HUE_MARGIN
    darkest = 0.5 * float(np.quantile(value[deep], 0.02))
    alike = ((rest[0] - low) % 360.0 <= high - low) & (rest[2] >= darkest)
    return ColourSettings(
        hue_min=round(float(low) % 360.0),
        hue_max=round(float(high) % 360.0),
        saturation_min=round(_narrow(0.5 * (full + body), saturation[like], rest[1][alike], len(rest[1]))),
        value_min=round(darkest),
    )


def _by_brightness(name: str, value: Array, rest: Array) -> ColourSettings:
    """Return a bound half way between discs and body from normalised brightnesses, (n,), on the ball and beside it."""
    top = float(value.max())
    levels = np.clip(255.0 * value / max(top, 1.0), 0.0, 255.0).astype(np.uint8)
    cut, _ = cv2.threshold(levels.reshape(-1, 1), 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    cut = cut * top / 255.0
    below, above = value[value <= cut], value[value > cut]
    if len(below) < _MIN_PIXELS or len(above) < _MIN_PIXELS or np.median(above) < 1.6 * np.median(below):
        raise ConfigurationError(
            f"{name}: discs and ball are equally bright in this picture; more light, or other discs"
        )
    if name == "dark":
        halfway = 0.5 * float(np.median(below) + np.median(above))
        return ColourSettings(value_max=round(-_narrow(-halfway, -below, -rest, len(rest))))
    # nothing is brighter than lit discs, so the bound is as close to them as their spread allows
    near = 0.85 * float(np.quantile(above, 0.2))
    return ColourSettings(value_min=round(_narrow(near, above, rest, len(rest))))


def _narrow(loosest: float, disc: Array, rest: Array, pixels: int) -> float:
    """Return a lower bound between values (n,) of discs and (m,) of the background, which has `pixels` in all.

    It minimises the sum of two fractions: of the discs left out, and of the background selected (Youden 1950). With a
    sum of pixels instead, the background, a hundred times larger, would decide alone. The result is `loosest` if
    that is as good as the best, else the middle of the best bounds.
    """
    disc, rest = np.sort(disc[disc >= loosest]), np.sort(rest[rest >= loosest])
    if len(disc) == 0:
        return loosest
    bounds = np.linspace(loosest, disc[-1], 256)
    left_out = np.searchsorted(disc, bounds) / len(disc)
    selected = 1.0 - np.searchsorted(rest, bounds) / max(len(rest), 1)
    wrong = left_out + selected * len(rest) / max(pixels, 1)
    good = np.flatnonzero(wrong <= wrong.min() + _NEGLIGIBLE_FRACTION)
    return loosest if good[0] == 0 else float(0.5 * (bounds[good[0]] + bounds[good[-1]]))


# ---- picture ----


def draw_selection(image: NDArray[np.uint8], picked: PickedBounds) -> NDArray[np.uint8]:
    """Return a figure, (h, w + h // 2, 3) BGR, of the bounds that were picked from a picture (h, w, 3) BGR.

    The picture is grey, with the selected pixels in colour and the ball circled. Beside it is the enlarged ball.
    """
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    shown = np.asarray(0.45 * grey + 40.0, dtype=np.uint8)
    selected = colour_fields(image, picked.colours, tuple(picked.colours))
    for name, binary in zip(picked.colours, selected.binary, strict=True):
        shown[binary > 0] = _MARKS.get(name, (0, 255, 255))
    c = picked.circle
    half = round(1.3 * c.radius) + 2
    padded = (cv2.copyMakeBorder(p, half, half, half, half, cv2.BORDER_REPLICATE) for p in (image, shown))
    u, v = round(c.u), round(c.v)
    tall = image.shape[0] // 2
    side = [cv2.resize(p[v : v + 2 * half, u : u + 2 * half], (tall, tall), interpolation=cv2.INTER_NEAREST)
            for p in padded]  # fmt: skip
    cv2.circle(shown, (u, v), round(1.25 * c.radius) + 2, (0, 255, 0), 2, cv2.LINE_AA)
    beside = np.zeros((image.shape[0], tall, 3), dtype=np.uint8)
    beside[:tall], beside[tall : 2 * tall] = side[0], side[1]
    return np.hstack([shown, beside])
