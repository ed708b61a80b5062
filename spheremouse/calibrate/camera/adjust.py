"""Interior orientation with its covariance, and the pose of each view, from corners of a board.

Bundle adjustment with known points (Wittich 2017, section 2.4.5; Zhang 2000): nine unknowns of the camera, four of the
board's shape, six of each view. Each view has an estimated variance of its own. Data snooping finds false corners. If
views contradict each other beyond the variances of their corners, the covariance is enlarged.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.stats import chi2

from spheremouse.calibrate.camera.bundle import (
    HUBER_KNEE,
    INTERIOR,
    MIN_SIGMA,
    SHAPE,
    SHARED,
    UNDETERMINED,
    BoardAdjustment,
    Bundle,
    View,
    camera_of,
    poses_of,
    resect_views,
    robust_sigma,
    split_poses,
    unknowns_of,
)
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, interior_vector
from spheremouse.geometry.least_squares.adjust import (
    Jacobian,
    cofactors,
    outlier_statistic,
    redundancy,
    variance_factors,
)
from spheremouse.geometry.rotation import Array, exp, log
from spheremouse.geometry.statistics import FALSE_ALARM

MIN_VIEWS = 3

_MAX_RESIDUAL_RATIO = 4.0  # of a view over the usual residual; sharpness and light alone make a factor of two
_MAX_START_RATIO = 20.0  # the same after the coarse start
_MAX_START_RESIDUAL = 1.0  # px
_MIN_BOARD_ANGLE = float(np.radians(6.0))  # between boards; it shortens squares by half a per cent
_FOCALS = np.geomspace(0.4, 20.0, 14)  # focal lengths over the longer side of the picture, to start from
_SUBSETS, _SUBSET_VIEWS = 12, 5  # calibrations from a few views, if all together do not agree
_SIGNIFICANCE = 0.01  # chance of a contradiction between views that agree
_MAX_ROUNDS = 6  # of removing false corners and estimating variances


def calibrate_board(views: Sequence[View], size: tuple[int, int], terms: int = 5) -> BoardAdjustment:
    """Calibrate a camera with images of `size` (width, height) px from views of a board.

    `terms` counts the estimated distortion terms: 0 none, 2 k1 k2, 4 also p1 p2, 5 also k3; the others stay 0. Views
    that do not fit the others are left out, the worst first, while `MIN_VIEWS` stay. Raises CalibrationError if the
    views do not determine the camera.
    """
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f"{len(views)} {'view does' if len(views) == 1 else 'views do'} not determine a camera; take at least "
            f"{MIN_VIEWS}, better 10 to 20, from different sides"
        )
    free = np.concatenate([np.arange(INTERIOR) < 4 + terms, np.ones(SHAPE, bool)])
    x = start(views, size)
    bundle = Bundle(views, size, free)
    try:
        x = _first_adjustment(bundle, x)
    except CalibrationError:
        if _parallel(x):
            raise CalibrationError(UNDETERMINED) from None
        raise
    spread = bundle.spread(x)
    used = spread <= _MAX_START_RATIO * np.median(spread)
    sigma = spread
    for _ in range(len(views)):
        part = bundle.only(used)
        variance_sigma, x[unknowns_of(used)] = _with_variances(part, x[unknowns_of(used)])
        limit = _MAX_RESIDUAL_RATIO * max(float(np.median(variance_sigma)), MIN_SIGMA)
        sigma = _sigmas_and_poses(bundle, x, used, variance_sigma)
        worst = int(np.argmax(np.where(used, sigma, 0.0)))
        accepted = used | (sigma <= limit)  # a view that only the coarse start rejected
        if sigma[worst] > limit and used.sum() > MIN_VIEWS:
            accepted[worst] = False
        if np.array_equal(accepted, used):
            break
        used = accepted
    return _with_covariance(bundle, x, used, sigma)


# ---- start ----


def start(views: Sequence[View], size: tuple[int, int]) -> Array:
    """Return the unknowns of a `Bundle`, (13 + 6v,), to start from.

    The lens has no distortion, the board is flat, and the focal length is the best for most views.
    `size` is width and height in px. Raises CalibrationError if no focal length gives poses that explain the corners.
    """
    width, height = size
    cx, cy = 0.5 * (width - 1), 0.5 * (height - 1)
    best, least = None, np.inf
    for focal in max(size) * _FOCALS:
        camera = InteriorOrientation(width, height, focal, focal, cx, cy)
        poses = poses_of(views, camera)
        x = np.concatenate([interior_vector(camera), np.zeros(SHAPE), poses.ravel()])
        misfit = float(np.median(np.abs(Bundle(views, size, np.zeros(SHARED, bool)).linear(x)[0])))
        if misfit < least:
            best, least = x, misfit
    if best is None:
        raise CalibrationError("no pose of the board explains the corners; are the photos of one camera and one board?")
    return best


def _parallel(x: Array) -> bool:
    """Return True if all boards face the same way, which leaves the focal length open."""
    normals = exp(split_poses(x)[0])[:, :, 2]
    normals *= np.sign(normals[:, 2:])
    return bool(np.all(normals @ normals[0] > np.cos(_MIN_BOARD_ANGLE)))


def _first_adjustment(bundle: Bundle, x: Array) -> Array:
    """Adjust all views, or the few that fit most of the others if all together do not agree."""
    n = len(bundle.views)
    try:
        found = bundle.solve(x, np.ones(n))
        spread = bundle.spread(found)
        agree = spread.max() <= _MAX_RESIDUAL_RATIO * np.median(spread) and np.median(spread) < _MAX_START_RESIDUAL
        if agree or n < _SUBSET_VIEWS:
            return found
    except CalibrationError:
        if n < _SUBSET_VIEWS:
            raise
        found, spread = None, np.full(n, np.inf)
    rng = np.random.default_rng(0)
    for _ in range(_SUBSETS):
        subset = np.isin(np.arange(n), rng.choice(n, _SUBSET_VIEWS, replace=False))
        try:
            y = bundle.only(subset).solve(x[unknowns_of(subset)], np.ones(_SUBSET_VIEWS))
            R, t, _ = resect_views(bundle.views, camera_of(y, bundle.size), y[INTERIOR:SHARED], bundle.plate)
        except CalibrationError:
            continue
        tried = np.concatenate([y[:SHARED], np.stack([[log(r) for r in R], t], axis=1).ravel()])
        if np.median(bundle.spread(tried)) < np.median(spread):
            found, spread = tried, bundle.spread(tried)
    if found is None:
        raise CalibrationError(
            "no camera explains the views together; are the photos of one camera, one zoom, one board?"
        )
    return found


# ---- variances ----


def _with_variances(bundle: Bundle, x: Array) -> tuple[Array, Array]:
    """Return robust standard deviations of a corner's coordinate in each view, (v,) px, and the unknowns."""
    sigma = np.full(len(bundle.views), np.inf)
    for _ in range(12):
        before, residuals = sigma, bundle.residuals(x)
        sigma = np.array([robust_sigma(r) for r in residuals])
        if np.all(np.abs(sigma / before - 1.0) < 0.02):
            break
        x = bundle.solve(x, sigma, HUBER_KNEE)
    return sigma, x


def _sigmas_and_poses(bundle: Bundle, x: Array, used: NDArray[np.bool_], own_sigma: Array) -> Array:
    """Return the standard deviation of a corner's coordinate in each view, (v,) px, and set missing poses in x.

    x (13 + 6v,) are the unknowns of a `Bundle`. `own_sigma` has the standard deviations of the `used` views, (v,), in
    their order. The others are resected with the camera of x: their poses go into x, their standard deviations follow
    from their residuals.
    """
    sigma = np.empty(len(bundle.views))
    sigma[used] = own_sigma
    left_out = np.flatnonzero(~used)
    if len(left_out):
        others = [bundle.views[v] for v in left_out.tolist()]
        R, t, residuals = resect_views(others, camera_of(x, bundle.size), x[INTERIOR:SHARED], bundle.plate)
        for k, v in enumerate(left_out.tolist()):
            x[SHARED + 6 * v : SHARED + 6 + 6 * v] = np.concatenate([log(R[k]), t[k]])
        sigma[left_out] = [robust_sigma(r) for r in residuals]
    return sigma


def _with_covariance(bundle: Bundle, x: Array, used: NDArray[np.bool_], sigma: Array) -> BoardAdjustment:
    views, index = bundle.views, np.flatnonzero(used)
    kept = [np.ones(len(v.uv), bool) for v in views]
    sigma, x = sigma.copy(), x.copy()
    columns = unknowns_of(used)
    y = x[columns]

    def adjusted(y: Array) -> tuple[Bundle, Array, Array, Jacobian, Array]:
        """The used views without false corners, their unknowns, residuals, Jacobian and cofactors."""
        part = Bundle([views[v].take(kept[v]) for v in index.tolist()], bundle.size, bundle.free, bundle.plate)
        y = part.solve(y, sigma[index])
        residual, J = part.jacobian(y, sigma[index])
        try:
            return part, y, residual, J, cofactors(J)
        except np.linalg.LinAlgError:
            raise CalibrationError(UNDETERMINED) from None

    for _ in range(_MAX_ROUNDS):
        part, y, residual, J, Q = adjusted(y)
        blocks = redundancy(J, Q, 2)
        number = np.diagonal(blocks, axis1=1, axis2=2).ravel()
        test = outlier_statistic(residual.reshape(-1, 2), blocks)
        false = test > chi2.isf(FALSE_ALARM / len(test), 2)  # chance to lose a good corner
        false[-SHAPE // 2 :] = False  # the board's shape is no corner
        if not false.any():
            factors = variance_factors(residual, number, part.groups)
            sigma[index] = np.maximum(sigma[index] * np.sqrt(factors), MIN_SIGMA)
            if np.all(np.abs(factors - 1.0) < 0.02):
                break
            continue
        # a false corner enlarges its neighbours' residuals: only the largest go at once
        for v, group in zip(index.tolist(), part.groups, strict=True):
            here = group[::2]
            bad = false[here] & (test[here] >= 0.25 * test[here].max())
            kept[v][np.flatnonzero(kept[v])[bad]] = False
    part, y, residual, J, Q = adjusted(y)
    left = len(residual) - len(Q)
    factor = max(float(residual @ residual) / left, (MIN_SIGMA / float(sigma[index].max())) ** 2)
    shared = int(bundle.free.sum())
    N, g = _on_the_shared(J, residual / np.sqrt(factor), part.groups, shared)
    observed = J[-SHAPE:, :shared].toarray()
    prior = observed.T @ observed
    widening = contradiction(N, g, prior)
    covariance = np.zeros((SHARED + 6 * len(index),) * 2)
    estimated = bundle.estimated(len(y))
    covariance[np.ix_(estimated, estimated)] = widening * _estimated_weights(N, prior, part.counts) * factor * Q
    of_shape = covariance[INTERIOR:SHARED, INTERIOR:SHARED].copy()
    covariance = np.delete(np.delete(covariance, np.s_[INTERIOR:SHARED], axis=0), np.s_[INTERIOR:SHARED], axis=1)
    x[columns] = y
    _sigmas_and_poses(bundle, x, used, sigma[used])
    camera = replace(camera_of(x, bundle.size), covariance=covariance[:INTERIOR, :INTERIOR].copy())
    r, t = split_poses(x)
    by_shape = bundle.plate.by_shape(bundle.points)[:, 2]
    bow = by_shape @ x[INTERIOR:SHARED]
    farthest = by_shape[int(np.argmax(np.abs(bow)))]
    return BoardAdjustment(
        camera,
        exp(r),
        t,
        bundle.residuals(x),
        used,
        tuple(kept),
        sigma * np.sqrt(factor),
        covariance,
        widening,
        bundle.free[:INTERIOR],
        bow=(float(np.max(np.abs(bow))), float(np.sqrt(farthest @ of_shape @ farthest))),
        stretch=(float(x[INTERIOR]), float(np.sqrt(of_shape[0, 0]))),
    )


def _on_the_shared(J: Jacobian, residual: Array, groups: Sequence[NDArray[np.bool_]], k: int) -> tuple[Array, Array]:
    """Normal matrices, (v, k, k), and gradients, (v, k), of each view by the k shared unknowns, the pose eliminated."""
    N, g, dense = [], [], J.toarray()
    for group in groups:
        rows = dense[group]
        A = rows[:, :k]
        B = rows[:, k:][:, np.any(rows[:, k:] != 0.0, axis=0)]
        basis, _ = np.linalg.qr(B)
        A = A - basis @ (basis.T @ A)
        N.append(A.T @ A)
        g.append(A.T @ residual[group])
    return np.array(N), np.array(g)


def _estimated_weights(N: Array, prior: Array, counts: NDArray[np.intp]) -> float:
    """Factor on the variances because the views' weights are estimates (Meier 1953): 1 + 4 sum w (1 - w) / r.

    w is a view's share of the information, r its redundancy.
    """
    k = N.shape[1]
    share = np.einsum("ij,vji->v", np.linalg.pinv(N.sum(axis=0) + prior, hermitian=True), N) / max(k, 1)
    left = np.maximum(2.0 * counts - 6.0 - k * share, 1.0)
    return float(1.0 + 4.0 * np.sum(share * (1.0 - share) / left))


def contradiction(N: Array, g: Array, prior: Array) -> float:
    """Return the factor on the variances for views that contradict each other; 1 if they do not significantly.

    `N` (v, k, k) and `g` (v, k) are the views' normal matrices and gradients at the minimum, at unit variance. `prior`
    (k, k) is the normal matrix of the shape's observations. Errors within a view may be correlated, for example on a
    board that bends as it is held. Then the camera without one view scatters more than independent errors explain. A
    jackknife over views measures this scatter, a quadratic form of the gradients. The first two moments of such forms
    give its expectation and the test (Satterthwaite 1946).
    """
    v, k = g.shape
    scale = 1.0 / np.sqrt(np.diagonal(np.sum(N, axis=0) + prior))
    normals, gradient = N * np.outer(scale, scale), g * scale
    total = normals.sum(axis=0) + prior * np.outer(scale, scale)
    try:
        without = np.linalg.inv(total - normals)
    except np.linalg.LinAlgError:  # the other views do not determine the camera
        return 1.0
    change = np.einsum("vij,vj->vi", without, gradient)
    found = float(np.einsum("vi,ij,vj->", change, total, change))
    flat = normals.reshape(v * k, k)
    covariance = block_diag(*normals) - flat @ np.linalg.solve(total, flat.T)  # of the gradients
    form = block_diag(*(without @ total @ without)) @ covariance
    expected, half_variance = float(np.trace(form)), float(np.einsum("ij,ji->", form, form))
    significant = chi2.sf(found * expected / half_variance, expected**2 / half_variance) < _SIGNIFICANCE
    return max(1.0, found / expected) if significant else 1.0
