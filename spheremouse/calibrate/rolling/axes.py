"""What rolling leaves open: which way is up, and how long a metre is. The axes of `obj` in the camera, and the scale.

From ring targets whose places are known, from the sizes and places of targets that are not surveyed, or from two
gestures: the ball rolled forward and to the right. All with covariances of the rotation R_obj_cam, error exp(e) R with
e in `obj`, as Pose has it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import cv2
import numpy as np
from scipy.optimize import least_squares

from spheremouse.ball.pose import Sighting, predict_targets
from spheremouse.ball.rig import Rig
from spheremouse.calibrate.rolling.adjust import lens_root
from spheremouse.calibrate.rolling.problem import Rolling
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import (
    InteriorOrientation,
    Pose,
    interior_vector,
    unproject,
    with_interior,
)
from spheremouse.geometry.rotation import Array, align, exp, left_jacobian, log

SIZE = 0.005, 0.002  # part by which printed rings may be off in size: all of them alike, and each by itself
RIM = 0.05, 0.02  # px, of a ring's radius as seen: colours that run do so alike on all
PLACE = 0.05  # px, of a ring's centre
_MISFIT = 16.0  # square of normalised residuals, per degree of freedom, from which targets are not those of the rig
_STEADY = 0.3  # s over which a turn is taken while a gesture lasts
_SLOW = 0.1  # rad/s: slower turns have no direction
_SQUARE = 20.0  # degrees that two gestures may be off a right angle
_GUESS = np.deg2rad(3.0)  # no one rolls a ball straighter than this, nor knows better what straight is


@dataclass(frozen=True, slots=True)
class Parts:
    """Errors of the axes, rad, and of the logarithm of the distance, by what they come from."""

    own: Array  # (4, 4) covariance, of what neither lens nor direction has a part in
    by_direction: Array  # (4, 3) Jacobian by the direction to the ball's centre
    by_lens: Array  # (4, 9) per standard deviation along `lens_root`
    with_targets: Array  # (3n, 4) covariance with the targets' coordinates, m


@dataclass(frozen=True, slots=True)
class Axes:
    """The axes of `obj` in the camera, and what came with them."""

    rotation: Array  # (3, 3) R_obj_cam
    covariance: Array  # (3, 3) rad², obj; of targets with the direction held, until `with_rolled`
    distance: float | None = None  # m, to the ball's centre, where targets tell
    distance_sigma: float = 0.0  # m
    targets_cam: Array | None = None  # (n, 3) m in cam, where targets were measured and not known
    targets_cam_covariance: Array | None = None  # (3n + 3, 3n + 3) m², rad²: of those and of the rotation
    targets_cam_by_lens: Array | None = None  # (3n + 3, 9) the lens' part in that, as Parts.by_lens
    misfit: float = 0.0  # of the targets, px
    codes: tuple[str, ...] = field(default=())
    parts: Parts | None = None  # None: nothing that the place of the ball hangs on


def axes_from_targets(sightings: Sequence[Sighting], rig: Rig, rolling: Rolling) -> Axes:
    """From targets whose coordinates about the ball's centre are known: the turn, and the distance of the centre.

    The direction to the centre is held as rolling has it: the covariance is that of targets, their sightings and the
    lens, until `with_rolled` adds the direction's. Of the rig its targets and its camera are taken, no more: the camera
    must be the one that was rolled with.
    CalibrationError where fewer than three are seen, or where they do not fit.
    """
    known = {code: k for k, code in enumerate(rig.targets.codes)}
    x, used = _fitted(sightings, rig, rolling, known)
    J = jacobian(lambda y: _target_residuals(y, used, rig, rolling, known), x)
    Q = np.linalg.inv(J.T @ J)
    by_targets = jacobian(
        lambda p: _target_residuals(x, used, _with_places(rig, p), rolling, known), rig.targets.position.ravel()
    )
    by_direction = jacobian(
        lambda c: _target_residuals(x, used, rig, replace(rolling, direction=c), known), rolling.direction
    )
    by_lens = changes_by_lens(lambda c: _target_residuals(x, used, replace(rig, camera=c), rolling, known), rig.camera)
    r = _target_residuals(x, used, rig, rolling, known)
    shared = by_targets @ rig.targets.covariance @ by_targets.T
    weight = np.linalg.inv(np.eye(len(r)) + shared + by_lens @ by_lens.T)
    cost = float(r @ weight @ r) / (2 * len(used) - 4)
    sigma = float(np.mean([np.sqrt(np.trace(s.covariance) / 2.0) for s in used]))
    misfit = float(np.sqrt(np.mean(r**2))) * sigma
    if cost > _MISFIT and misfit > 1.0:
        raise CalibrationError(
            f"the targets {', '.join(s.code for s in used)} lie {misfit:.1f} px off where the rig and the ball that "
            "turns put them: they are those of another device, or were moved; calibrate it, or leave them out"
        )
    turn = np.eye(4)
    turn[:3, :3] = left_jacobian(x[:3])
    K = -turn @ Q @ J.T  # of the least squares: what the residuals are off moves the result by
    own = K @ (np.eye(len(r)) + shared) @ K.T * max(cost, 1.0)
    parts = Parts(own, K @ by_direction, K @ by_lens, rig.targets.covariance @ (K @ by_targets).T)
    C = own + parts.by_lens @ parts.by_lens.T
    D = float(np.exp(x[3]))
    return Axes(
        exp(x[:3]),
        C[:3, :3],
        D,
        D * float(np.sqrt(C[3, 3])),
        misfit=misfit,
        codes=tuple(s.code for s in used),
        parts=parts,
    )


def _fitted(
    sightings: Sequence[Sighting], rig: Rig, rolling: Rolling, known: dict[str, int]
) -> tuple[Array, tuple[Sighting, ...]]:
    """Rotation vector (R_obj_cam) and log distance, (4,), that fit the most targets best, and those targets."""
    seen = {c: [s for s in sightings if s.code == c] for c in known}
    seen = {c: s for c, s in seen.items() if s}
    if len(seen) < 3:
        raise CalibrationError(
            f"{len(seen)} of {len(known)} targets are seen ({', '.join(seen) or 'none'}), the axes need 3: light and "
            "uncover them, or roll two gestures (--forward, --right)"
        )
    best: tuple[float, Array, tuple[Sighting, ...]] | None = None
    for combination in product(*([*s, None] if len(s) > 1 else s for s in seen.values())):
        used = tuple(s for s in combination if s is not None)
        if len(used) < 3:
            continue
        for x0 in _starts(used, rig, rolling, known):
            found = least_squares(_target_residuals, x0, args=(used, rig, rolling, known), x_scale="jac")
            cost = 2.0 * found.cost / (2 * len(used) - 4)
            if best is None or (-len(used), cost) < (-len(best[2]), best[0]):
                best = cost, found.x, used
    if best is None:
        raise CalibrationError(
            f"no camera position fits the targets {', '.join(seen)} and the ball that turns: their positions are those "
            "of another device, or count from another place than the ball's centre"
        )
    return best[1:]


def _pose_at(x: Array, rolling: Rolling) -> Pose:
    """Of a rotation vector (R_obj_cam) and the logarithm of the distance."""
    R = exp(x[:3])
    return Pose(R, -np.exp(x[3]) * (R @ rolling.direction))


def _target_residuals(x: Array, used: Sequence[Sighting], rig: Rig, rolling: Rolling, known: dict[str, int]) -> Array:
    try:
        predicted = predict_targets(_pose_at(x, rolling), rig)
    except np.linalg.LinAlgError:
        return np.full(2 * len(used), 1e6)
    way = [np.linalg.solve(np.linalg.cholesky(s.covariance), s.centre - predicted[known[s.code]]) for s in used]
    return np.nan_to_num(np.concatenate(way), nan=1e6, posinf=1e6, neginf=-1e6)


def _starts(used: Sequence[Sighting], rig: Rig, rolling: Rolling, known: dict[str, int]) -> list[Array]:
    """Rotation vector and log distance of the poses that the targets alone allow, the ball's centre about right."""
    X = rig.targets.position[[known[s.code] for s in used]]
    xy, _ = unproject(np.array([s.centre for s in used]), rig.camera)
    if not np.all(np.isfinite(xy)):
        return []
    methods = [cv2.SOLVEPNP_P3P] if len(X) == 3 else [cv2.SOLVEPNP_SQPNP, cv2.SOLVEPNP_IPPE]
    found: list[Array] = []
    for method in methods:
        try:
            if method == cv2.SOLVEPNP_P3P:
                _, rvecs, tvecs = cv2.solveP3P(X, xy[:, None], np.eye(3), None, flags=method)
            else:
                _, rvecs, tvecs, _ = cv2.solvePnPGeneric(X, xy[:, None], np.eye(3), None, flags=method)
        except cv2.error:  # IPPE takes planes alone
            continue
        for rvec, tvec in zip(rvecs, tvecs, strict=True):
            centre = np.asarray(tvec, dtype=float).ravel()  # of obj, in cam
            D = float(np.linalg.norm(centre))
            R = exp(np.asarray(rvec, dtype=float).ravel()).T
            facing = np.all((X - (-R @ centre))[:, 2] < 0.0)
            if D > 0.0 and facing and centre @ rolling.direction > 0.9 * D:
                found.append(np.concatenate([log(R), [np.log(D)]]))
    return found


def _with_places(rig: Rig, places: Array) -> Rig:
    return replace(rig, targets=replace(rig.targets, position=places.reshape(-1, 3)))


def jacobian(f: Callable[[Array], Array], x: Array) -> Array:
    """By central differences, (n, u)."""
    columns = []
    for k in range(len(x)):
        h = np.zeros(len(x))
        h[k] = 1e-6
        columns.append((f(x + h) - f(x - h)) / 2e-6)
    return np.asarray(np.stack(columns, axis=1), dtype=float)


def changes_by_lens(f: Callable[[InteriorOrientation], Array], camera: InteriorOrientation) -> Array:
    """Change of f per standard deviation along each column of `lens_root`, (n, 9)."""
    L, h = lens_root(camera), 1e-2

    def off(step: Array) -> InteriorOrientation:
        return with_interior(camera, interior_vector(camera) + step)

    columns = [(f(off(h * u)) - f(off(-h * u))) / (2.0 * h) if u.any() else 0.0 * f(camera) for u in L.T]
    return np.asarray(np.stack(columns, axis=1), dtype=float)


def axes_from_gestures(rolling: Rolling, forward: tuple[float, float], right: tuple[float, float]) -> Axes:
    """From the ball rolled forward (its top away from the camera, w_obj = -X) and to the right (its top to +X, -Z).

    Each a span of time in s, by the stamps. What the two are off a right angle is shared; that, the scatter within
    each, and what no one does better are the covariance. CalibrationError where the ball hardly turns, or turns about
    one axis in both.
    """
    axis, spread = np.empty((2, 3)), np.empty(2)
    for k, (name, span) in enumerate((("forward", forward), ("right", right))):
        axis[k], spread[k] = _turn(rolling, span, name)
    x, z = -axis[0], -axis[1]
    off = np.rad2deg(np.arcsin(np.clip(x @ z, -1.0, 1.0)))
    if abs(off) > _SQUARE:
        raise CalibrationError(
            f"`forward` and `right` are {90.0 - abs(off):.0f}° apart and not 90°: roll the ball straight away from "
            "you, then straight to the right, and look up the times again"
        )
    sigma = np.maximum(np.hypot(spread, 0.5 * np.deg2rad(abs(off))), _GUESS)
    R = align(np.stack([x, z]), np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), 1.0 / sigma**2)
    # each axis tells of the turns across itself: about X nothing from X
    N = np.diag([0.0, 1.0, 1.0]) / sigma[0] ** 2 + np.diag([1.0, 1.0, 0.0]) / sigma[1] ** 2
    return Axes(R, np.linalg.inv(N))


def _turn(rolling: Rolling, span: tuple[float, float], name: str) -> tuple[Array, float]:
    """Mean axis in cam that the ball turns about, (3,), and the scatter of its direction per axis, rad."""
    inside = np.flatnonzero((rolling.stamp >= span[0]) & (rolling.stamp <= span[1]))
    rates, weights = [], []
    for i in inside:
        j = int(np.searchsorted(rolling.stamp, rolling.stamp[i] + _STEADY))
        if j >= len(rolling.stamp) or rolling.stamp[j] > span[1] or rolling.stamp[j] > rolling.stamp[i] + 2 * _STEADY:
            continue
        turn = log(rolling.attitude[j] @ rolling.attitude[i].T)
        angle = float(np.linalg.norm(turn))
        if angle > _SLOW * _STEADY:
            rates.append(turn / angle)
            weights.append(angle)
    if len(rates) < 5:
        raise CalibrationError(
            f"the ball is not seen to roll {name} from {span[0]:g} to {span[1]:g} s: look up the times, "
            "or roll it again"
        )
    u, w = np.array(rates), np.array(weights)
    mean = w @ u
    length = float(np.linalg.norm(mean)) / w.sum()
    if length < 0.8:
        raise CalibrationError(
            f"from {span[0]:g} to {span[1]:g} s the ball rolls to and fro, not {name} alone: give a span of one roll"
        )
    mean = mean / np.linalg.norm(mean)
    across = u - (u @ mean)[:, None] * mean
    return mean, float(np.sqrt(w @ np.sum(across**2, axis=1) / (2.0 * w.sum())))
