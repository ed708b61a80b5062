"""A live session before a camera: frames in, a folder of board views out, each of which added something.

A view is taken when the board stands still and shows what no view has shown: a region of the picture, or a tilt. The
folder is the session: what is in it counts, so a session can be left and continued.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.live import Live
from rich.text import Text

from spheremouse.calibrate.camera.adjust import MIN_VIEWS, calibrate_board
from spheremouse.calibrate.camera.bundle import View, resected
from spheremouse.calibrate.camera.corners import Pattern, Sighting, find_board
from spheremouse.calibrate.camera.coverage import (
    LEANS,
    VIEWS,
    Coverage,
    coverage,
    enough,
    gain,
    missing,
    region_grid,
    regions_of,
)
from spheremouse.calibrate.photos import ENDINGS, image, read_photos
from spheremouse.capture import open_source
from spheremouse.capture.stopping import Stopping
from spheremouse.errors import CalibrationError
from spheremouse.files.atomic import replace
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from spheremouse.tracker import Frame

STILL = 1.0  # px between two frames: motion in the exposure is then a part of that

_FOCAL = 0.9  # of the longer side: between a wide and an ordinary webcam, to begin with
_ENOUGH_TO_CALIBRATE = 4  # views, from which on their own focal length is better than that
_ARROWS = dict(zip(LEANS, "←→↑↓", strict=True))


class Session:
    """The views taken so far, and whether another one adds to them."""

    def __init__(self, pattern: Pattern, size: tuple[int, int]) -> None:
        self.pattern, self.size = pattern, size
        self.corners: list[Array] = []
        self._views: list[View] = []
        self._rotations = np.empty((0, 3, 3))
        focal = _FOCAL * max(size)
        self._camera = InteriorOrientation(*size, focal, focal, 0.5 * (size[0] - 1), 0.5 * (size[1] - 1))
        self._before: Sighting | None = None

    @property
    def coverage(self) -> Coverage:
        """Coverage of the views so far."""
        return coverage(self.size, self.corners, self._rotations)

    def still(self, seen: Sighting) -> bool:
        """Whether the board is where it was in the frame before, to a pixel."""
        before, self._before = self._before, seen
        if before is None or not len(seen.ids):
            return False
        _, a, b = np.intersect1d(before.ids, seen.ids, return_indices=True)
        return len(a) >= 4 and float(np.median(np.linalg.norm(before.uv[a] - seen.uv[b], axis=1))) < STILL

    def gain(self, seen: Sighting) -> str | None:
        """The gain of a sighting, in words, or None."""
        R, _, _ = resected([self._view(seen)], self._camera)
        return gain(self.coverage, self.size, seen.uv, R[0], self.corners)

    def add(self, seen: Sighting) -> None:
        """Count a sighting as a view."""
        self._views.append(self._view(seen))
        self.corners.append(seen.uv)
        if len(self._views) >= _ENOUGH_TO_CALIBRATE:
            try:
                found = calibrate_board(self._views, self.size, 2)
                if 0.3 < found.camera.fx / max(self.size) < 10.0:
                    self._camera = found.camera
            except CalibrationError:
                pass  # not yet
        self._rotations, _, _ = resected(self._views, self._camera)

    def _view(self, seen: Sighting) -> View:
        return View(self.pattern.corners()[seen.ids], seen.uv)


def take_views(source: str, pattern: Pattern, folder: Path) -> None:
    """Watch a source until the views in `folder` are enough, the source ends, or somebody stops it with Ctrl-C.

    CalibrationError where there are too few to calibrate then, or where the folder holds photos of another size.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise CalibrationError(f"{folder}: cannot be made: {e.strerror or e}") from None
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    if not console.is_terminal:
        console.width = 1000
    session: Session | None = None
    with open_source(source) as stream, Stopping() as stopping, Live(console=console, transient=True) as shown:
        for frame in stopping.frames(iter(stream)):
            height, width = frame.image.shape[:2]
            if session is None:
                session = _continued(pattern, (width, height), folder, console)
            if enough(session.coverage):
                break
            said, seen = _look(session, frame, folder)
            if said and not console.is_terminal:
                console.print(said)
            if console.is_terminal:
                shown.update(_screen(session, seen, said))
    done = session.coverage if session is not None else None
    if done is None or done.views < MIN_VIEWS:
        raise CalibrationError(
            f"{done.views if done else 0} views in {folder}, and {MIN_VIEWS} are the least; run it again to go on: "
            "hold the board still, tilted, in all parts of the picture"
        )
    if not enough(done):
        left = missing(done)
        few = f"{done.views} of {VIEWS} views" if done.views < VIEWS else f"{done.views} views"
        what = f"; no view {'; no view '.join(left[:3])}" if left else ""
        console.print(f"note: stopped with {few}{what}; run it again to go on")


def _continued(pattern: Pattern, size: tuple[int, int], folder: Path, console: Console) -> Session:
    """A session that begins with what the folder holds."""
    session = Session(pattern, size)
    if not any(p.suffix.lower() in ENDINGS for p in folder.iterdir()):
        return session
    photos = read_photos([folder], lambda text: console.print(f"note: {text}"))
    if photos[0].size != size:
        raise CalibrationError(
            f"{folder}: holds views of {photos[0].size[0]}x{photos[0].size[1]}, the camera gives {size[0]}x{size[1]}; "
            "choose the same mode, or another folder with --keep"
        )
    for photo in photos:
        seen = find_board(image(photo), pattern)
        if len(seen.ids):
            session.add(seen)
    console.print(f"{folder}: goes on with {len(session.corners)} views")
    return session


def _look(session: Session, frame: "Frame", folder: Path) -> tuple[str, Sighting]:
    """Take the frame as a view if it is one; what to say of it."""
    seen = find_board(frame.image, session.pattern)
    still = session.still(seen)
    if not len(seen.ids):
        return "", seen
    new = session.gain(seen) if still else None
    if new is None:
        return "", seen
    path = _store(frame.image, folder)
    session.add(seen)
    return f"{path.name}: {new} ({len(session.corners)} views)", seen


def _store(picture: NDArray[np.uint8], folder: Path) -> Path:
    """Write a view under the next free number; whole or not at all."""
    number = 0
    while (path := folder / f"view_{number:03d}.png").exists():
        number += 1
    try:
        replace(path, cv2.imencode(".png", picture)[1].tobytes(), 0o600)  # of people, perhaps
    except OSError as e:
        raise CalibrationError(f"{path}: cannot be written: {e.strerror or e}") from None
    return path


def _screen(session: Session, seen: Sighting, said: str) -> Text:
    """The picture's regions as a small grid, the tilts beside it, and what to do."""
    covered = session.coverage
    here = regions_of(seen.uv, session.size) if len(seen.ids) else np.zeros(region_grid(session.size), bool)
    text = Text()
    for i, row in enumerate(covered.regions):
        for j, count in enumerate(row):
            style = "reverse " if here[i, j] else ""
            text.append(f" {count or '·'} ", style + ("green" if count else "yellow"))
        if i == 0:
            text.append(f"   {covered.views} views, {VIEWS} or more wanted")
        if i == 1:
            text.append("   facing ")
            for way, n in zip(LEANS, covered.leans, strict=True):
                text.append(f"{_ARROWS[way]} {n}  ", "green" if n >= 2 else "yellow")
        if i == 2:
            text.append("   board " + ("seen" if len(seen.ids) else "not seen whole"))
        text.append("\n")
    left = missing(covered)
    text.append(f"wanted: a view that {left[0]}" if left else "wanted: views from other places", "bold")
    if said:
        text.append(f"\ntaken: {said}", "green")
    text.append("\nHold the board still for a moment; Ctrl-C ends.")
    return text
