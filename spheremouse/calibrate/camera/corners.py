"""Corners of a calibration board in an image: chessboards, and ChArUco boards, which may be cut off.

OpenCV finds the board (Duda, Frese 2018; Garrido-Jurado et al. 2014 for markers). Gradients refine the corners in two
steps. `find_board` uses square windows of the image (`cornerSubPix`), in which lens and view bend the edges. After a
first calibration, `measure_in_plane` uses windows of the board's plane, in which edges are straight (Datta, Kim, Kanade
2009, without a new image). The first step alone shifts focal lengths by several standard deviations.
"""

from dataclasses import dataclass
from functools import cache
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.calibrate.board import Pattern
from spheremouse.geometry.camera import InteriorOrientation, project, unproject
from spheremouse.geometry.matching import distances
from spheremouse.geometry.rotation import Array

MAX_SEARCHED_PX = 2.0e6  # px; larger images are reduced to it for the search
_WINDOW_PER_SPACING = 0.25  # of the way to the next corner: a window turned by 45° still holds no other edge
_PLANE_WINDOW = 1.0 / 3.0  # of a square, half a side of a window in the board's plane: no blur of the next edge
_SMOOTHING_SIGMA_PX = 1.0  # px, standard deviation, for the direction of an edge
_MAX_ITERATIONS = 15
_CONVERGENCE_PX = 1e-3  # px
_MIN_WINDOW, _MAX_WINDOW = 2, 40  # px, half a side
_MAX_MOTION = 0.5  # half-windows of a corner; beyond, another edge attracts it
_MIN_SIDE = 3  # corners of the smallest board
_MIN_CHARUCO_CORNERS = 12  # twice the minimum for a pose


@dataclass(frozen=True, slots=True)
class Sighting:
    """The corners of a board in an image; without `ids`, too little of it, and `grid` is another chessboard."""

    ids: NDArray[np.intp]  # (k,) corners, row by row
    uv: Array  # (k, 2) px
    grid: tuple[int, int] | None = None  # inner corners of the largest chessboard seen, longer side first
    markers: int = 0  # ChArUco markers seen


def find_board(image: NDArray[np.uint8], pattern: Pattern, searched: float = MAX_SEARCHED_PX) -> Sighting:
    """Find the corners of a board in an image, (h, w) grey or (h, w, 3) BGR; all of a chessboard, or none.

    The search for a chessboard uses an image reduced to `searched` px, the measurement the image itself.
    """
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) if image.ndim == 3 else image
    return _find_chessboard(grey, pattern, searched) if pattern.marker is None else _find_charuco(grey, pattern)


# ---- chessboards ----


def _find_chessboard(grey: NDArray[np.uint8], pattern: Pattern, searched: float) -> Sighting:
    wanted = pattern.rows, pattern.columns
    scale = min(1.0, float(np.sqrt(searched / grey.size)))
    small = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    largest = _grid(small, (_MIN_SIDE, _MIN_SIDE), cv2.CALIB_CB_LARGER)
    shape = None if largest is None else largest.shape[:2]
    found = largest
    if shape is None or sorted(shape) != sorted(wanted):
        # a part of a larger board is another board; a smaller grid may be a part of this one, and glare adds one row
        larger = shape is not None and max(shape) >= max(wanted) and min(shape) >= min(wanted)
        one_more = shape is not None and sum(shape) == sum(wanted) + 1
        found = None if larger and not one_more else _exact(small, pattern, older_finder=not larger)
    seen = None if shape is None else (max(shape), min(shape))
    if found is None:
        return Sighting(np.empty(0, np.intp), np.empty((0, 2)), seen)
    if found.shape[:2] != wanted:
        found = np.rot90(found)  # keeps the sense of rotation: X along rows, Y down
    corners = (found + 0.5) / scale - 0.5
    uv = _refine(grey, corners)
    ids = np.flatnonzero(np.isfinite(uv).all(axis=1))
    if len(ids) < 0.9 * len(uv):
        return Sighting(np.empty(0, np.intp), np.empty((0, 2)), seen)
    return Sighting(ids, uv[ids], pattern.grid)


def _grid(grey: cv2.typing.MatLike, size: tuple[int, int], flags: int) -> Array | None:
    """Corners (rows, columns, 2); the rotation from the board's X to Y is clockwise in the image."""
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(grey, size, flags)
    if not found or meta is None or corners is None or len(corners) != meta.size:
        return None
    return _facing(np.asarray(corners, float).reshape(*meta.shape, 2))


def _exact(grey: cv2.typing.MatLike, pattern: Pattern, older_finder: bool) -> Array | None:
    """Find a board of known size, if allowed also by OpenCV's older finder, which tolerates other dirt and glare."""
    size = pattern.columns, pattern.rows
    grid = _grid(grey, size, cv2.CALIB_CB_NORMALIZE_IMAGE)
    if grid is not None or not older_finder:
        return grid
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    found, corners = cv2.findChessboardCorners(grey, size, flags=flags)
    return _facing(np.asarray(corners, float).reshape(pattern.rows, pattern.columns, 2)) if found else None


def _facing(grid: Array) -> Array:
    x, y = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    x, y = x.mean(axis=0), y.mean(axis=0)
    return grid if x[0] * y[1] - x[1] * y[0] > 0.0 else grid[:, ::-1]


def _refine(grey: NDArray[np.uint8], grid: Array) -> Array:
    """Corners, (n, 2), of a grid (rows, columns, 2); nan if the gradients lead elsewhere."""
    gaps = np.full(grid.shape[:2], np.inf)
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(grid, axis=axis), axis=2)
        for part in (slice(None, -1), slice(1, None)):
            where = (part, slice(None)) if axis == 0 else (slice(None), part)
            gaps[where] = np.minimum(gaps[where], step)
    windows = np.clip((_WINDOW_PER_SPACING * gaps).astype(int), _MIN_WINDOW, _MAX_WINDOW).ravel()
    start = grid.reshape(-1, 2).astype(np.float32)
    uv = np.empty((len(start), 2))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    for w in np.unique(windows):
        same_window = windows == w
        corners = start[same_window].reshape(-1, 1, 2)
        uv[same_window] = cv2.cornerSubPix(grey, corners, (int(w), int(w)), (-1, -1), criteria)[:, 0]
    distance = np.linalg.norm(uv - start, axis=1)
    return np.where((distance <= np.maximum(1.0, _MAX_MOTION * windows))[:, None], uv, np.nan)


# ---- in the board's plane ----


def measure_in_plane(
    image: NDArray[np.uint8], pattern: Pattern, seen: Sighting, camera: InteriorOrientation, R: Array, t: Array
) -> Sighting:
    """Measure the corners of a sighting by gradients in the board's plane; omit those that cannot be measured.

    `R` (3, 3) R_cam_board and `t` (3,) m are the board's pose by a first calibration. Edge pixels are mapped to the
    board. All gradients in a window are perpendicular to the direction to its corner (Förstner, Gülch 1987).
    """
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) if image.ndim == 3 else image
    start, _ = _on_plane(seen.uv, camera, R, t)
    reach = _reach(pattern) * pattern.square
    low, high = _boxes(start, reach, camera, R, t)
    fits = (low >= 1.0) & (high <= np.array(grey.shape[::-1]) - 2.0) & (high - low >= 2 * _MIN_WINDOW)  # nan: False
    good = np.all(fits, axis=1)
    ids, uv, start = seen.ids[good], seen.uv[good], start[good]
    if len(ids):
        corners = _where_gradients_meet(grey, start, reach, camera, R, t)
        found, _ = project(_in_cam(corners, R, t), camera)
        fine = np.linalg.norm(found - uv, axis=1) < 1.0 + 0.1 * reach / pattern.square * _side(uv)  # nan: False
        ids, uv = ids[fine], found[fine]
    return Sighting(ids, uv, seen.grid, seen.markers)


def _reach(pattern: Pattern) -> float:
    """Half a side of a window in squares, without markers."""
    if pattern.marker is None:
        return _PLANE_WINDOW
    return min(_PLANE_WINDOW, 0.5 * (1.0 - pattern.marker / pattern.square))


def _side(uv: Array) -> float:
    """Rough side of a square, px, by the nearest other corner."""
    distance = distances(uv, uv)
    return float(np.median(np.partition(distance, 1, axis=1)[:, 1])) if len(uv) > 1 else 0.0


def _in_cam(plane: Array, R: Array, t: Array) -> Array:
    return plane @ R[:, :2].T + t


def _on_plane(uv: Array, camera: InteriorOrientation, R: Array, t: Array) -> tuple[Array, Array]:
    """Intersections of pixels' rays with the board, (n, 2) m in its plane, and dplane_duv, (n, 2, 2)."""
    xy, dxy = unproject(uv, camera)
    ray = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    normal = R[:, 2]
    across = ray @ normal
    s = (normal @ t) / across
    dray = np.zeros((len(xy), 3, 2))
    dray[:, :2] = dxy
    slope = np.einsum("i,nij->nj", normal, dray) / across[:, None]
    dpoint = s[:, None, None] * (dray - ray[:, :, None] * slope[:, None, :])
    return (ray * s[:, None] - t) @ R[:, :2], np.einsum("ji,njk->nik", R[:, :2], dpoint)


def _boxes(plane: Array, reach: float, camera: InteriorOrientation, R: Array, t: Array) -> tuple[Array, Array]:
    """Boxes in the image, low and high (n, 2) px, around square windows of the plane."""
    rim = plane[:, None] + reach * np.array(list(product((-1.0, 0.0, 1.0), repeat=2)))
    uv, _ = project(_in_cam(rim.reshape(-1, 2), R, t), camera)
    uv = uv.reshape(len(plane), -1, 2)
    return uv.min(axis=1), uv.max(axis=1)


def _gradient(grey: NDArray[np.uint8]) -> tuple[cv2.typing.MatLike, cv2.typing.MatLike]:
    """Gradients along u and v, smoothed: unsmoothed differences at a sharp edge are biased to the pixel grid."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTHING_SIGMA_PX)
    return cv2.Scharr(smooth, cv2.CV_32F, 1, 0), cv2.Scharr(smooth, cv2.CV_32F, 0, 1)


def _where_gradients_meet(
    grey: NDArray[np.uint8], start: Array, reach: float, camera: InteriorOrientation, R: Array, t: Array
) -> Array:
    """Corners in the plane, (n, 2) m; nan if they leave their window."""
    low, high = _boxes(start, reach, camera, R, t)
    low, high = np.floor(low).astype(int), np.ceil(high).astype(int) + 1
    windows = [
        np.mgrid[max(v0, 0) : min(v1, grey.shape[0]), max(u0, 0) : min(u1, grey.shape[1])].reshape(2, -1)
        for (u0, v0), (u1, v1) in zip(low, high, strict=True)
    ]
    owner = np.repeat(np.arange(len(windows)), [window.shape[1] for window in windows])
    v, u = np.concatenate(windows, axis=1)
    place, slope = _on_plane(np.stack([u, v], axis=1).astype(float), camera, R, t)
    near = np.abs(place - start[owner]).max(axis=1) < 1.5 * reach  # nan: False
    gu, gv = (g[v, u].astype(float) for g in _gradient(grey))
    u, v, owner, place, slope, gu, gv = u[near], v[near], owner[near], place[near], slope[near], gu[near], gv[near]
    det = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
    gx = (gu * slope[:, 1, 1] - gv * slope[:, 1, 0]) / det  # gradient by the plane's coordinates
    gy = (gv * slope[:, 0, 0] - gu * slope[:, 0, 1]) / det
    xx, xy, yy = gx * gx, gx * gy, gy * gy
    corner = start.copy()
    pixel = np.sqrt(
        np.bincount(owner, np.abs(det), len(start)) / np.maximum(np.bincount(owner, minlength=len(start)), 1)
    )
    for _ in range(_MAX_ITERATIONS):
        d = place - corner[owner]
        weight = np.exp(-2.0 * np.sum(d * d, axis=1) / reach**2) * (np.abs(d).max(axis=1) < reach)
        sums = [
            np.bincount(owner, weight * value, len(start))
            for value in (xx, xy, yy, xx * d[:, 0] + xy * d[:, 1], xy * d[:, 0] + yy * d[:, 1])
        ]
        A, B, C, e, f = sums
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.stack([C * e - B * f, A * f - B * e], axis=1) / (A * C - B * B)[:, None]
        corner = corner + step
        corner[np.abs(corner - start).max(axis=1) > 0.5 * reach] = np.nan
        step_px = np.abs(step).max(axis=1) / pixel  # m over m in a pixel
        if np.all(~(step_px > _CONVERGENCE_PX)):
            break
    return corner


# ---- ChArUco ----


def _find_charuco(grey: NDArray[np.uint8], pattern: Pattern) -> Sighting:
    """Find corners between markers; OpenCV rejects markers that do not lie as on the board."""
    corners, ids, _, marker_ids = _charuco(pattern).detectBoard(grey)
    n = 0 if marker_ids is None else len(marker_ids)
    index = np.empty(0, np.intp) if ids is None else np.ravel(np.asarray(ids)).astype(np.intp)
    sides = [len(np.unique(k)) for k in (index % pattern.columns, index // pattern.columns)]
    if len(index) < _MIN_CHARUCO_CORNERS or min(sides) < 3:
        return Sighting(np.empty(0, np.intp), np.empty((0, 2)), markers=n)
    return Sighting(index, np.asarray(corners, float).reshape(-1, 2), markers=n)


@cache
def _charuco(pattern: Pattern) -> cv2.aruco.CharucoDetector:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, pattern.dictionary))
    size = pattern.columns + 1, pattern.rows + 1
    return cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard(size, pattern.square, pattern.marker or 0.0, dictionary))
