"""Bounds of a ball's colours from one picture with the ball in it, and what they select, shown.

The ball is a circle that holds all its colours and a plain body; a person may say where it is. Within it each colour's
pixels are those near its hue, and the bounds are laid around them: saturation halfway between body and discs, which is
clear of either; light mixes before the camera's gamma does, so that rims lie some tenths of a pixel within the discs.
Where much beside the ball would be selected, the bound is narrowed as far as the discs bear it.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.errors import ConfigurationError
from spheremouse.geometry.rotation import Array
from spheremouse.wand.ball import WandBall
from spheremouse.wand.colour import DEFAULT_COLOURS, MEAN_BRIGHTNESS, fields, tone
from spheremouse.wand.rims import ColourSettings

HUES = {"red": 0.0, "orange": 30.0, "yellow": 55.0, "green": 125.0, "blue": 230.0, "purple": 285.0, "pink": 330.0}
_NEAR = 40.0  # deg of hue: as far as a print's red may be from red
_SATURATED = 60.0  # of 255: below, a pixel is called plain
_FEWEST = 12  # px of a colour from which bounds are picked
_SPREAD = 8.0  # deg of hue, around what was seen: light changes more than one picture shows
_INSIDE = 0.93  # of the radius: the ball's edge is mixed with what is behind it
_RADII = ((8, 20), (16, 40), (32, 80), (64, 160), (128, 320))  # px, searched one after the other
_TRIED = 12  # candidates, the best first, that are fitted to the edges
_GRADIENT = 120.0  # Sobel's, 8 per level and pixel: a rim of some 40 levels, blurred
_CLEAR = 18.0  # levels of Lab across an edge that count as one
_AROUND = np.stack([np.cos(np.arange(48) * np.pi / 24), np.sin(np.arange(48) * np.pi / 24)])
_SMALL = 1280  # px, the longer side of the picture in which the ball is looked for
_EDGES = 16_000  # px of edges along which circles are looked for, some seconds: the time goes with their square
_DIM = 40.0  # of 255, mean brightness: below, a picture is dark
_EVERYTHING = 0.5  # share of the picture: bounds that select so much tell nothing
_MUCH = 0.02  # share of what is not the ball, or of discs: less of it does not matter
_BESIDE = 1.15  # radii: further out are no rims of the ball
_MARKS = {"red": (60, 60, 255), "blue": (255, 90, 40), "dark": (255, 0, 255), "light": (255, 0, 255)}  # BGR


@dataclass(frozen=True, slots=True)
class Circle:
    """Where the ball is in a picture."""

    u: float  # px
    v: float  # px
    radius: float  # px


@dataclass(frozen=True, slots=True)
class Picked:
    """Bounds, and what they do to the picture they come from."""

    circle: Circle
    colours: dict[str, ColourSettings]
    inside: dict[str, float]  # share of the ball's pixels that each selects
    outside: dict[str, float]  # share of all other pixels

    def much(self) -> list[str]:
        """Colours of which much is selected beside the ball."""
        return [name for name, share in self.outside.items() if share > _MUCH]


def pick(image: NDArray[np.uint8], ball: WandBall, circle: Circle | None = None) -> Picked:
    """Bounds for the colours of a ball from a picture, (h, w, 3) BGR; ConfigurationError says what is in the way."""
    circle = find(image, ball) if circle is None else _checked(circle, image)
    hue, saturation, value = hsv(image)
    gain = MEAN_BRIGHTNESS / max(tone(image, DEFAULT_COLOURS, ("light",)).mean, 1.0)
    inner = disc_mask(image.shape[:2], circle, _INSIDE)
    beside = ~disc_mask(image.shape[:2], circle, _BESIDE)
    ours, rest = ((hue[where], saturation[where], gain * value[where]) for where in (inner, beside))
    colours = {}
    for name in ball.colours:
        if name in ("dark", "light"):
            colours[name] = _by_brightness(name, ours[2], rest[2])
        else:
            colours[name] = _by_hue(name, ours, rest)
    return judged(image, colours, circle, "take one with more light on the ball, or before another background")


def judged(
    image: NDArray[np.uint8],
    colours: dict[str, ColourSettings],
    circle: Circle,
    remedy: str = "narrow them, or have others picked without --check",
) -> Picked:
    """What bounds select inside a circle and elsewhere; ConfigurationError where that is nothing, or half of all.

    `remedy` is what to do about the latter.
    """
    selected = fields(image, colours, tuple(colours))
    ball = disc_mask(image.shape[:2], circle, 1.0)
    inside, outside = {}, {}
    for name, binary in zip(colours, selected.binary, strict=True):
        inside[name] = float(np.mean(binary[ball] > 0))
        outside[name] = float(np.mean(binary[~ball] > 0)) if not ball.all() else 0.0
        share = float(np.mean(binary > 0))
        if not np.any(binary[ball]):
            raise ConfigurationError(f"{name}: the bounds select nothing on the ball; pick them from this picture anew")
        if share > _EVERYTHING:
            raise ConfigurationError(f"{name}: the bounds select {100 * share:.0f} % of the picture; {remedy}")
    return Picked(circle, colours, inside, outside)


def hsv(image: NDArray[np.uint8]) -> tuple[Array, Array, Array]:
    """Hue in degrees, saturation and brightness 0 to 255, (h, w) each, of a picture (h, w, 3) BGR."""
    turned = cv2.cvtColor(image.astype(np.float32) / 255.0, cv2.COLOR_BGR2HSV)
    return turned[..., 0].astype(float), 255.0 * turned[..., 1].astype(float), 255.0 * turned[..., 2].astype(float)


def hue_distance(hue: Array, name: str) -> Array:
    """Degrees, 0 to 180, from a colour by its name."""
    return np.abs((hue - HUES[name] + 180.0) % 360.0 - 180.0)


def disc_mask(shape: tuple[int, ...], circle: Circle, share: float) -> NDArray[np.bool_]:
    """(h, w) within `share` of a circle's radius."""
    v, u = np.ogrid[: shape[0], : shape[1]]
    return np.asarray((u - circle.u) ** 2 + (v - circle.v) ** 2 < (share * circle.radius) ** 2)


# ---- where the ball is ----


def find(image: NDArray[np.uint8], ball: WandBall) -> Circle:
    """The circle that holds the colours of a ball and its body; ConfigurationError where none does."""
    scale = min(1.0, _SMALL / max(image.shape[:2]))
    small = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    grey = np.asarray(cv2.GaussianBlur(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), (0, 0), 1.0), dtype=np.uint8)
    masks, body = _kinds(small, ball)
    threshold = _edge_threshold(grey)
    candidates: list[tuple[float, Circle]] = []
    for least, most in _RADII:
        found = cv2.HoughCircles(
            grey, cv2.HOUGH_GRADIENT, 1, max(4, least // 2), param1=threshold, param2=9, minRadius=least, maxRadius=most
        )
        for u, v, radius in np.zeros((0, 3)) if found is None else found.reshape(-1, 3)[:200]:
            circle = Circle(float(u), float(v), float(radius))
            candidates.append((_score(circle, masks, body), circle))
    candidates.sort(key=lambda item: -item[0])
    lab = cv2.GaussianBlur(cv2.cvtColor(small, cv2.COLOR_BGR2LAB), (0, 0), 0.7).astype(np.float32)
    best, score = None, 0.0
    for promise, circle in candidates[:_TRIED]:
        if promise == 0.0:
            break
        fitted, edge = _fitted(circle, lab)
        mark = _score(fitted, masks, body) * edge
        if mark > score:
            best, score = fitted, mark
    if best is None or score < 0.15:
        raise ConfigurationError(
            f"no ball with {' and '.join(ball.colours)} discs on {ball.body} is in view; "
            f"{_hindrance(image, threshold)}turn two discs of each colour to the camera, "
            "or say where it is with --at U,V,RADIUS (px)"
        )
    return Circle((best.u + 0.5) / scale - 0.5, (best.v + 0.5) / scale - 0.5, best.radius / scale)


def _edge_threshold(grey: NDArray[np.uint8]) -> float:
    """Gradient from which on edges are followed: higher where there are so many that it would take long."""
    threshold = _GRADIENT
    while np.count_nonzero(cv2.Canny(grey, 0.5 * threshold, threshold)) > _EDGES:
        threshold *= 1.25
    return threshold


def _hindrance(image: NDArray[np.uint8], threshold: float) -> str:
    """What of the picture as a whole may hide a ball, and what to do about it: an advice begun, or nothing."""
    brightness = tone(image, DEFAULT_COLOURS, ("light",)).mean
    if brightness < _DIM:
        return f"the picture is dark (mean brightness {brightness:.0f} of 255): give more light or a longer exposure, "
    if threshold > _GRADIENT:
        return "the picture is full of fine detail: take one before a plainer background, "
    return ""


def _kinds(image: NDArray[np.uint8], ball: WandBall) -> tuple[list[NDArray[np.bool_]], NDArray[np.bool_]]:
    """Pixels that may be of each colour, and those that may be of the body."""
    hue, saturation, value = hsv(image)
    middle = float(np.median(value))
    masks = []
    for name in ball.colours:
        if name in ("dark", "light"):
            plain = saturation < 1.5 * _SATURATED
            bright = min(1.35 * middle, 0.5 * (middle + 255.0))  # before a white wall nothing is a third brighter
            masks.append(value < 0.55 * middle if name == "dark" else (value > bright) & plain)
        else:
            _known(name)
            masks.append((saturation > 1.5 * _SATURATED) & (hue_distance(hue, name) < 0.6 * _NEAR))
    if ball.body == "white":
        return masks, (saturation < _SATURATED) & (value > 0.8 * middle)
    return masks, value < 0.55 * middle


def _score(circle: Circle, masks: list[NDArray[np.bool_]], body: NDArray[np.bool_]) -> float:
    """0 to 1: all colours are there, the rest is body, and around it is less of both."""
    h, w = body.shape
    r = circle.radius
    x0, x1 = int(max(circle.u - 1.5 * r, 0)), int(min(circle.u + 1.5 * r + 2, w))
    y0, y1 = int(max(circle.v - 1.5 * r, 0)), int(min(circle.v + 1.5 * r + 2, h))
    if x1 - x0 < r or y1 - y0 < r:
        return 0.0
    v, u = np.ogrid[y0:y1, x0:x1]
    d2 = (u - circle.u) ** 2 + (v - circle.v) ** 2
    inside = d2 < (_INSIDE * r) ** 2
    n = max(int(np.count_nonzero(inside)), 1)
    shares = [np.count_nonzero(m[y0:y1, x0:x1] & inside) / n for m in masks]
    plain = np.count_nonzero(body[y0:y1, x0:x1] & inside) / n
    if min(shares) < 0.02 or not 0.35 < plain < 0.97:
        return 0.0
    outside = (d2 > (1.15 * r) ** 2) & (d2 < (1.5 * r) ** 2)
    beside = max(int(np.count_nonzero(outside)), 1)
    stray = sum(np.count_nonzero(m[y0:y1, x0:x1] & outside) for m in masks) / beside
    colourful = sum(min(s, 0.12) / 0.12 for s in shares) / len(shares)
    return float(np.clip(sum(shares) + plain, 0.0, 1.0) ** 2 * colourful * max(0.0, 1.0 - 2.0 * stray))


def _fitted(circle: Circle, lab: NDArray[np.float32]) -> tuple[Circle, float]:
    """The circle nearby along which the colour changes most, and by how much: 0 to 1, which is all the way round."""
    strength = _edge(circle.u, circle.v, circle.radius, lab)
    for step in (0.30, 0.15, 0.07, 0.035):
        for _ in range(3):
            by = step * circle.radius
            a, b, c = (x.ravel() for x in np.meshgrid(*(np.array([-1.0, 0.0, 1.0]),) * 3))
            u, v, radius = circle.u + by * a, circle.v + by * b, np.maximum(circle.radius + by * c, 3.0)
            found = np.array([_edge(*each, lab) for each in zip(u, v, radius, strict=True)])
            k = int(np.argmax(found))
            if found[k] <= strength:
                break
            circle, strength = Circle(float(u[k]), float(v[k]), float(radius[k])), float(found[k])
    return circle, strength


def _edge(u: float, v: float, radius: float, lab: NDArray[np.float32]) -> float:
    """Mean over the circle of the change of colour across it, each place counting no more than a clear edge."""
    inside, outside = (
        cv2.remap(
            lab,
            (u + r * _AROUND[0]).astype(np.float32)[None],
            (v + r * _AROUND[1]).astype(np.float32)[None],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )[0]
        for r in (radius - 1.2, radius + 1.2)
    )
    return float(np.mean(np.minimum(np.linalg.norm(inside - outside, axis=1), _CLEAR) / _CLEAR))


def _checked(circle: Circle, image: NDArray[np.uint8]) -> Circle:
    h, w = image.shape[:2]
    if not (0 <= circle.u < w and 0 <= circle.v < h and 4.0 <= circle.radius <= max(h, w)):
        raise ConfigurationError(
            f"--at {circle.u:g},{circle.v:g},{circle.radius:g}: not in a picture of {w}x{h} px; "
            "give the ball's centre and radius in px, from 4 px"
        )
    return circle


# ---- bounds ----


def _known(name: str) -> None:
    if name not in HUES:
        raise ConfigurationError(
            f"colour {name!r}: bounds are picked for dark, light, {', '.join(HUES)}; write those of others by hand"
        )


def _by_hue(name: str, ball: tuple[Array, Array, Array], rest: tuple[Array, Array, Array]) -> ColourSettings:
    """Around the pixels near a hue on the ball; each hue and saturation as `hsv`, and brightness normalised, (n,)."""
    _known(name)
    hue, saturation, value = ball
    like = (hue_distance(hue, name) < _NEAR) & (saturation > _SATURATED)
    body = float(np.median(saturation))  # most of a ball is not disc; white is not white in every light
    if np.any(like):
        like &= saturation > body + 0.4 * (float(np.quantile(saturation[like], 0.98)) - body)
    if np.count_nonzero(like) < _FEWEST:
        raise ConfigurationError(
            f"{name}: no such disc on the ball ({np.count_nonzero(like)} px); turn one to the camera, or is the light "
            "so weak or coloured that it does not look like one?"
        )
    full = float(np.quantile(saturation[like], 0.75))  # of a disc's middle: rims are mixed with white
    deep = like & (saturation > 0.7 * full)
    off = (hue[deep] - HUES[name] + 180.0) % 360.0 - 180.0
    low, high = np.quantile(off, [0.02, 0.98]) + HUES[name]
    low, high = low - _SPREAD, high + _SPREAD
    darkest = 0.5 * float(np.quantile(value[deep], 0.02))
    alike = ((rest[0] - low) % 360.0 <= high - low) & (rest[2] >= darkest)
    return ColourSettings(
        hue_min=round(float(low) % 360.0),
        hue_max=round(float(high) % 360.0),
        saturation_min=round(_narrowed(0.5 * (full + body), saturation[like], rest[1][alike], len(rest[1]))),
        value_min=round(darkest),
    )


def _by_brightness(name: str, value: Array, rest: Array) -> ColourSettings:
    """Halfway between discs and body; brightness normalised, (n,), on the ball and beside it."""
    top = float(value.max())
    levels = np.clip(255.0 * value / max(top, 1.0), 0.0, 255.0).astype(np.uint8)
    cut, _ = cv2.threshold(levels.reshape(-1, 1), 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    cut = cut * top / 255.0
    below, above = value[value <= cut], value[value > cut]
    if len(below) < _FEWEST or len(above) < _FEWEST or np.median(above) < 1.6 * np.median(below):
        raise ConfigurationError(
            f"{name}: discs and ball are equally bright in this picture; more light, or other discs"
        )
    if name == "dark":
        halfway = 0.5 * float(np.median(below) + np.median(above))
        return ColourSettings(value_max=round(-_narrowed(-halfway, -below, -rest, len(rest))))
    # lit discs are the brightest there is: the bound keeps as near to them as their own spread lets it
    near = 0.85 * float(np.quantile(above, 0.2))
    return ColourSettings(value_min=round(_narrowed(near, above, rest, len(rest))))


def _narrowed(loosest: float, disc: Array, rest: Array, pixels: int) -> float:
    """A lower bound between values (n,) of discs and (m,) of what is not the ball, which has so many `pixels` in all.

    Least is the sum of two shares: of the discs left out, and of the rest selected (Youden 1950). Pixels counted one by
    one would have any background, which outnumbers the discs a hundredfold, give the discs up. It stays at the loosest
    where that is as good as the best, and else lies amid what is.
    """
    disc, rest = np.sort(disc[disc >= loosest]), np.sort(rest[rest >= loosest])
    if len(disc) == 0:
        return loosest
    bounds = np.linspace(loosest, disc[-1], 256)
    left_out = np.searchsorted(disc, bounds) / len(disc)
    selected = 1.0 - np.searchsorted(rest, bounds) / max(len(rest), 1)
    wrong = left_out + selected * len(rest) / max(pixels, 1)
    good = np.flatnonzero(wrong <= wrong.min() + _MUCH)
    return loosest if good[0] == 0 else float(0.5 * (bounds[good[0]] + bounds[good[-1]]))


# ---- shown ----


def overlay(image: NDArray[np.uint8], picked: Picked) -> NDArray[np.uint8]:
    """The picture in grey with what the bounds select in colour, the ball circled; beside it the ball enlarged."""
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    shown = np.asarray(0.45 * grey + 40.0, dtype=np.uint8)
    selected = fields(image, picked.colours, tuple(picked.colours))
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
