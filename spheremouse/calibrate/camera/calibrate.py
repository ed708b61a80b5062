"""Calibration of a camera from photos of a board, and reasons why photos cannot be used."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

import numpy as np

from spheremouse.calibrate import photos
from spheremouse.calibrate.board import Pattern
from spheremouse.calibrate.camera.adjust import MIN_VIEWS, calibrate_board
from spheremouse.calibrate.camera.bundle import BoardAdjustment, View
from spheremouse.calibrate.camera.corners import Sighting, find_board, measure_in_plane
from spheremouse.calibrate.camera.coverage import Coverage, coverage
from spheremouse.calibrate.photos import Photo, image
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import fold_in_picture

_MIN_DISTANCE, _MAX_DISTANCE = 0.02, 30.0  # m, of a board that a person holds before a webcam
_MIN_CORNERS = 12  # of a chessboard; grids of 3x3 also appear in photos of a device
_MAX_FOCAL_SIGMA = 0.1  # of the focal length
_MAX_FOLDED = 0.05  # of the picture
_MIN_SEEN_OF_FOLD = 0.8  # of the distance from the principal point to a fold


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """Result of a camera's calibration, for files and report."""

    photos: tuple[Photo, ...]  # all, in the order given
    pattern: Pattern
    index: tuple[int, ...]  # of the photos that are views
    views: tuple[View, ...]
    found: BoardAdjustment
    coverage: Coverage
    skipped: dict[int, str]  # photo: reason why it is no view


# ---- the calibration ----


def calibrate(
    photos: Sequence[Photo], pattern: Pattern, terms: int = 5, progress: Callable[[str], object] = lambda _: None
) -> CameraCalibration:
    """Calibrate the camera that took the photos; CalibrationError if they do not determine it.

    `progress` is called with the next task, twice for each photo.
    """
    size = photos[0].size
    seen = []
    for photo in photos:
        progress("finding the board")
        seen.append(find_board(image(photo), pattern))
    index = [i for i, s in enumerate(seen) if len(s.ids)]
    if len(index) < MIN_VIEWS:
        raise _too_few(photos, seen, pattern)
    first = calibrate_board([view_of(seen[i], pattern) for i in index], size, terms)
    fine = {i: seen[i] for i in index}
    for k, i in enumerate(index):
        progress("measuring corners")
        if first.used[k]:
            R, t = first.rotations[k], first.translations[k]
            refined = measure_in_plane(image(photos[i]), pattern, seen[i], first.camera, R, t)
            fine[i] = refined if len(refined.ids) >= 0.8 * len(seen[i].ids) else seen[i]
    views = [view_of(fine[i], pattern) for i in index]
    found = calibrate_board(views, size, terms)
    _check_plausible(found, pattern)
    used = np.flatnonzero(found.used).tolist()
    covered = coverage(size, [views[k].uv for k in used], found.rotations[found.used])
    _check_fold(found, covered)
    skipped = {i: rejection_reason(s, pattern) for i, s in enumerate(seen) if i not in fine}
    return CameraCalibration(tuple(photos), pattern, tuple(index), tuple(views), found, covered, skipped)


def view_of(seen: Sighting, pattern: Pattern) -> View:
    """Return the corners of a sighting of a board."""
    return View(pattern.corners()[seen.ids], seen.uv)


def rejection_reason(seen: Sighting, pattern: Pattern) -> str:
    """Return the reason why a photo is no view."""
    if pattern.marker is not None:
        return f"shows {seen.markers} markers of {pattern.dictionary}, and too few corners of this board"
    if seen.grid == pattern.grid:
        return "the board cannot be made out sharply"
    if not _is_board(seen.grid):
        return "shows no chessboard"
    return f"shows {seen.grid[0]}x{seen.grid[1]} corners of a chessboard, not {pattern.words['board']}"


def _is_board(grid: tuple[int, int] | None) -> TypeGuard[tuple[int, int]]:
    """Return True for a chessboard, False for a few edges that happen to cross."""
    return grid is not None and grid[0] * grid[1] >= _MIN_CORNERS


def _too_few(photos: Sequence[Photo], seen: Sequence[Sighting], pattern: Pattern) -> CalibrationError:
    """Find the reason why there are too few views."""
    n, board = sum(1 for s in seen if len(s.ids)), pattern.words["board"]
    if pattern.marker is None:
        grids = Counter(s.grid for s in seen if _is_board(s.grid) and not len(s.ids))
        grids.pop(pattern.grid, None)
        if grids:
            (grid, times), *_ = grids.most_common()
            name = next(p.path.name for p, s in zip(photos, seen, strict=True) if s.grid == grid and not len(s.ids))
            if times >= 2 and times > n and times >= 0.5 * len(photos):
                return CalibrationError(
                    f"the board in {name} has {grid[0]}x{grid[1]} inner corners, not {board}"
                    f" ({times} of {len(photos)} photos agree); give --board {grid[0]}x{grid[1]}, or photos of the "
                    "other board"
                )
    if n == 0 and any(s.markers for s in seen):
        return CalibrationError(
            f"the markers do not lie as on a board of {board} inner corners with {pattern.dictionary}; count "
            f"the squares ({board} inner corners are {pattern.columns + 1} by {pattern.rows + 1} squares), "
            "along first, and give --board and --dictionary"
        )
    if n == 0 and not any(_is_board(s.grid) for s in seen):
        advice = "It must be sharp, and whole in each; a ChArUco board needs --marker and --dictionary"
        if pattern.marker is not None:
            advice = f"It must be near, with markers of {pattern.dictionary}; a chessboard needs no --marker"
        return CalibrationError(
            f"no board found in {len(photos)} photo{'' if len(photos) == 1 else 's'} ({photos[0].path} ...): are they "
            f"photos of the board? {advice}"
        )
    whole = "the whole board" if pattern.marker is None else "the board"
    return CalibrationError(
        f"{whole} ({board} inner corners) is seen in {n} of {len(photos)} photos, and 3 are the least; take "
        f"10 to 20 that show it from different sides{_reasons(photos, seen, pattern)}"
    )


def _reasons(photos: Sequence[Photo], seen: Sequence[Sighting], pattern: Pattern) -> str:
    """Reasons why photos are no views, each with its photos."""
    because: dict[str, list[str]] = {}
    for photo, s in zip(photos, seen, strict=True):
        if not len(s.ids):
            because.setdefault(rejection_reason(s, pattern), []).append(photo.path.name)
    return "".join(f". {', '.join(names)}: {reason}" for reason, names in because.items())


def _check_plausible(found: BoardAdjustment, pattern: Pattern) -> None:
    """Refuse an undetermined focal length, a wrong unit, and contradicting photos."""
    camera, sigma = found.camera, found.deviations
    loose = float(np.max(sigma[:2] / np.array([camera.fx, camera.fy])))
    if loose > _MAX_FOCAL_SIGMA or not np.isfinite(loose):
        tilt = float(np.degrees(found.tilts()[found.used].max()))
        raise CalibrationError(
            f"the focal length stays open ({camera.fx:.0f} px with a standard deviation of {sigma[0]:.0f}): the board "
            f"is never tilted by more than {tilt:.0f} degrees, or always to the same side; add photos with the board "
            "tilted by 20 to 45 degrees to the left, right, up and down"
        )
    if int(found.used.sum()) < MIN_VIEWS:
        raise CalibrationError("the photos contradict each other; are they of one camera, one zoom and one board?")
    distance = float(np.median(np.linalg.norm(found.camera_positions()[found.used], axis=1)))
    if not _MIN_DISTANCE < distance < _MAX_DISTANCE:
        raise CalibrationError(
            f"--square {_length(pattern.square)} puts the camera {_length(distance)} from the board; measure a square, "
            "and give it with its unit"
        )


def _check_fold(found: BoardAdjustment, covered: Coverage) -> None:
    """Refuse a lens model that is not one-to-one in the picture, as in OpenCV's issue 15577.

    Some lenses fold in the outermost corners. Such a fold is allowed if boards were seen almost up to it.
    """
    camera = found.camera
    share, distance = fold_in_picture(camera)
    seen = covered.reach * 0.5 * float(np.hypot(camera.width - 1, camera.height - 1))
    if share > _MAX_FOLDED or seen < _MIN_SEEN_OF_FOLD * distance < np.inf:
        fewer = ", or leave out distortion terms with --distortion 2" if found.free[6:].any() else ""
        raise CalibrationError(
            f"the lens model is not one-to-one in the picture: it folds {distance:.0f} px from the principal point, "
            f"where {100 * share:.1f} % of the picture begin, and no corner was seen beyond {seen:.0f} px; "
            f"add photos with the board out to the picture's corners{fewer}"
        )


def _length(metres: float) -> str:
    return f"{metres:.3g} m" if metres >= 1.0 else f"{1e3 * metres:.3g} mm"


def provenance(calibration: CameraCalibration) -> dict[str, Any]:
    """Return the provenance for the camera file: board, residual, photos with their hashes."""
    pattern = calibration.pattern
    more: dict[str, Any] = {"board": pattern.words["board"], "square": pattern.square}
    if pattern.marker is not None:
        more |= {"marker": pattern.marker, "dictionary": pattern.dictionary}
    more["rms_px"] = round(calibration.found.rms, 4)
    skipped = calibration.skipped | inconsistent_views(calibration)
    return photos.provenance("calibrate camera", calibration.photos, skipped, more)


def inconsistent_views(calibration: CameraCalibration) -> dict[int, str]:
    """Return the photos with a board that does not fit the camera of the others, with the residuals."""
    rms = calibration.found.view_rms()
    return {
        i: f"does not fit the others ({rms[k]:.2f} px, they {calibration.found.rms:.2f}): another zoom, focus or board?"
        for k, i in enumerate(calibration.index)
        if not calibration.found.used[k]
    }
