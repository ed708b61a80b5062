"""Interior orientation with its covariance, and the pose of each view, from corners of a board.

Bundle adjustment with known points (Wittich 2017, section 2.4.5; Zhang 2000): nine unknowns of the camera, six of each
view. Each view has an estimated variance of its own. Data snooping finds false corners. If views contradict each other
beyond the variances of their corners, the covariance is enlarged.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.calibrate.camera.bundle import (
    MIN_SIGMA,
    UNDETERMINED,
    BoardAdjustment,
    Bundle,
    View,
    all_unknowns,
    camera_of,
    masked_view,
    poses_of,
    resect_views,
    rms_of,
    sigma_of,
    spread_of,
    unknowns_of,
)
from spheremouse.calibrate.camera.variances import with_covariance, with_variances
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, interior_vector
from spheremouse.geometry.rotation import Array, exp, log

MIN_VIEWS = 3

_MAX_RESIDUAL_RATIO = 4.0  # of a view over the usual residual; sharpness and light alone make a factor of two
_MAX_START_RATIO = 20.0  # the same after the coarse start
_MAX_START_RESIDUAL = 1.0  # px
_MIN_BOARD_ANGLE = float(np.radians(6.0))  # between boards; it shortens squares by half a per cent
_FOLDS = 10
_SUBSETS, _SUBSET_VIEWS = 12, 5  # calibrations from a few views, if all together do not agree


def calibrate_board(views: Sequence[View], size: tuple[int, int], terms: int = 5) -> BoardAdjustment:
    """Calibrate a camera with images of `size` (width, height) px from views of a board.

    `terms` counts the estimated distortion terms: 0 none, 2 k1 k2, 4 also p1 p2, 5 also k3; the others stay 0. Raises
    CalibrationError if the views do not determine the camera.
    """
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f"{len(views)} {'view does' if len(views) == 1 else 'views do'} not determine a camera; take at least "
            f"{MIN_VIEWS}, better 10 to 20, from different sides"
        )
    free = np.arange(9) < 4 + terms
    x = start(views, size)
    bundle = Bundle(views, size, free)
    try:
        x = _first_adjustment(bundle, x)
    except CalibrationError:
        if _parallel(views, size, free, x):
            raise CalibrationError(UNDETERMINED) from None
        raise
    spread = spread_of(bundle, x)
    used = spread <= _MAX_START_RATIO * np.median(spread)
    sigma = spread
    for _ in range(len(views)):
        part = bundle.only(used)
        some, x[unknowns_of(used)] = with_variances(part, x[unknowns_of(used)])
        limit = _MAX_RESIDUAL_RATIO * max(float(np.median(some)), MIN_SIGMA)
        sigma = sigma_of(views, bundle.size, x, used, some)
        worst = int(np.argmax(np.where(used, sigma, 0.0)))
        again = used | (sigma <= limit)  # a view that only the coarse start rejected
        if sigma[worst] > limit and used.sum() > MIN_VIEWS:
            again[worst] = False
        if np.array_equal(again, used):
            break
        used = again
    return with_covariance(bundle, x, used, sigma)


def held_out(views: Sequence[View], found: BoardAdjustment) -> Array:
    """Return the residual RMS of each view, (v,) px, with a camera calibrated without it.

    Views are left out one by one, or in ten groups if there are more than ten. nan for views not used, and if too few
    views are left.
    """
    index = np.flatnonzero(found.used)
    result = np.full(len(views), np.nan)
    if len(index) <= MIN_VIEWS:
        return result
    x = all_unknowns(found)
    size = found.camera.width, found.camera.height
    for fold in range(min(_FOLDS, len(index))) if len(index) > _FOLDS else range(len(index)):
        out = index[fold :: min(_FOLDS, len(index))]
        rest = np.setdiff1d(index, out)
        if len(rest) < MIN_VIEWS:
            continue
        kept = [masked_view(views[v], found.kept[v]) for v in rest.tolist()]
        bundle = Bundle(kept, size, found.free)
        mask = np.zeros(len(views), bool)
        mask[rest] = True
        try:
            without = bundle.solve(x[unknowns_of(mask)], found.sigma[rest])
        except CalibrationError:
            continue
        left = [masked_view(views[v], found.kept[v]) for v in out.tolist()]
        _, _, residuals = resect_views(left, camera_of(without, size))
        result[out] = [rms_of(r) for r in residuals]
    return result


# ---- start ----


def start(views: Sequence[View], size: tuple[int, int]) -> Array:
    """Return a camera without distortion, of the best focal length for most views, and the views' poses."""
    width, height = size
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    best, least = None, np.inf
    for focal in _focals(views, size):
        camera = InteriorOrientation(width, height, focal, focal, cx, cy)
        poses = poses_of(views, camera)
        residual, _ = Bundle(views, size, np.zeros(9, bool)).evaluate(
            np.concatenate([interior_vector(camera), poses.ravel()]), np.ones(len(views))
        )
        misfit = float(np.median(np.abs(residual)))
        if misfit < least:
            best, least = np.concatenate([interior_vector(camera), poses.ravel()]), misfit
    if best is None:
        raise CalibrationError("no pose of the board explains the corners; are the photos of one camera and one board?")
    return best


def _parallel(views: Sequence[View], size: tuple[int, int], free: NDArray[np.bool_], x: Array) -> bool:
    """Return True if all boards face the same way, which leaves the focal length open."""
    try:
        y = Bundle(views, size, free & (np.arange(9) >= 4)).solve(x, np.ones(len(views)))
    except CalibrationError:
        return False
    normals = exp(y[9:].reshape(-1, 2, 3)[:, 0])[:, :, 2]
    normals *= np.sign(normals[:, 2:])
    return bool(np.all(normals @ normals[0] > np.cos(_MIN_BOARD_ANGLE)))


def _first_adjustment(bundle: Bundle, x: Array) -> Array:
    """Adjust all views, or the few that fit most of the others if all together do not agree."""
    n = len(bundle.views)
    try:
        found = bundle.solve(x, np.ones(n))
        spread = spread_of(bundle, found)
        agree = spread.max() <= _MAX_RESIDUAL_RATIO * np.median(spread) and np.median(spread) < _MAX_START_RESIDUAL
        if agree or n < _SUBSET_VIEWS:
            return found
    except CalibrationError:
        if n < _SUBSET_VIEWS:
            raise
        found, spread = None, np.full(n, np.inf)
    rng = np.random.default_rng(0)
    for _ in range(_SUBSETS):
        few = np.isin(np.arange(n), rng.choice(n, _SUBSET_VIEWS, replace=False))
        try:
            y = bundle.only(few).solve(x[unknowns_of(few)], np.ones(_SUBSET_VIEWS))
            R, t, _ = resect_views(bundle.views, camera_of(y, bundle.size))
        except CalibrationError:
            continue
        tried = np.concatenate([y[:9], np.stack([[log(r) for r in R], t], axis=1).ravel()])
        if np.median(spread_of(bundle, tried)) < np.median(spread):
            found, spread = tried, spread_of(bundle, tried)
    if found is None:
        raise CalibrationError(
            "no camera explains the views together; are the photos of one camera, one zoom, one board?"
        )
    return found


def _focals(views: Sequence[View], size: tuple[int, int]) -> Array:
    """Focal lengths for the start: that of the homographies (Zhang 2000), and those of usual lenses."""
    usual = max(size) * np.array([0.5, 0.7, 1.0, 1.4, 2.0, 3.0])
    try:
        by_views = cv2.initCameraMatrix2D(
            [v.points.astype(np.float32) for v in views], [v.uv.astype(np.float32) for v in views], size
        )[0, 0]
    except cv2.error:
        return usual
    return np.append(usual, by_views) if 0.2 * max(size) < by_views < 20.0 * max(size) else usual
