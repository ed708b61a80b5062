"""The choice of frames of a board: those with a region or a tilt that no photo shows.

It uses the coverage that `calibrate camera` reports, so both want the same photos.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.calibrate.board import Pattern
from spheremouse.calibrate.camera.adjust import calibrate_board
from spheremouse.calibrate.camera.bundle import View, resect_views
from spheremouse.calibrate.camera.calibrate import rejection_reason, view_of
from spheremouse.calibrate.camera.corners import MAX_SEARCHED_PX, Sighting, find_board
from spheremouse.calibrate.camera.coverage import LEANS, VIEWS, Coverage, coverage, enough, gain, missing
from spheremouse.calibrate.photographing.selector import Selector
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array

_QUICK_SEARCH = 0.25 * MAX_SEARCHED_PX  # px; finds a board that is large enough four times as fast
_FOCAL_OVER_WIDTH = 0.9  # of the longer side, to begin with: between a wide and an ordinary webcam
_MIN_VIEWS = 4  # for a calibration whose focal length is better than that
_MIN_SHARE = 1.0 / 6.0  # of the picture: half of the instructions' minimum
_MIN_CORNERS = 4  # for a motion
_ARROWS = dict(zip(LEANS, "←→↑↓", strict=True))


class BoardSelector(Selector[Sighting]):
    """The views of a board so far, and the check of further frames."""

    def __init__(self, pattern: Pattern, size: tuple[int, int]) -> None:
        """`size` (width, height) px of all pictures."""
        super().__init__("it", _MIN_CORNERS)
        self.pattern, self.size = pattern, size
        self._corners: list[Array] = []
        self._views: list[View] = []
        self._rotations = np.empty((0, 3, 3))
        focal = _FOCAL_OVER_WIDTH * max(size)
        self._camera = InteriorOrientation(*size, focal, focal, 0.5 * (size[0] - 1), 0.5 * (size[1] - 1))

    @property
    def coverage(self) -> Coverage:
        return coverage(self.size, self._corners, self._rotations)

    @property
    def count(self) -> int:
        return len(self._views)

    @property
    def enough(self) -> bool:
        return enough(self.coverage)

    def detect(self, picture: Image, *, quick: bool) -> Sighting:
        return find_board(picture, self.pattern, _QUICK_SEARCH if quick else MAX_SEARCHED_PX)

    def fault(self, seen: Sighting) -> str:
        return "" if len(seen.ids) else f"it {rejection_reason(seen, self.pattern)}"

    def points(self, seen: Sighting) -> tuple[Sequence[int], Array]:
        return seen.ids.tolist(), seen.uv

    def describe(self, seen: Sighting) -> str:
        share = self._filled(seen)
        words = f"the board fills {100.0 * share:.0f} % of the picture"
        return f"come closer: {words}" if share < _MIN_SHARE else words

    def gain(self, seen: Sighting) -> tuple[str, str]:
        R, _, _ = resect_views([view_of(seen, self.pattern)], self._camera)
        new = gain(self.coverage, self.size, seen.uv, R[0], self._corners)
        return new or "", "such a view is there already"

    def add(self, seen: Sighting) -> None:
        """Count a view, and calibrate the camera for the next ones."""
        self._views.append(view_of(seen, self.pattern))
        self._corners.append(seen.uv)
        if len(self._views) >= _MIN_VIEWS:
            try:
                found = calibrate_board(self._views, self.size, 2)
                if 0.3 < found.camera.fx / max(self.size) < 10.0:
                    self._camera = found.camera
            except CalibrationError:
                pass  # not yet
        self._rotations, _, _ = resect_views(self._views, self._camera)

    def wanted(self) -> list[str]:
        return missing(self.coverage)

    def status(self) -> list[str]:
        covered = self.coverage
        lines = ["".join(f"{count or '·':>3}" for count in row) for row in covered.regions]
        lines[0] += f"   {covered.views} photos, {VIEWS} or more wanted"
        lines[1] += "   facing " + "  ".join(f"{_ARROWS[way]} {n}" for way, n in zip(LEANS, covered.leans, strict=True))
        return lines

    def _filled(self, seen: Sighting) -> float:
        """Share of the picture that the board fills, with the squares around its corners."""
        n, m = self.pattern.columns, self.pattern.rows
        whole = (n + 1) * (m + 1) / ((n - 1) * (m - 1))
        inside = float(cv2.contourArea(cv2.convexHull(seen.uv.astype(np.float32))))
        return min(whole * inside / (self.size[0] * self.size[1]), 1.0)
