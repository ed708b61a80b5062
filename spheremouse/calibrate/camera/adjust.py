"""Corners of a board in many views -> interior orientation with its covariance, and the pose of each view.

Bundle adjustment with known points (Wittich 2017, section 2.4.5; Zhang 2000): nine unknowns of the camera, six of each
view. Each view has a variance of its own, estimated with the rest; false corners are found by data snooping; where
views contradict each other by more than their corners say, the covariance is widened until it covers that.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.calibrate.camera.bundle import (
    FLOOR,
    OPEN,
    BoardAdjustment,
    Bundle,
    View,
    all_unknowns,
    camera_of,
    kept_views,
    poses_of,
    resected,
    rms_of,
    sigma_of,
    spread_of,
    unknowns_of,
)
from spheremouse.calibrate.camera.variances import finished, with_variances
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, interior_vector
from spheremouse.geometry.rotation import Array, exp, log

MIN_VIEWS = 3
FALSE_VIEW = 4.0  # times the usual residual; sharpness and light alone make a factor of two

_OBVIOUS = 20.0  # times the usual residual: a view that no start, however coarse, would leave so far off
_COARSE = 1.0  # px: corners are never that bad
_PARALLEL = float(np.radians(6.0))  # between boards: squares are then shortened by half a per cent
_FOLDS = 10
_TRIES, _FEW = 12, 5  # calibrations from so many views, to begin with those that agree


def calibrate_board(views: Sequence[View], size: tuple[int, int], terms: int = 5) -> BoardAdjustment:
    """The camera of images of `size` (width, height) px, from views of a board.

    `terms` counts the distortion terms estimated: 0 none, 2 k1 k2, 4 also p1 p2, 5 also k3; the others stay 0. Raises
    CalibrationError where the views do not determine the camera.
    """
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f"{len(views)} {'view does' if len(views) == 1 else 'views do'} not determine a camera; take at least "
            f"{MIN_VIEWS}, better 10 to 20, from different sides"
        )
    free = np.arange(9) < 4 + terms
    x = _start(views, size)
    bundle = Bundle(views, size, free)
    try:
        x = _begun(bundle, x)
    except CalibrationError:
        if _parallel(views, size, free, x):
            raise CalibrationError(OPEN) from None
        raise
    spread = spread_of(bundle, x)
    used = spread <= _OBVIOUS * np.median(spread)
    sigma = spread
    for _ in range(len(views)):
        part = bundle.only(used)
        some, x[unknowns_of(used)] = with_variances(part, x[unknowns_of(used)])
        limit = FALSE_VIEW * max(float(np.median(some)), FLOOR)
        sigma = sigma_of(views, bundle.size, x, used, some)
        worst = int(np.argmax(np.where(used, sigma, 0.0)))
        again = used | (sigma <= limit)  # a view that the first, coarse camera did not suit
        if sigma[worst] > limit and used.sum() > MIN_VIEWS:
            again[worst] = False
        if np.array_equal(again, used):
            break
        used = again
    return finished(bundle, x, used, sigma)


def held_out(views: Sequence[View], found: BoardAdjustment) -> Array:
    """Residual RMS of each view, (v,) px, where the camera was calibrated without it; nan of views not used.

    Views are left out one by one, or in ten groups where there are more than ten. nan where the rest is too little.
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
        kept = [kept_views(views[v], found.kept[v]) for v in rest.tolist()]
        bundle = Bundle(kept, size, found.free)
        mask = np.zeros(len(views), bool)
        mask[rest] = True
        try:
            without = bundle.solve(x[unknowns_of(mask)], found.sigma[rest])
        except CalibrationError:
            continue
        left = [kept_views(views[v], found.kept[v]) for v in out.tolist()]
        _, _, residuals = resected(left, camera_of(without, size))
        result[out] = [rms_of(r) for r in residuals]
    return result


# ---- unknowns and observations ----


# ---- start ----


def _start(views: Sequence[View], size: tuple[int, int]) -> Array:
    """A camera without distortion whose focal length suits most views, and the views' poses."""
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
    """Whether all boards face the same way, which any focal length explains."""
    try:
        y = Bundle(views, size, free & (np.arange(9) >= 4)).solve(x, np.ones(len(views)))
    except CalibrationError:
        return False
    normals = exp(y[9:].reshape(-1, 2, 3)[:, 0])[:, :, 2]
    normals *= np.sign(normals[:, 2:])
    return bool(np.all(normals @ normals[0] > np.cos(_PARALLEL)))


def _begun(bundle: Bundle, x: Array) -> Array:
    """A first adjustment of all views; of the few that suit most of the others, where all together do not agree."""
    n = len(bundle.views)
    try:
        found = bundle.solve(x, np.ones(n))
        spread = spread_of(bundle, found)
        agree = spread.max() <= FALSE_VIEW * np.median(spread) and np.median(spread) < _COARSE
        if agree or n < _FEW:
            return found
    except CalibrationError:
        if n < _FEW:
            raise
        found, spread = None, np.full(n, np.inf)
    rng = np.random.default_rng(0)
    for _ in range(_TRIES):
        few = np.isin(np.arange(n), rng.choice(n, _FEW, replace=False))
        try:
            y = bundle.only(few).solve(x[unknowns_of(few)], np.ones(_FEW))
            R, t, _ = resected(bundle.views, camera_of(y, bundle.size))
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
    """Focal lengths to begin with: what homographies say (Zhang 2000), and those of usual lenses."""
    usual = max(size) * np.array([0.5, 0.7, 1.0, 1.4, 2.0, 3.0])
    try:
        said = cv2.initCameraMatrix2D(
            [v.points.astype(np.float32) for v in views], [v.uv.astype(np.float32) for v in views], size
        )[0, 0]
    except cv2.error:
        return usual
    return np.append(usual, said) if 0.2 * max(size) < said < 20.0 * max(size) else usual


# ---- variances, false observations ----
