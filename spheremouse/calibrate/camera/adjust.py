"""Corners of a board in many views -> interior orientation with its covariance, and the pose of each view.

Bundle adjustment with known points (Wittich 2017, section 2.4.5; Zhang 2000): nine unknowns of the camera, six of each
view. Each view has a variance of its own, estimated with the rest; false corners are found by data snooping; where
views contradict each other by more than their corners say, the covariance is widened until it covers that.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from spheremouse.calibrate.camera.bundle import (
    _KNEE,
    _OPEN,
    FLOOR,
    BoardAdjustment,
    View,
    _all_unknowns,
    _Bundle,
    _camera,
    _columns,
    _kept,
    _poses,
    _rms,
    _robust_sigma,
    _sigma_of,
    _spread,
    resected,
)
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, interior_vector
from spheremouse.geometry.least_squares.adjust import Jacobian, cofactors
from spheremouse.geometry.least_squares.reliability import redundancy, snooped, variance_factors
from spheremouse.geometry.rotation import Array, exp, left_jacobian, log

MIN_VIEWS = 3
FALSE_VIEW = 4.0  # times the usual residual; sharpness and light alone make a factor of two

_OBVIOUS = 20.0  # times the usual residual: a view that no start, however coarse, would leave so far off
_COARSE = 1.0  # px: corners are never that bad
_PARALLEL = float(np.radians(6.0))  # between boards: squares are then shortened by half a per cent
_FALSE_ALARM = 1e-3  # chance that a calibration without false corners loses one
_SIGNIFICANT = 0.01  # chance that views which agree are said to contradict each other
_DRAWS = 1000
_FOLDS = 10
_ROUNDS = 6  # of taking out false corners and estimating variances
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
    bundle = _Bundle(views, size, free)
    try:
        x = _begun(bundle, x)
    except CalibrationError:
        if _parallel(views, size, free, x):
            raise CalibrationError(_OPEN) from None
        raise
    spread = _spread(bundle, x)
    used = spread <= _OBVIOUS * np.median(spread)
    sigma = spread
    for _ in range(len(views)):
        part = bundle.only(used)
        some, x[_columns(used)] = _with_variances(part, x[_columns(used)])
        limit = FALSE_VIEW * max(float(np.median(some)), FLOOR)
        sigma = _sigma_of(views, bundle.size, x, used, some)
        worst = int(np.argmax(np.where(used, sigma, 0.0)))
        again = used | (sigma <= limit)  # a view that the first, coarse camera did not suit
        if sigma[worst] > limit and used.sum() > MIN_VIEWS:
            again[worst] = False
        if np.array_equal(again, used):
            break
        used = again
    return _finished(bundle, x, used, sigma)


def held_out(views: Sequence[View], found: BoardAdjustment) -> Array:
    """Residual RMS of each view, (v,) px, where the camera was calibrated without it; nan of views not used.

    Views are left out one by one, or in ten groups where there are more than ten. nan where the rest is too little.
    """
    index = np.flatnonzero(found.used)
    result = np.full(len(views), np.nan)
    if len(index) <= MIN_VIEWS:
        return result
    x = _all_unknowns(found)
    size = found.camera.width, found.camera.height
    for fold in range(min(_FOLDS, len(index))) if len(index) > _FOLDS else range(len(index)):
        out = index[fold :: min(_FOLDS, len(index))]
        rest = np.setdiff1d(index, out)
        if len(rest) < MIN_VIEWS:
            continue
        kept = [_kept(views[v], found.kept[v]) for v in rest.tolist()]
        bundle = _Bundle(kept, size, found.free)
        mask = np.zeros(len(views), bool)
        mask[rest] = True
        try:
            without = bundle.solve(x[_columns(mask)], found.sigma[rest])
        except CalibrationError:
            continue
        left = [_kept(views[v], found.kept[v]) for v in out.tolist()]
        _, _, residuals = resected(left, _camera(without, size))
        result[out] = [_rms(r) for r in residuals]
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
        poses = _poses(views, camera)
        residual, _ = _Bundle(views, size, np.zeros(9, bool)).evaluate(
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
        y = _Bundle(views, size, free & (np.arange(9) >= 4)).solve(x, np.ones(len(views)))
    except CalibrationError:
        return False
    normals = exp(y[9:].reshape(-1, 2, 3)[:, 0])[:, :, 2]
    normals *= np.sign(normals[:, 2:])
    return bool(np.all(normals @ normals[0] > np.cos(_PARALLEL)))


def _begun(bundle: _Bundle, x: Array) -> Array:
    """A first adjustment of all views; of the few that suit most of the others, where all together do not agree."""
    n = len(bundle.views)
    try:
        found = bundle.solve(x, np.ones(n))
        spread = _spread(bundle, found)
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
            y = bundle.only(few).solve(x[_columns(few)], np.ones(_FEW))
            R, t, _ = resected(bundle.views, _camera(y, bundle.size))
        except CalibrationError:
            continue
        tried = np.concatenate([y[:9], np.stack([[log(r) for r in R], t], axis=1).ravel()])
        if np.median(_spread(bundle, tried)) < np.median(spread):
            found, spread = tried, _spread(bundle, tried)
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


def _with_variances(bundle: _Bundle, x: Array) -> tuple[Array, Array]:
    """Standard deviation of a corner's coordinate in each view, robustly, (v,) px, and the unknowns with them."""
    sigma = np.full(len(bundle.views), np.inf)
    for _ in range(12):
        before, residuals = sigma, bundle.residuals(x)
        sigma = np.array([_robust_sigma(r) for r in residuals])
        if np.all(np.abs(sigma / before - 1.0) < 0.02):
            break
        x = bundle.solve(x, sigma, _KNEE)
    return sigma, x


def _finished(bundle: _Bundle, x: Array, used: NDArray[np.bool_], sigma: Array) -> BoardAdjustment:
    views, index = bundle.views, np.flatnonzero(used)
    kept = [np.ones(len(v.uv), bool) for v in views]
    sigma, x = sigma.copy(), x.copy()
    columns = _columns(used)
    y = x[columns]
    for _ in range(_ROUNDS):
        part = _Bundle([_kept(views[v], kept[v]) for v in index.tolist()], bundle.size, bundle.free)
        y = part.solve(y, sigma[index])
        residual, J = part.jacobian(y, sigma[index])
        Q = _cofactors(J)
        rows, blocks = np.arange(len(residual)), redundancy(J, Q, 2)
        number = np.diagonal(blocks, axis1=1, axis2=2).ravel()
        test = snooped(residual.reshape(-1, 2), blocks)
        false = test > chi2.isf(_FALSE_ALARM / len(test), 2)
        if not false.any():
            factors = variance_factors(residual, number, [np.isin(rows, range(g.start, g.stop)) for g in part.groups])
            sigma[index] = np.maximum(sigma[index] * np.sqrt(factors), FLOOR)
            if np.all(np.abs(factors - 1.0) < 0.02):
                break
            continue
        # the worst corner of a place pulls its neighbours along: only those that stand out from them go at once
        for v, group in zip(index.tolist(), part.groups, strict=True):
            here = slice(group.start // 2, group.stop // 2)
            bad = false[here] & (test[here] >= 0.25 * test[here].max())
            kept[v][np.flatnonzero(kept[v])[bad]] = False
    part = _Bundle([_kept(views[v], kept[v]) for v in index.tolist()], bundle.size, bundle.free)
    y = part.solve(y, sigma[index])
    residual, J = part.jacobian(y, sigma[index])
    Q = _cofactors(J)
    left = len(residual) - len(Q)
    factor = max(float(residual @ residual) / left, (FLOOR / float(sigma[index].max())) ** 2)
    N, g = _on_the_camera(J, residual / np.sqrt(factor), part.groups, int(bundle.free.sum()))
    doubt = contradiction(N, g)
    x[columns] = y
    camera = _camera(x, bundle.size)
    covariance = np.zeros((9 + 6 * len(index),) * 2)
    is_open = np.concatenate([bundle.free, np.ones(6 * len(index), bool)])
    covariance[np.ix_(is_open, is_open)] = doubt * _estimated_weights(N, part.counts) * factor * Q
    _into_cam(covariance, y)
    camera = replace(camera, covariance=covariance[:9, :9].copy())
    _sigma_of(views, bundle.size, x, used, sigma[used])
    r, t = x[9:].reshape(-1, 2, 3).transpose(1, 0, 2)
    sigma = sigma * np.sqrt(factor)
    residuals = bundle.residuals(x)
    return BoardAdjustment(camera, exp(r), t, residuals, used, tuple(kept), sigma, covariance, doubt, left, bundle.free)


def _into_cam(covariance: Array, y: Array) -> None:
    """Covariance of rotation vectors into that of small rotations in cam, in place."""
    r = y[9:].reshape(-1, 2, 3)[:, 0]
    J = left_jacobian(r)
    for v in range(len(r)):
        rows = slice(9 + 6 * v, 12 + 6 * v)
        covariance[rows] = J[v] @ covariance[rows]
        covariance[:, rows] = covariance[:, rows] @ J[v].T


def _cofactors(J: Jacobian) -> Array:
    try:
        return cofactors(J)
    except np.linalg.LinAlgError:
        raise CalibrationError(_OPEN) from None


def _on_the_camera(J: Jacobian, residual: Array, groups: Sequence[slice], nine: int) -> tuple[Array, Array]:
    """Normal matrices, (v, 9, 9), and gradients, (v, 9), by the camera's unknowns, of each view less its pose."""
    N, g, dense = [], [], J.toarray()
    for group in groups:
        rows = dense[group]
        A = rows[:, :nine]
        B = rows[:, nine:][:, np.any(rows[:, nine:] != 0.0, axis=0)]
        basis, _ = np.linalg.qr(B)
        A = A - basis @ (basis.T @ A)
        N.append(A.T @ A)
        g.append(A.T @ residual[group])
    return np.array(N), np.array(g)


def _estimated_weights(N: Array, counts: NDArray[np.intp]) -> float:
    """Factor on the variances because the views' weights are estimated themselves (Meier 1953).

    With a view's share w of what is known and its redundancy r: 1 + 4 sum w (1 - w) / r.
    """
    nine = N.shape[1]
    share = np.einsum("ij,vji->v", np.linalg.pinv(N.sum(axis=0), hermitian=True), N) / max(nine, 1)
    left = np.maximum(2.0 * counts - 6.0 - nine * share, 1.0)
    return float(1.0 + 4.0 * np.sum(share * (1.0 - share) / left))


def contradiction(N: Array, g: Array) -> float:
    """Factor on the variances that makes up for views which contradict each other; 1 where they do not significantly.

    `N` (v, 9, 9) and `g` (v, 9) are the views' normal matrices and gradients at the minimum, at unit variance. Errors
    of the corners of one view may go together: a bent board, a blur to one side. Then each view is one observation
    rather than many, and what the camera becomes without a view scatters more than the corners say. That scatter
    (jackknife over views) is compared with what independent errors give, drawn at random.
    """
    nine = N.shape[1]
    scale = 1.0 / np.sqrt(np.diagonal(np.sum(N, axis=0)))
    normals, gradient = N * np.outer(scale, scale), g * scale
    total = normals.sum(axis=0)
    try:
        without = np.linalg.inv(total - normals)
    except np.linalg.LinAlgError:  # one view holds the camera alone: nothing can contradict it
        return 1.0
    rng = np.random.default_rng(0)
    value, vector = np.linalg.eigh(normals)
    root = vector * np.sqrt(np.maximum(value, 0.0))[:, None]
    drawn = np.einsum("vij,dvj->dvi", root, rng.standard_normal((_DRAWS, len(normals), nine)))
    common = np.linalg.solve(total, drawn.sum(axis=1).T).T
    drawn -= np.einsum("vij,dj->dvi", normals, common)
    expected = _scatter(drawn, without, total)
    seen = _scatter(gradient[None], without, total)[0]
    significant = float(np.mean(expected >= seen)) < _SIGNIFICANT
    return float(max(1.0, seen / np.mean(expected))) if significant else 1.0


def _scatter(gradients: Array, without: Array, total: Array) -> Array:
    """Sum over views of the squared change, in standard deviations, that each view's absence makes, (d,)."""
    change = np.einsum("vij,dvj->dvi", without, gradients)
    return np.einsum("dvi,ij,dvj->d", change, total, change)
