"""The choice of a camera's frames that become photos.

A frame becomes a photo if it is sharp, its subject does not move, and it adds a view that no other photo has.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.diagnosis import blur_of
from spheremouse.geometry.rotation import Array

MAX_MOTION = 1.0  # px between two frames; in the exposure it is a part of that
SHARP = 1.0  # px: a lens in focus, its pixels, and demosaicing
BLURRED = 3.0  # px: worse than any lens in focus, even if the camera's software enlarges its pictures

_MAX_TIMES_SHARPEST = 1.5  # then motion blurs as much as the lens does
_DARK = 40  # grey values; if hardly a pixel is brighter, neither paper nor ball can be seen


@dataclass(frozen=True, slots=True)
class FrameCheck:
    """The check of one frame."""

    seen: object  # detections, for the selector that made the check
    words: str  # for the person before the camera: contents, and the hindrance
    gain: str = ""  # new contents; empty if the frame becomes no photo


class Selector(Protocol):
    """The photos of a session, and the check of further frames."""

    @property
    def count(self) -> int:
        """Number of photos that count."""
        ...

    @property
    def enough(self) -> bool:
        """True when no more photos are wanted."""
        ...

    def check(self, picture: Image) -> FrameCheck:
        """Check the next frame of a camera."""
        ...

    def resume(self, read: Callable[[], Image]) -> bool:
        """Count an existing photo; return False if it shows nothing of use."""
        ...

    def add(self, check: FrameCheck) -> None:
        """Count a checked frame, which is a photo now."""
        ...

    def wanted(self) -> list[str]:
        """List instructions for the person, the most important first."""
        ...

    def status(self) -> list[str]:
        """Describe the progress in lines."""
        ...


class FrameMotion:
    """Motion of named points from frame to frame."""

    def __init__(self, min_points: int) -> None:
        self._min_points, self._before = min_points, {}

    def update(self, keys: Sequence[int | str], uv: Array) -> float:
        """Return the median motion since the last frame, px; inf if too few points are in both.

        The points have `keys`, and places `uv` (n, 2) px.
        """
        before, self._before = self._before, dict(zip(keys, uv, strict=True))
        moved = [float(np.linalg.norm(at - before[key])) for key, at in self._before.items() if key in before]
        return float(np.median(moved)) if len(moved) >= self._min_points else float("inf")


class Sharpness:
    """Blur of a part of each frame, compared with the sharpest frame of the camera."""

    def __init__(self) -> None:
        self.sharpest = float("inf")  # px

    def fault(self, picture: Image, points: Array) -> str:
        """Describe the blur around points (n, 2) px of a frame; empty if it is sharp."""
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.5 * (high - low)  # `blur_of` takes the median slope for that of noise
        u0, v0 = np.maximum(low - margin, 0).astype(int)
        u1, v1 = (high + margin).astype(int) + 1
        blur = blur_of(picture[v0:v1, u0:u1])
        self.sharpest = min(self.sharpest, blur)  # nan is not less
        return blur_fault(blur, self.sharpest)


def blur_fault(blur: float, sharpest: float) -> str:
    """Describe a blur that is too large beside that of the sharpest frame, px; empty if it is not."""
    if np.isnan(blur):
        return "its edges cannot be made out: more light, or come closer"
    if blur <= min(max(SHARP, _MAX_TIMES_SHARPEST * sharpest), BLURRED):
        return ""
    best = f", {sharpest:.1f} px at best" if sharpest < blur else ""
    return f"blurred (edges of {blur:.1f} px{best}): more light, or go where the lens is focused"


def motion_fault(moved: float) -> str:
    """Describe a motion, px."""
    return f"moves by {moved:.0f} px from frame to frame: hold still" if np.isfinite(moved) else "hold still"


def is_dark(picture: Image) -> bool:
    """Return True for a picture that shows nothing: a lens cap, a room without light."""
    return float(np.percentile(picture[::8, ::8], 99.0)) < _DARK
