"""Which pictures of a board become photos: those that show a region or a tilt that no photo shows.

What is wanted is what `calibrate camera` asks for afterwards (coverage): the two cannot disagree.
"""

from collections.abc import Callable

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.calibrate.camera.adjust import calibrate_board
from spheremouse.calibrate.camera.bundle import View, resected
from spheremouse.calibrate.camera.calibrate import why_not
from spheremouse.calibrate.camera.corners import SEARCHED, Pattern, Sighting, find_board
from spheremouse.calibrate.camera.coverage import LEANS, VIEWS, Coverage, coverage, enough, gain, missing
from spheremouse.calibrate.photographing.edges import blur_of_board, not_sharp
from spheremouse.calibrate.photographing.look import STILL, Look, Motion, is_dark, moving
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array

_QUICK = 0.25 * SEARCHED  # px: a board that is large enough is found there, too, four times as fast
_FOCAL = 0.9  # of the longer side: between a wide and an ordinary webcam, to begin with
_ENOUGH_TO_CALIBRATE = 4  # views, from which on their own focal length is better than that
_SMALL = 1.0 / 6.0  # of the picture: half of the least that the recipe asks for
_FEWEST = 4  # corners that tell a motion
_ARROWS = dict(zip(LEANS, "←→↑↓", strict=True))


class BoardJudge:
    """The views of a board so far, and whether a picture adds to them; see look.Judge."""

    def __init__(self, pattern: Pattern, size: tuple[int, int]) -> None:
        """`size` (width, height) px of all pictures."""
        self.pattern, self.size = pattern, size
        self._corners: list[Array] = []
        self._views: list[View] = []
        self._rotations = np.empty((0, 3, 3))
        focal = _FOCAL * max(size)
        self._camera = InteriorOrientation(*size, focal, focal, 0.5 * (size[0] - 1), 0.5 * (size[1] - 1))
        self._motion, self._sharpest = Motion(_FEWEST), np.inf

    @property
    def coverage(self) -> Coverage:
        """Coverage of the views so far."""
        return coverage(self.size, self._corners, self._rotations)

    @property
    def count(self) -> int:
        """Views."""
        return len(self._views)

    @property
    def enough(self) -> bool:
        """All regions, all tilts, and as many views as make it a mean."""
        return enough(self.coverage)

    def look(self, picture: Image) -> Look:
        """Judge the next frame."""
        seen = find_board(picture, self.pattern, _QUICK)
        moved = self._motion.since_last(seen.ids.tolist(), seen.uv)
        if not len(seen.ids):
            return Look(seen, "the picture is dark" if is_dark(picture) else f"it {why_not(seen, self.pattern)}")
        share = self._filled(seen)
        fills = f"the board fills {100.0 * share:.0f} % of the picture"
        where = f"come closer: {fills}" if share < _SMALL else fills
        if moved >= STILL:
            return Look(seen, f"{where}; it {moving(moved)}")
        new = self._gain(seen)
        if new is None:
            return Look(seen, f"{where}; such a view is there already")
        if picture.size > _QUICK:
            seen = find_board(picture, self.pattern)  # as `calibrate camera` will look for it
        blur = self._blur(picture, seen)
        self._sharpest = min(self._sharpest, blur)  # nan is not less
        hindered = not_sharp(blur, self._sharpest)
        return Look(seen, f"{where}; {hindered}" if hindered else where, "" if hindered else new)

    def resume(self, read: Callable[[], Image]) -> bool:
        """Count a photo in which the board is found."""
        seen = find_board(read(), self.pattern)
        if len(seen.ids):
            self.add(Look(seen, ""), read)
        return len(seen.ids) > 0

    def add(self, look: Look, read: Callable[[], Image]) -> None:
        """Count a sighting as a view."""
        seen = look.seen
        assert isinstance(seen, Sighting)
        self._views.append(self._view(seen))
        self._corners.append(seen.uv)
        if len(self._views) >= _ENOUGH_TO_CALIBRATE:
            try:
                found = calibrate_board(self._views, self.size, 2)
                if 0.3 < found.camera.fx / max(self.size) < 10.0:
                    self._camera = found.camera
            except CalibrationError:
                pass  # not yet
        self._rotations, _, _ = resected(self._views, self._camera)

    def pending_work(self) -> None:
        """Nothing that takes long."""

    def wanted(self) -> list[str]:
        """What to do with the board, left and right as the camera sees them."""
        return missing(self.coverage)

    def status(self) -> list[str]:
        """Views by region and tilt."""
        covered = self.coverage
        lines = ["".join(f"{count or '·':>3}" for count in row) for row in covered.regions]
        lines[0] += f"   {covered.views} photos, {VIEWS} or more wanted"
        lines[1] += "   facing " + "  ".join(f"{_ARROWS[way]} {n}" for way, n in zip(LEANS, covered.leans, strict=True))
        return lines

    def _filled(self, seen: Sighting) -> float:
        """Part of the picture that the board fills, with the squares around its corners."""
        n, m = self.pattern.columns, self.pattern.rows
        whole = (n + 1) * (m + 1) / ((n - 1) * (m - 1))
        inside = float(cv2.contourArea(cv2.convexHull(seen.uv.astype(np.float32))))
        return min(whole * inside / (self.size[0] * self.size[1]), 1.0)

    def _gain(self, seen: Sighting) -> str | None:
        R, _, _ = resected([self._view(seen)], self._camera)
        return gain(self.coverage, self.size, seen.uv, R[0], self._corners)

    def _view(self, seen: Sighting) -> View:
        return View(self.pattern.corners()[seen.ids], seen.uv)

    def _blur(self, picture: Image, seen: Sighting) -> float:
        pattern = self.pattern
        grid = np.full((pattern.columns * pattern.rows, 2), np.nan)
        grid[seen.ids] = seen.uv
        free = 0.3 if pattern.marker is None else 0.4 * (1.0 - pattern.marker / pattern.square)
        grey = picture if picture.ndim == 2 else np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)
        return blur_of_board(grey, grid.reshape(pattern.rows, pattern.columns, 2), free)
