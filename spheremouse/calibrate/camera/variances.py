"""Variances and covariance of a camera calibration; contradictions between views enlarge it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from spheremouse.calibrate.camera.bundle import (
    HUBER_KNEE,
    MIN_SIGMA,
    UNDETERMINED,
    BoardAdjustment,
    Bundle,
    camera_of,
    masked_view,
    robust_sigma,
    sigma_of,
    unknowns_of,
)
from spheremouse.errors import CalibrationError
from spheremouse.geometry.least_squares.adjust import (
    Jacobian,
    cofactors,
    outlier_statistic,
    redundancy,
    variance_factors,
)
from spheremouse.geometry.rotation import Array, exp, left_jacobian
from spheremouse.geometry.statistics import FALSE_ALARM

_SIGNIFICANCE = 0.01  # chance of a contradiction between views that agree
_DRAWS = 1000
_ROUNDS = 6  # of removing false corners and estimating variances


def with_variances(bundle: Bundle, x: Array) -> tuple[Array, Array]:
    """Return robust standard deviations of a corner's coordinate in each view, (v,) px, and the unknowns."""
    sigma = np.full(len(bundle.views), np.inf)
    for _ in range(12):
        before, residuals = sigma, bundle.residuals(x)
        sigma = np.array([robust_sigma(r) for r in residuals])
        if np.all(np.abs(sigma / before - 1.0) < 0.02):
            break
        x = bundle.solve(x, sigma, HUBER_KNEE)
    return sigma, x


def with_covariance(bundle: Bundle, x: Array, used: NDArray[np.bool_], sigma: Array) -> BoardAdjustment:
    views, index = bundle.views, np.flatnonzero(used)
    kept = [np.ones(len(v.uv), bool) for v in views]
    sigma, x = sigma.copy(), x.copy()
    columns = unknowns_of(used)
    y = x[columns]
    for _ in range(_ROUNDS):
        part = Bundle([masked_view(views[v], kept[v]) for v in index.tolist()], bundle.size, bundle.free)
        y = part.solve(y, sigma[index])
        residual, J = part.jacobian(y, sigma[index])
        Q = _cofactors(J)
        rows, blocks = np.arange(len(residual)), redundancy(J, Q, 2)
        number = np.diagonal(blocks, axis1=1, axis2=2).ravel()
        test = outlier_statistic(residual.reshape(-1, 2), blocks)
        false = test > chi2.isf(FALSE_ALARM / len(test), 2)  # chance to lose a good corner
        if not false.any():
            factors = variance_factors(residual, number, [np.isin(rows, range(g.start, g.stop)) for g in part.groups])
            sigma[index] = np.maximum(sigma[index] * np.sqrt(factors), MIN_SIGMA)
            if np.all(np.abs(factors - 1.0) < 0.02):
                break
            continue
        # a false corner enlarges its neighbours' residuals: only the largest go at once
        for v, group in zip(index.tolist(), part.groups, strict=True):
            here = slice(group.start // 2, group.stop // 2)
            bad = false[here] & (test[here] >= 0.25 * test[here].max())
            kept[v][np.flatnonzero(kept[v])[bad]] = False
    part = Bundle([masked_view(views[v], kept[v]) for v in index.tolist()], bundle.size, bundle.free)
    y = part.solve(y, sigma[index])
    residual, J = part.jacobian(y, sigma[index])
    Q = _cofactors(J)
    left = len(residual) - len(Q)
    factor = max(float(residual @ residual) / left, (MIN_SIGMA / float(sigma[index].max())) ** 2)
    N, g = _on_the_camera(J, residual / np.sqrt(factor), part.groups, int(bundle.free.sum()))
    widening = contradiction(N, g)
    x[columns] = y
    camera = camera_of(x, bundle.size)
    covariance = np.zeros((9 + 6 * len(index),) * 2)
    is_open = np.concatenate([bundle.free, np.ones(6 * len(index), bool)])
    covariance[np.ix_(is_open, is_open)] = widening * _estimated_weights(N, part.counts) * factor * Q
    _into_cam(covariance, y)
    camera = replace(camera, covariance=covariance[:9, :9].copy())
    sigma_of(views, bundle.size, x, used, sigma[used])
    r, t = x[9:].reshape(-1, 2, 3).transpose(1, 0, 2)
    sigma = sigma * np.sqrt(factor)
    residuals = bundle.residuals(x)
    return BoardAdjustment(
        camera, exp(r), t, residuals, used, tuple(kept), sigma, covariance, widening, left, bundle.free
    )


def _into_cam(covariance: Array, y: Array) -> None:
    """Convert the covariance of rotation vectors to that of small rotations in cam, in place."""
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
        raise CalibrationError(UNDETERMINED) from None


def _on_the_camera(J: Jacobian, residual: Array, groups: Sequence[slice], nine: int) -> tuple[Array, Array]:
    """Normal matrices, (v, 9, 9), and gradients, (v, 9), of each view by the camera's unknowns, the pose eliminated."""
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
    """Factor on the variances because the views' weights are estimates (Meier 1953): 1 + 4 sum w (1 - w) / r.

    w is a view's share of the information, r its redundancy.
    """
    nine = N.shape[1]
    share = np.einsum("ij,vji->v", np.linalg.pinv(N.sum(axis=0), hermitian=True), N) / max(nine, 1)
    left = np.maximum(2.0 * counts - 6.0 - nine * share, 1.0)
    return float(1.0 + 4.0 * np.sum(share * (1.0 - share) / left))


def contradiction(N: Array, g: Array) -> float:
    """Return the factor on the variances for views that contradict each other; 1 if they do not significantly.

    `N` (v, 9, 9) and `g` (v, 9) are the views' normal matrices and gradients at the minimum, at unit variance. Errors
    within a view may be correlated, for example on a bent board. Then the camera without one view scatters more than
    independent errors explain. A jackknife over views measures this scatter; random draws give the expected one.
    """
    nine = N.shape[1]
    scale = 1.0 / np.sqrt(np.diagonal(np.sum(N, axis=0)))
    normals, gradient = N * np.outer(scale, scale), g * scale
    total = normals.sum(axis=0)
    try:
        without = np.linalg.inv(total - normals)
    except np.linalg.LinAlgError:  # the other views do not determine the camera
        return 1.0
    rng = np.random.default_rng(0)
    value, vector = np.linalg.eigh(normals)
    root = vector * np.sqrt(np.maximum(value, 0.0))[:, None]
    drawn = np.einsum("vij,dvj->dvi", root, rng.standard_normal((_DRAWS, len(normals), nine)))
    common = np.linalg.solve(total, drawn.sum(axis=1).T).T
    drawn -= np.einsum("vij,dj->dvi", normals, common)
    expected = _scatter(drawn, without, total)
    found = _scatter(gradient[None], without, total)[0]
    significant = float(np.mean(expected >= found)) < _SIGNIFICANCE
    return float(max(1.0, found / np.mean(expected))) if significant else 1.0


def _scatter(gradients: Array, without: Array, total: Array) -> Array:
    """Sum over views of the squared change, in standard deviations, without each view, (d,)."""
    change = np.einsum("vij,dvj->dvi", without, gradients)
    return np.einsum("dvi,ij,dvj->d", change, total, change)
