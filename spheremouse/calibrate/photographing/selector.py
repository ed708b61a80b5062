"""The choice of a camera's frames that become photos.

A frame becomes a photo if it is sharp, its subject does not move, and it adds a view that no other photo has.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from spheremouse.ball.detect.blur import blur_of
from spheremouse.ball.detect.detections import Image
from spheremouse.geometry.rotation import Array

_MAX_MOTION = 1.0  # px between two frames; in the exposure it is a part of that
_MAX_BLUR_IN_FOCUS_PX = 1.0  # px: a lens in focus, its pixels, and demosaicing
_MAX_BLUR_PX = 3.0  # px: worse than any lens in focus, even if the camera's software enlarges its pictures
_MAX_TIMES_SHARPEST = 1.5  # then motion blurs as much as the lens does
_MIN_BRIGHTNESS_GREY = 40  # grey values; if hardly a pixel is brighter, neither paper nor ball can be seen

S = TypeVar("S")  # detections in a frame


@dataclass(frozen=True, slots=True)
class FrameCheck(Generic[S]):
    seen: S
    words: str  # for the person before the camera: contents, and the hindrance
    gain: str = ""  # what the photo adds, in words; empty if the frame becomes no photo


class Selector(ABC, Generic[S]):
    """The photos of a session, and the check of further frames."""

    def __init__(self, subject: str, min_points: int) -> None:
        """`subject` moves, in words; a motion needs `min_points` that are in two frames."""
        self._subject, self._min_points = subject, min_points
        self._before: dict[int | str, Array] = {}
        self._sharpest = float("inf")  # px, of all frames so far

    @property
    @abstractmethod
    def count(self) -> int:
        """Number of photos that count."""

    @property
    @abstractmethod
    def enough(self) -> bool:
        """True when no more photos are wanted."""

    @abstractmethod
    def wanted(self) -> list[str]:
        """List instructions for the person, the most important first."""

    @abstractmethod
    def status(self) -> list[str]:
        """Describe the progress in lines."""

    @abstractmethod
    def detect(self, picture: Image, *, quick: bool) -> S:
        """Detect the subject, on request quickly; (h, w, 3) BGR."""

    @abstractmethod
    def fault(self, seen: S) -> str:
        """Describe why a picture is of no use by itself; empty if it is."""

    @abstractmethod
    def points(self, seen: S) -> tuple[Sequence[int | str], Array]:
        """Return the keys of points in a picture, and their places, (n, 2) px."""

    @abstractmethod
    def describe(self, seen: S) -> str:
        """Describe the contents of a picture that is of use."""

    @abstractmethod
    def gain(self, seen: S) -> tuple[str, str]:
        """Return the addition of a picture to the photos in words, or an empty text and the reason."""

    @abstractmethod
    def add(self, seen: S) -> None:
        """Count a picture, which is a photo now."""

    def check(self, picture: Image) -> FrameCheck[S]:
        """Check the next frame of a camera."""
        seen = self.detect(picture, quick=True)
        motion = self._motion(*self.points(seen))
        if fault := self.fault(seen):
            dark = float(np.percentile(picture[::8, ::8], 99.0)) < _MIN_BRIGHTNESS_GREY
            return FrameCheck(seen, "the picture is dark" if dark else fault)
        words = self.describe(seen)
        if motion >= _MAX_MOTION:
            far = f"moves by {motion:.0f} px from frame to frame: hold still" if np.isfinite(motion) else "hold still"
            return FrameCheck(seen, f"{words}; {self._subject} {far}")
        new, known = self.gain(seen)
        if not new:
            return FrameCheck(seen, f"{words}; {known}")
        seen = self.detect(picture, quick=False)  # as the calibration does
        hindrance = self.fault(seen) or self._blur(picture, self.points(seen)[1])
        return FrameCheck(seen, f"{words}; {hindrance}") if hindrance else FrameCheck(seen, words, new)

    def resume(self, picture: Image) -> bool:
        """Count an existing photo; return False if it shows nothing of use."""
        seen = self.detect(picture, quick=False)
        if self.fault(seen):
            return False
        self.add(seen)
        return True

    def _motion(self, keys: Sequence[int | str], uv: Array) -> float:
        """Median motion of named points since the last frame, px; inf if too few points are in both."""
        before, self._before = self._before, dict(zip(keys, uv, strict=True))
        distances = [float(np.linalg.norm(at - before[key])) for key, at in self._before.items() if key in before]
        return float(np.median(distances)) if len(distances) >= self._min_points else float("inf")

    def _blur(self, picture: Image, points: Array) -> str:
        """Describe a blur around points (n, 2) px that is too large beside that of the sharpest frame."""
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.5 * (high - low)  # `blur_of` takes the median slope for that of noise
        u0, v0 = np.maximum(low - margin, 0).astype(int)
        u1, v1 = (high + margin).astype(int) + 1
        blur = blur_of(picture[v0:v1, u0:u1])
        self._sharpest = min(self._sharpest, blur)  # nan is not less
        if np.isnan(blur):
            return "its edges cannot be made out: more light, or come closer"
        if blur <= min(max(_MAX_BLUR_IN_FOCUS_PX, _MAX_TIMES_SHARPEST * self._sharpest), _MAX_BLUR_PX):
            return ""
        best = f", {self._sharpest:.1f} px at best" if self._sharpest < blur else ""
        return f"blurred (edges of {blur:.1f} px{best}): more light, or go where the lens is focused"
