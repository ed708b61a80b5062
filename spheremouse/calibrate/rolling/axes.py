"""The axes of `obj` in the camera, and the scale, which rolling leaves open.

Ring targets give them, at known places or of known size, or two gestures: the ball rolled forward and to the right.
Covariances are of the rotation R_obj_cam with the error exp(e) R, e in `obj`, as in `Pose`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from spheremouse.ball.device import Device
from spheremouse.ball.pose import Sighting, closed_form_poses, predict_targets
from spheremouse.ball.rig import NO_TARGETS, Rig, Targets
from spheremouse.calibrate.device.start import axes_of
from spheremouse.calibrate.outline.fit import R_OBJ_CAM
from spheremouse.calibrate.rolling.adjust import lens_root
from spheremouse.calibrate.rolling.problem import Rolling
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import (
    InteriorOrientation,
    Pose,
    ellipse_to_pixel,
    interior_vector,
    project_circle,
    unproject,
    with_interior,
)
from spheremouse.geometry.rotation import Array, align, exp, left_jacobian, log

_MAX_CHI2_PER_DOF = 16.0  # larger for targets of another rig
_TURN_SECONDS = 0.3  # over which a rotation is taken during a gesture
_MIN_RATE = 0.1  # rad/s; slower rotations have no direction
_MAX_OFF_SQUARE = 20.0  # degrees of two gestures from a right angle
_GESTURE_SIGMA = np.deg2rad(3.0)  # accuracy of a person's straight roll of the ball
_SIZE_SIGMA = 0.005, 0.002  # relative, of printed rings: common to all, and of each alone
_RADIUS_SIGMA = 0.05, 0.02  # px, of a ring's image: common to all, as colours run, and of each alone
_CENTRE_SIGMA = 0.05  # px


@dataclass(frozen=True, slots=True)
class Axes:
    """The axes of `obj` in the camera, and the distance and n targets that came with them, with their errors by source.

    The errors, (4 + 3n,), are of the rotation (rad, obj), the logarithm of the distance, and the targets (m).
    """

    rotation: Array  # (3, 3) R_obj_cam
    own: Array  # (4 + 3n, 4 + 3n) covariance without the parts of lens and direction
    by_direction: Array  # (4 + 3n, 3) Jacobian by the direction to the ball's centre
    by_lens: Array  # (4 + 3n, 9) per standard deviation along `lens_root`
    distance: float | None = None  # m, to the ball's centre, by targets
    targets: Targets = NO_TARGETS  # in obj if they give the distance, else in cam; their errors are in `own`


def axes_from_targets(sightings: Sequence[Sighting], rig: Rig, rolling: Rolling) -> Axes:
    """Find rotation and distance by targets with known coordinates about the ball's centre.

    The direction to the centre is that of `rolling`. Only targets and camera of the rig are used, and the camera must
    be that of the recording. Raises CalibrationError if fewer than three targets are seen, or if they do not fit.
    """
    known = {code: k for k, code in enumerate(rig.targets.codes)}
    x, used = _fit(sightings, rig, rolling, known)

    def residuals(x: Array = x, rig: Rig = rig, rolling: Rolling = rolling) -> Array:
        return _target_residuals(x, used, rig, rolling, known)

    J = jacobian(residuals, x)
    Q = np.linalg.inv(J.T @ J)
    targets = rig.targets
    by_targets = jacobian(
        lambda p: residuals(rig=replace(rig, targets=replace(targets, position=p.reshape(-1, 3)))),
        targets.position.ravel(),
    )
    by_direction = jacobian(lambda c: residuals(rolling=replace(rolling, direction=c)), rolling.direction)
    by_lens = changes_by_lens(lambda c: residuals(rig=replace(rig, camera=c)), rig.camera)
    r = residuals()
    shared = by_targets @ targets.covariance @ by_targets.T
    weight = np.linalg.inv(np.eye(len(r)) + shared + by_lens @ by_lens.T)
    cost = float(r @ weight @ r) / (2 * len(used) - 4)
    sigma = float(np.mean([np.sqrt(np.trace(s.covariance) / 2.0) for s in used]))
    misfit = float(np.sqrt(np.mean(r**2))) * sigma
    if cost > _MAX_CHI2_PER_DOF and misfit > 1.0:
        raise CalibrationError(
            f"the targets {', '.join(s.code for s in used)} lie {misfit:.1f} px off where the rig and the ball that "
            "turns put them: they are those of another device, or were moved; calibrate it, or leave them out"
        )
    T = np.eye(4)
    T[:3, :3] = left_jacobian(x[:3])
    K = -T @ Q @ J.T  # of the result by the residuals
    own = K @ (np.eye(len(r)) + shared) @ K.T * max(cost, 1.0)
    with_targets = K @ by_targets @ targets.covariance
    own = np.block([[own, with_targets], [with_targets.T, targets.covariance]])
    K = np.pad(K, ((0, targets.position.size), (0, 0)))  # direction and lens change no target
    return Axes(exp(x[:3]), own, K @ by_direction, K @ by_lens, float(np.exp(x[3])), targets)


def _fit(
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


def _target_residuals(x: Array, used: Sequence[Sighting], rig: Rig, rolling: Rolling, known: dict[str, int]) -> Array:
    R = exp(x[:3])
    try:
        predicted = predict_targets(Pose(R, -np.exp(x[3]) * (R @ rolling.direction)), rig)
    except np.linalg.LinAlgError:
        return np.full(2 * len(used), 1e6)
    way = [np.linalg.solve(np.linalg.cholesky(s.covariance), s.centre - predicted[known[s.code]]) for s in used]
    return np.nan_to_num(np.concatenate(way), nan=1e6, posinf=1e6, neginf=-1e6)


def _starts(used: Sequence[Sighting], rig: Rig, rolling: Rolling, known: dict[str, int]) -> list[Array]:
    """Rotation vectors and log distances of poses by the targets alone, with the ball's centre about right."""
    X = rig.targets.position[[known[s.code] for s in used]]
    xy, _ = unproject(np.array([s.centre for s in used]), rig.camera)
    if not np.all(np.isfinite(xy)):
        return []
    found: list[Array] = []
    for pose in closed_form_poses(X, xy):
        centre = pose.to_cam(np.zeros(3))
        D = float(np.linalg.norm(centre))
        facing = np.all((X - pose.position)[:, 2] < 0.0)
        if D > 0.0 and facing and centre @ rolling.direction > 0.9 * D:
            found.append(np.concatenate([log(pose.rotation), [np.log(D)]]))
    return found


def jacobian(f: Callable[[Array], Array], x: Array) -> Array:
    """Return the Jacobian by central differences, (n, u)."""
    columns = []
    for k in range(len(x)):
        h = np.zeros(len(x))
        h[k] = 1e-6
        columns.append((f(x + h) - f(x - h)) / 2e-6)
    return np.asarray(np.stack(columns, axis=1), dtype=float)


def changes_by_lens(f: Callable[[InteriorOrientation], Array], camera: InteriorOrientation) -> Array:
    """Return the change of f per standard deviation along each column of `lens_root`, (n, 9)."""
    L, h = lens_root(camera), 1e-2

    def off(step: Array) -> InteriorOrientation:
        return with_interior(camera, interior_vector(camera) + step)

    columns = [(f(off(h * u)) - f(off(-h * u))) / (2.0 * h) if u.any() else 0.0 * f(camera) for u in L.T]
    return np.asarray(np.stack(columns, axis=1), dtype=float)


def axes_from_gestures(rolling: Rolling, forward: tuple[float, float], right: tuple[float, float]) -> Axes:
    """Find the axes by the ball rolled forward (top away from the camera, w_obj = -X) and to the right (top to +X, -Z).

    Each is a span of stamps, s. The two share their deviation from a right angle. Its half, the scatter within each,
    and a person's accuracy give the covariance. Raises CalibrationError if the ball hardly turns, or turns about one
    axis in both.
    """
    axis, spread = np.empty((2, 3)), np.empty(2)
    for k, (name, span) in enumerate((("forward", forward), ("right", right))):
        axis[k], spread[k] = _gesture_axis(rolling, span, name)
    x, z = -axis[0], -axis[1]
    tilt = np.rad2deg(np.arcsin(np.clip(x @ z, -1.0, 1.0)))
    if abs(tilt) > _MAX_OFF_SQUARE:
        raise CalibrationError(
            f"`forward` and `right` are {90.0 - abs(tilt):.0f}° apart and not 90°: roll the ball straight away from "
            "the camera, then straight to the right, and look up the times again"
        )
    sigma = np.maximum(np.hypot(spread, 0.5 * np.deg2rad(abs(tilt))), _GESTURE_SIGMA)
    R = align(np.stack([x, z]), np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), 1.0 / sigma**2)
    # an axis has no information on rotations about itself
    N = np.diag([0.0, 1.0, 1.0]) / sigma[0] ** 2 + np.diag([1.0, 1.0, 0.0]) / sigma[1] ** 2
    return Axes(R, np.pad(np.linalg.inv(N), (0, 1)), np.zeros((4, 3)), np.zeros((4, 9)))


def _gesture_axis(rolling: Rolling, span: tuple[float, float], name: str) -> tuple[Array, float]:
    """Mean axis of rotation in cam, (3,), and the scatter of its direction, rad."""
    inside = np.flatnonzero((rolling.stamp >= span[0]) & (rolling.stamp <= span[1]))
    rates, weights = [], []
    for i in inside:
        j = int(np.searchsorted(rolling.stamp, rolling.stamp[i] + _TURN_SECONDS))
        if (
            j >= len(rolling.stamp)
            or rolling.stamp[j] > span[1]
            or rolling.stamp[j] > rolling.stamp[i] + 2 * _TURN_SECONDS
        ):
            continue
        turn = log(rolling.attitude[j] @ rolling.attitude[i].T)
        angle = float(np.linalg.norm(turn))
        if angle > _MIN_RATE * _TURN_SECONDS:
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


def axes_from_rings(sightings: Sequence[tuple[str, Array, float]], device: Device, camera: InteriorOrientation) -> Axes:
    """Find the axes of `obj` in the camera, R_obj_cam, and the places of ring targets in `cam` from one view.

    The size of a target's image gives its distance, since the device file has the size of its outer ring. `sightings`
    are code, centre (2,) px and radius px of that ring; for an ellipse it is the geometric mean of the half-axes. Tape
    distances between targets improve the places. A distance that contradicts them enlarges the covariance, but is not
    rejected. Raises CalibrationError if one of the three targets that define the axes is not seen.
    """
    ids, uv, size = _visible_targets(sightings, device)
    n, at = len(ids), {i: k for k, i in enumerate(ids)}
    common_sigma = np.stack([np.full(n, _SIZE_SIGMA[0]), _RADIUS_SIGMA[0] / size], axis=1)
    size_sigma = np.hypot(_SIZE_SIGMA[1], _RADIUS_SIGMA[1] / size)

    def moved(x: Array, lens: InteriorOrientation = camera) -> Array:
        """Places, (n, 3), for normalised errors x: two of all sizes, one of each size, two of each centre."""
        sizes = size * np.exp(-(common_sigma @ x[:2]) - size_sigma * x[2 : 2 + n])
        return _by_size(uv + _CENTRE_SIGMA * x[2 + n :].reshape(n, 2), sizes, at, device, lens)

    taped = [d for d in device.distances if d.start in at and d.end in at]

    def residuals(x: Array, lens: InteriorOrientation = camera) -> Array:
        p = moved(x, lens)
        tape = [(np.linalg.norm(p[at[d.start]] - p[at[d.end]]) - d.metres) / d.sigma for d in taped]
        return np.asarray(np.concatenate([x, tape]), dtype=float)

    x = np.asarray(least_squares(residuals, np.zeros(2 + 3 * n), x_scale="jac").x)
    places = moved(x)
    R = axes_of(places, at, device, np.zeros(3))

    def errors(x: Array, lens: InteriorOrientation = camera) -> Array:
        """Differences from the axes and the places found, as `Axes` orders them."""
        points = moved(x, lens)
        turn = log(axes_of(points, at, device, np.zeros(3)) @ R.T)
        return np.concatenate([turn, [0.0], (points - places).ravel()])

    J, by_x, r = jacobian(residuals, x), jacobian(errors, x), residuals(x)
    Q = np.asarray(np.linalg.inv(J.T @ J), dtype=float)
    # a distance corrects the effect of the lens
    by_lens = changes_by_lens(lambda c: errors(x, c) - by_x @ Q @ J.T @ residuals(x, c), camera)
    factor = max(float(r @ r) / len(taped), 1.0) if taped else 1.0  # each distance adds one to the redundancy
    own = by_x @ (factor * Q) @ by_x.T
    codes = tuple(code for i, code in zip(device.ids, device.codes, strict=True) if i in at)
    targets = Targets(tuple(ids), codes, places, own[4:, 4:], np.asarray(device.target_radii, dtype=float))
    return Axes(R, own, np.zeros((len(own), 3)), by_lens, targets=targets)


def _visible_targets(sightings: Sequence[tuple[str, Array, float]], device: Device) -> tuple[list[int], Array, Array]:
    """Ids of the targets seen, in the order of the device, their centres, (n, 2) px, and radii, (n,) px."""
    code_of = dict(zip(device.ids, device.codes, strict=True))
    seen = {code: (centre, radius) for code, centre, radius in sightings}
    a = device.axes
    missing = [f"{i} ({code_of[i]})" for i in (a.origin, a.up, a.plane) if code_of[i] not in seen]
    if missing:
        raise CalibrationError(
            f"the axes are defined by target {', '.join(missing)}, not seen by the camera: uncover and light it, "
            "name others under `axes` in the device file, or roll two gestures (--forward, --right)"
        )
    ids = [i for i in device.ids if code_of[i] in seen]
    return ids, np.array([seen[code_of[i]][0] for i in ids]), np.array([seen[code_of[i]][1] for i in ids])


def _by_size(uv: Array, size: Array, at: dict[int, int], device: Device, camera: InteriorOrientation) -> Array:
    """Places, (n, 3) m in cam, of targets seen at `uv`, (n, 2) px, as large as `size`, (n,) px, facing along Z."""
    outer = float(device.target_radii[2])
    xy, by_uv = unproject(uv, camera)
    depth = outer * np.sqrt(camera.fx * camera.fy) / size
    R = R_OBJ_CAM
    places = depth[:, None] * np.column_stack([xy, np.ones(len(xy))])
    for _ in range(50):  # foreshortening depends on the axes, and the axes on the places
        normal = np.broadcast_to(R[2], places.shape)
        centre, shape = ellipse_to_pixel(*project_circle(places, normal, outer), camera)
        seen = np.linalg.det(shape) ** 0.25
        xy = xy + np.einsum("nij,nj->ni", by_uv, uv - centre)
        depth = depth * seen / size
        places = depth[:, None] * np.column_stack([xy, np.ones(len(xy))])
        R = axes_of(places, at, device, np.zeros(3))
        if np.abs(seen / size - 1.0).max() < 1e-10:
            break
    return places
