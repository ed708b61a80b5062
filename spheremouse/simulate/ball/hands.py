"""Hands that come between camera and ball: drawn once, then placed where they are at a time."""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import project
from spheremouse.simulate.ball.scene import Scene

PER_METRE = 500  # pixels of the drawing
_SCALE = 1.3  # a big hand: two of them hide about a third of the ball
HALF_WIDTH, ABOVE, _BELOW = 0.12, 0.18, 0.75  # m, what the drawing shows around the palm
_SKIN = np.array([112.0, 148.0, 205.0])  # grey values blue, green, red
_SLEEVE = np.array([112.0, 70.0, 48.0])
_PLANE_Z = 0.66  # m, obj: just in front of the ball


@dataclass(frozen=True, slots=True)
class HandVisit:
    """A hand comes from below, plays on the ball and goes."""

    start: float  # s
    end: float  # s
    right: bool  # the right hand, on the right of the ball
    size: float = 1.0  # of the hand


def draw_hand() -> NDArray[np.float32]:
    """A right hand with its forearm, seen from behind it, fingers up: (h, w, 4) blue, green, red, cover 0..1.

    Colours are multiplied by the cover already.
    """
    y, x = np.mgrid[ABOVE : -_BELOW : -1.0 / PER_METRE, -HALF_WIDTH : HALF_WIDTH : 1.0 / PER_METRE]
    parts = [  # from, to, radius at both, m; the origin is the middle of the palm
        (-0.016, -0.030, -0.016, 0.035, 0.031, 0.030), (0.016, -0.030, 0.016, 0.035, 0.031, 0.030),
        (-0.036, 0.055, -0.046, 0.118, 0.0105, 0.009), (-0.012, 0.060, -0.015, 0.140, 0.011, 0.0095),
        (0.012, 0.060, 0.015, 0.134, 0.011, 0.0095), (0.034, 0.050, 0.044, 0.105, 0.010, 0.008),
        (-0.036, -0.025, -0.082, 0.030, 0.016, 0.011), (0.0, -0.05, 0.0, -0.30, 0.030, 0.040),
        (0.0, -0.24, 0.0, -0.80, 0.050, 0.062),
    ]  # fmt: skip
    depth = np.full(x.shape, -np.inf)
    for x0, y0, x1, y1, r0, r1 in parts:
        dx, dy = x1 - x0, y1 - y0
        s = np.clip(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
        radius = r0 + s * (r1 - r0)
        depth = np.maximum(depth, radius - np.hypot(x - x0 - s * dx, y - y0 - s * dy))
    cover = np.clip(0.5 + depth * PER_METRE, 0.0, 1.0)
    round_edge = 0.62 + 0.38 * np.sqrt(np.clip(depth / 0.02, 0.0, 1.0))
    sleeve = np.clip(0.5 + (-0.24 - y) * PER_METRE, 0.0, 1.0)[..., None]
    colour = (_SKIN * (1.0 - sleeve) + _SLEEVE * sleeve) * round_edge[..., None]
    return np.concatenate([colour * cover[..., None], cover[..., None]], axis=2).astype(np.float32)


class PlacedHand(NamedTuple):
    """A hand in an image: the part of it that it may touch, and its paint there."""

    place: tuple[slice, slice]  # rows, columns
    paint: NDArray[np.float32]  # (rows, columns, 4) as draw_hand


def place_hand(hand: NDArray[np.float32], visit: HandVisit, scene: Scene, t: float) -> PlacedHand | None:
    """The hand in the image at time `t`; None while it is away or out of sight."""
    if not visit.start < t < visit.end:
        return None
    side = 1.0 if visit.right else -1.0
    since, left = t - visit.start, visit.end - t
    away = 1.0 - _smooth(since / 0.5) * _smooth(left / 0.5)
    x = side * (0.13 + 0.03 * np.sin(2.1 * since))
    y = 0.02 + 0.11 * np.sin(1.7 * since + side) - 1.2 * away
    tilt = side * (0.10 + 0.12 * np.sin(1.3 * since))
    scale = _SCALE * visit.size
    right = np.array([np.cos(tilt), np.sin(tilt), 0.0]) * scale * side
    up = np.array([-np.sin(tilt), np.cos(tilt), 0.0]) * scale
    h, w = hand.shape[:2]
    drawn = np.array([[0, 0], [w, 0], [0, h], [w, h]], dtype=np.float32)
    metres = drawn / PER_METRE * (1.0, -1.0) + (-HALF_WIDTH, ABOVE)
    palm = np.array([x, y, _PLANE_Z])
    uv = project(scene.pose.to_cam(palm + metres[:, :1] * right + metres[:, 1:] * up), scene.camera)[0]
    if not np.all(np.isfinite(uv)):
        return None
    limit = (scene.camera.width, scene.camera.height)
    low = np.clip(np.floor(uv.min(axis=0)).astype(int) - 1, 0, limit)
    high = np.clip(np.ceil(uv.max(axis=0)).astype(int) + 2, 0, limit)
    if np.any(high <= low):
        return None
    M = cv2.getAffineTransform(drawn[:3], (uv[:3] - low).astype(np.float32))
    paint = cv2.warpAffine(hand, M, (int(high[0] - low[0]), int(high[1] - low[1])))
    place = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
    return PlacedHand(place, np.asarray(paint, dtype=np.float32))


def _smooth(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)
