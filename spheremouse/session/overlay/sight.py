"""Overlay while the camera's pose is unknown: targets and rejected candidates.

Targets of the rig are green, other targets yellow, and rejected candidates orange, with the bound that they exceed.
Round dark spots, which may be discs, are white on request. A strip with words is below.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.refused import Bound, Refused, refused_targets
from spheremouse.ball.detect.rings import RingSettings, TargetDetections, detect_targets
from spheremouse.geometry.rotation import Array
from spheremouse.session.messages import refusal
from spheremouse.session.overlay.pen import WHITE, Colour, Pen, canvas_of

_YELLOW: Colour = (30, 210, 255)
_ORANGE: Colour = (30, 130, 255)
_MARK_RADIUS_RADII = 1.6  # radii: as far from the rings as those of `Pen.target`


@dataclass(frozen=True, slots=True)
class Sight:
    """Targets and rejected candidates in a colour picture. A grey picture has none."""

    targets: TargetDetections
    refused: tuple[Refused, ...]
    codes: tuple[str, ...] | None  # that the rig has; None without a rig

    @property
    def strangers(self) -> tuple[str, ...]:
        """Codes seen that the rig does not have."""
        return tuple(sorted(set(self.targets.codes) - set(self.codes or self.targets.codes)))

    def kept(self, shape: tuple[int, int]) -> Image:
        """Return a mask, (h, w) uint8: 255 around objects with a target's three colours, 0 elsewhere."""
        keep = np.zeros(shape, np.uint8)
        places = list(zip(self.targets.centre, self.targets.radius, strict=True))
        for (u, v), radius in places + [(r.centre, r.radius) for r in self.refused if r.bound is not Bound.COLOURS]:
            cv2.circle(keep, (round(float(u)), round(float(v))), round(2.0 * float(radius)), 255, cv2.FILLED)
        return keep


_NONE = TargetDetections((), np.zeros((0, 2)), np.zeros(0), ())


def sight_of(image: Image, radii: Array, codes: tuple[str, ...] | None, settings: RingSettings) -> Sight:
    """Return targets and rejected candidates in an image, (h, w, 3) or (h, w); `radii`, (3,), of their circles."""
    if image.ndim != 3:
        return Sight(_NONE, (), codes)
    seen = detect_targets(image, radii, settings)
    return Sight(seen, refused_targets(image, radii, settings, seen), codes)


def draw_sight(
    image: Image,
    sight: Sight,
    words: tuple[tuple[str, float], ...],
    spots: tuple[Array, Array] = (np.zeros((0, 2)), np.zeros(0)),
) -> Image:
    """Return a copy of the image with the detections; a small image is enlarged by a whole factor to about 1280 px.

    `spots` are round dark spots: centres (n, 2) px of `image` and areas (n,) px². `words` are as in `Pen.caption`.
    """
    scale = max(1, round(1280 / image.shape[1]))
    canvas = canvas_of(image, scale)
    pen = Pen(canvas, scale)
    for centre, area in zip(*spots, strict=True):
        pen.ellipse(centre, (area / np.pi) * np.eye(2), WHITE)
    for refused in sight.refused:
        _ring(pen, refused.centre, refused.radius, refusal(refused), _ORANGE)
    for code, centre, radius in zip(sight.targets.codes, sight.targets.centre, sight.targets.radius, strict=True):
        if code in sight.strangers:
            _ring(pen, centre, radius, f"{code}: not in the rig", _YELLOW)
        else:
            pen.target(code, centre, radius**2 * np.eye(2))
    pen.caption(words)
    return canvas


def _ring(pen: Pen, centre: Array, radius: float, text: str, colour: Colour) -> None:
    pen.ellipse(centre, _MARK_RADIUS_RADII * radius**2 * np.eye(2), colour)
    pen.label(text, centre + radius * np.array([1.5, -1.1]), colour)
