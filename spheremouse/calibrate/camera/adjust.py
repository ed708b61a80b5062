"""Corners of a board in many views -> interior orientation with its covariance, and the pose of each view.

Bundle adjustment with known points (Wittich 2017, section 2.4.5; Zhang 2000): nine unknowns of the camera, six of each
view. Each view has a variance of its own, estimated with the rest; false corners are found by data snooping; where
views contradict each other by more than their corners say, the covariance is widened until it covers that.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.stats import chi2

from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, interior_jacobian, interior_vector, project, with_interior
from spheremouse.geometry.least_squares.adjust import Jacobian, cofactors, huber, redundancy, snooped, variance_factors
from spheremouse.geometry.rotation import Array, exp, hat, left_jacobian, log

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
MIN_VIEWS = 3
FLOOR = 0.01  # px: 8 bits tell an edge 20 px long and 100 grey values high no better
FALSE_VIEW = 4.0  # times the usual residual; sharpness and light alone make a factor of two

_OBVIOUS = 20.0  # times the usual residual: a view that no start, however coarse, would leave so far off
_COARSE = 1.0  # px: corners are never that bad
_PARALLEL = float(np.radians(6.0))  # between boards: squares are then shortened by half a per cent
_OPEN = (
    "the views leave the focal length open: the board faces the camera the same way in all of them; tilt it by 20 to "
    "45 degrees, to the left, right, up and down in turn"
)
_KNEE = 2.5  # standard deviations, of Huber's function
_FALSE_ALARM = 1e-3  # chance that a calibration without false corners loses one
_SIGNIFICANT = 0.01  # chance that views which agree are said to contradict each other
_DRAWS = 1000
_FOLDS = 10
_MOST = 200  # steps
_ROUNDS = 6  # of taking out false corners and estimating variances
_TRIES, _FEW = 12, 5  # calibrations from so many views, to begin with those that agree


@dataclass(frozen=True, slots=True)
class View:
    """Corners seen in one image."""

    points: Array  # (n, 3) m, in the board's frame
    uv: Array  # (n, 2) px


@dataclass(frozen=True, slots=True)
class BoardAdjustment:
    """The camera and its views, in the order in which they were given."""

    camera: InteriorOrientation  # with the covariance of the nine, widened by `contradiction`
    rotations: Array  # (v, 3, 3) R_cam_board
    translations: Array  # (v, 3) m, the board's origin in cam
    residuals: tuple[Array, ...]  # (n, 2) px each, seen minus computed, also of what is not used
    used: NDArray[np.bool_]  # (v,) views that took part
    kept: tuple[NDArray[np.bool_], ...]  # (n,) each, corners that took part in a used view
    sigma: Array  # (v,) px, standard deviation of a corner's coordinate in each view
    covariance: Array  # (9 + 6 u, 9 + 6 u) of the nine, then rotation (rad, in cam) and translation of each used view
    contradiction: float  # factor on the variances for views that contradict each other; 1: they do not
    redundancy: int
    free: NDArray[np.bool_]  # (9,) unknowns that were estimated

    @property
    def rms(self) -> float:
        """Root mean square distance in px of all corners that took part from where they were computed."""
        took_part = [r[k] for r, k, u in zip(self.residuals, self.kept, self.used, strict=True) if u]
        return _rms(np.concatenate(took_part))

    def view_rms(self) -> Array:
        """The same of each view, (v,) px; of views not used, of all their corners."""
        return np.array([_rms(r[k] if u else r) for r, k, u in zip(self.residuals, self.kept, self.used, strict=True)])

    @property
    def deviations(self) -> Array:
        """Standard deviations of the nine, (9,)."""
        return np.sqrt(np.diag(self.camera.covariance))

    def correlation(self) -> Array:
        """Correlations of all unknowns as `covariance` has them; of what was not estimated, 0 with all else."""
        s = np.sqrt(np.diag(self.covariance))
        s = np.where(s > 0.0, s, 1.0)
        C = self.covariance / np.outer(s, s)
        np.fill_diagonal(C, 1.0)
        return C

    def camera_positions(self) -> Array:
        """Projection centres, (v, 3) m, in the board's frame."""
        return -np.einsum("vji,vj->vi", self.rotations, self.translations)

    def tilts(self) -> Array:
        """Angle between the board's normal and the line of sight to its middle corner, (v,) rad."""
        return np.arccos(np.clip(np.abs(self.rotations[:, 2, 2]), 0.0, 1.0))


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


def resected(views: Sequence[View], camera: InteriorOrientation) -> tuple[Array, Array, tuple[Array, ...]]:
    """Poses of a known camera: R_cam_board (v, 3, 3), translation (v, 3) m, and residuals (n, 2) px of each view."""
    bundle = _Bundle(views, (camera.width, camera.height), np.zeros(9, bool))
    x = np.concatenate([interior_vector(camera), _poses(views, camera).ravel()])
    for v, view in enumerate(views):  # each for itself: quick, and none disturbs the others
        own = np.arange(len(views)) == v
        columns = _columns(own)
        with contextlib.suppress(CalibrationError):  # then it stays where it began, far off
            x[columns] = _Bundle([view], bundle.size, bundle.free).solve(x[columns], np.ones(1))
    r, t = x[9:].reshape(-1, 2, 3).transpose(1, 0, 2)
    return exp(r), t, bundle.residuals(x)


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


def _rms(residual: Array) -> float:
    """Of distances, from residuals (n, 2)."""
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


# ---- unknowns and observations ----


class _Bundle:
    """Residuals and Jacobian of some views. Unknowns: the nine, then rotation vector and translation of each view."""

    def __init__(self, views: Sequence[View], size: tuple[int, int], free: NDArray[np.bool_]) -> None:
        self.views, self.size, self.free = views, size, free
        self.points = np.concatenate([v.points for v in views])
        self.uv = np.concatenate([v.uv for v in views])
        self.counts = np.array([len(v.uv) for v in views])
        self.of = np.repeat(np.arange(len(views)), self.counts)
        nine = np.broadcast_to(np.arange(9), (len(self.uv), 9))
        six = 9 + 6 * self.of[:, None] + np.arange(6)
        where = np.hstack([nine, six])
        self._indices = np.repeat(where, 2, axis=0).ravel()
        self._indptr = np.arange(2 * len(self.uv) + 1) * 15
        self._open = np.concatenate([free, np.ones(6 * len(views), bool)])

    @property
    def groups(self) -> list[slice]:
        """Rows of each view."""
        ends = 2 * np.cumsum(self.counts)
        return [slice(int(e - 2 * n), int(e)) for e, n in zip(ends, self.counts, strict=True)]

    def only(self, used: NDArray[np.bool_]) -> "_Bundle":
        """The adjustment of some views."""
        return _Bundle([v for v, u in zip(self.views, used, strict=True) if u], self.size, self.free)

    def linear(self, x: Array) -> tuple[Array, Array]:
        """Computed minus seen, (n, 2) px, and its Jacobian (n, 2, 15) by the nine and by the view's own six."""
        camera = _camera(x, self.size)
        r, t = x[9:].reshape(-1, 2, 3).transpose(1, 0, 2)
        turned = np.einsum("nij,nj->ni", exp(r)[self.of], self.points)
        cam = turned + t[self.of]
        uv, duv = project(cam, camera)
        if not np.all(np.isfinite(uv)):  # behind the camera: worse than anything
            uv, duv = np.nan_to_num(uv, nan=1e7), np.nan_to_num(duv)
        J = np.empty((len(uv), 2, 15))
        z = np.where(cam[:, 2] > 0.0, cam[:, 2], 1.0)
        J[:, :, :9] = interior_jacobian(cam[:, :2] / z[:, None], camera) * self.free
        J[:, :, 9:12] = duv @ (-hat(turned) @ left_jacobian(r)[self.of])
        J[:, :, 12:] = duv
        return uv - self.uv, J

    def evaluate(self, x: Array, sigma: Array) -> tuple[Array, Jacobian]:
        """Residuals computed minus seen over the views' `sigma` (v,), (2n,), and their Jacobian (2n, 9 + 6v)."""
        residual, J = self.linear(x)
        weight = 1.0 / sigma[self.of]
        data = (J * weight[:, None, None]).reshape(-1)
        jacobian = sparse.csr_array((data, self._indices, self._indptr), shape=(residual.size, len(x)))
        return (residual * weight[:, None]).ravel(), jacobian

    def solve(self, x: Array, sigma: Array, robust: float | None = None) -> Array:
        """The unknowns at the minimum of squares, or of Huber's function; what is not free keeps its value.

        Levenberg and Marquardt's method; each view's six are eliminated, so that a hundred views cost little more than
        ten. CalibrationError where it does not come to rest.
        """
        weight, damping = 1.0 / sigma[self.of], 1e-4
        residual, J = self.linear(x)
        cost = _cost(residual * weight[:, None], robust)
        for _ in range(_MOST):
            w = weight[:, None] * (1.0 if robust is None else huber(residual * weight[:, None], robust))
            step, promised = self._step(residual * w, J * w[:, :, None], damping)
            if promised < 1e-9 * (cost + 1.0):
                return x
            tried = x + step
            after, J_after = self.linear(tried)
            lower = _cost(after * weight[:, None], robust)
            if lower < cost:
                x, residual, J, cost, damping = tried, after, J_after, lower, max(0.1 * damping, 1e-12)
            elif damping > 1e8:
                return x
            else:
                damping *= 10.0
        raise CalibrationError("the adjustment does not come to rest: is a photo of another zoom or board among them?")

    def _step(self, residual: Array, J: Array, damping: float) -> tuple[Array, float]:
        """Damped step of all unknowns, and by how much the linear model says that it lowers the cost."""
        starts = np.concatenate([[0], np.cumsum(self.counts)[:-1]])
        N = np.add.reduceat(np.einsum("nki,nkj->nij", J, J), starts)
        g = np.add.reduceat(np.einsum("nki,nk->ni", J, residual), starts)
        nine = N[:, :9, :9].sum(axis=0)
        nine += np.diag(damping * np.diag(nine) + ~self.free)
        own = N[:, 9:, 9:] * (1.0 + damping * np.eye(6)) + 1e-30 * np.eye(6)
        right = np.linalg.solve(own, np.concatenate([N[:, 9:, :9], g[:, 9:, None]], axis=2))
        reduced = nine - np.einsum("vij,vik->jk", N[:, 9:, :9], right[:, :, :9])
        scale = 1.0 / np.sqrt(np.diag(nine))
        gradient = g[:, :9].sum(axis=0) - np.einsum("vij,vi->j", N[:, 9:, :9], right[:, :, 9])
        try:
            camera = -scale * np.linalg.solve(reduced * np.outer(scale, scale), scale * gradient)
        except np.linalg.LinAlgError:
            camera = np.zeros(9)
        camera *= self.free
        poses = -right[:, :, 9] - right[:, :, :9] @ camera
        step = np.concatenate([camera, poses.ravel()])
        downhill = -float(camera @ g[:, :9].sum(axis=0) + np.sum(poses * g[:, 9:]))
        return step, downhill

    def jacobian(self, x: Array, sigma: Array) -> tuple[Array, Jacobian]:
        """Residuals and the columns of the Jacobian that are estimated."""
        residual, jacobian = self.evaluate(x, sigma)
        return residual, _of_columns(jacobian, self._open)

    def residuals(self, x: Array) -> tuple[Array, ...]:
        """Seen minus computed in px, (n, 2) of each view."""
        residual, _ = self.evaluate(x, np.ones(len(self.views)))
        return tuple(-residual[g].reshape(-1, 2) for g in self.groups)


def _cost(residual: Array, robust: float | None) -> float:
    size = np.abs(residual)
    if robust is None:
        return 0.5 * float(np.sum(size**2))
    return float(np.sum(np.where(size < robust, 0.5 * size**2, robust * (size - 0.5 * robust))))


def _of_columns(jacobian: Jacobian, columns: NDArray[np.bool_]) -> Jacobian:
    return jacobian if columns.all() else sparse.csr_array(jacobian.tocsc()[:, np.flatnonzero(columns)])


def _columns(used: NDArray[np.bool_]) -> NDArray[np.intp]:
    views = np.flatnonzero(used)
    return np.concatenate([np.arange(9), (9 + 6 * views[:, None] + np.arange(6)).ravel()])


def _camera(x: Array, size: tuple[int, int]) -> InteriorOrientation:
    return with_interior(InteriorOrientation(*size, 1.0, 1.0, 0.0, 0.0), x[:9])


def _kept(view: View, mask: NDArray[np.bool_]) -> View:
    return View(view.points[mask], view.uv[mask])


def _all_unknowns(found: BoardAdjustment) -> Array:
    poses = np.stack([np.array([log(R) for R in found.rotations]), found.translations], axis=1)
    return np.concatenate([interior_vector(found.camera), poses.ravel()])


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


def _sigma_of(views: Sequence[View], size: tuple[int, int], x: Array, used: NDArray[np.bool_], some: Array) -> Array:
    """Standard deviation of a corner's coordinate in each view, (v,) px; x gets the poses of views not used."""
    sigma = np.empty(len(views))
    sigma[used] = some
    out = np.flatnonzero(~used)
    if len(out):
        R, t, residuals = resected([views[v] for v in out.tolist()], _camera(x, size))
        for k, v in enumerate(out.tolist()):
            x[9 + 6 * v : 15 + 6 * v] = np.concatenate([log(R[k]), t[k]])
        sigma[out] = [_robust_sigma(r) for r in residuals]
    return sigma


def _robust_sigma(residual: Array) -> float:
    return max(1.4826 * float(np.median(np.abs(residual))), FLOOR)


def _spread(bundle: _Bundle, x: Array) -> Array:
    """Usual residual of each view, (v,) px."""
    return np.array([np.median(np.abs(r)) for r in bundle.residuals(x)])


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


def _poses(views: Sequence[View], camera: InteriorOrientation) -> Array:
    """Rotation vector and translation of each view, (v, 2, 3)."""
    found = np.empty((len(views), 2, 3))
    for i, view in enumerate(views):
        try:
            good, r, t = cv2.solvePnP(view.points, view.uv, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE)
        except cv2.error:
            good, r, t = False, np.zeros(3), np.array([0.0, 0.0, 1.0])
        if not good or not np.all(np.isfinite(r)) or not np.all(np.isfinite(t)):
            r, t = np.zeros(3), np.array([0.0, 0.0, 10.0 * np.ptp(view.points)])
        found[i] = np.ravel(r), np.ravel(t)
    return found


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
