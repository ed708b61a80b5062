"""The axes by ring targets of known size at unknown places."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from spheremouse.ball.device import Device, Distance
from spheremouse.calibrate.rolling.axes import Axes, Parts, changes_by_lens, jacobian
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, unproject
from spheremouse.geometry.conics import ellipse_to_pixel, project_circle
from spheremouse.geometry.rotation import Array, log

_SIZE_SIGMA = 0.005, 0.002  # relative, of printed rings: of all alike, and of each
_RADIUS_SIGMA = 0.05, 0.02  # px, of a ring's image: of all alike, as colours run, and of each
_CENTRE_SIGMA = 0.05  # px


def axes_from_rings(sightings: Sequence[tuple[str, Array, float]], device: Device, camera: InteriorOrientation) -> Axes:
    """Find the axes by targets of known size: the size of each image gives its distance.

    `sightings` are code, centre (2,) px and radius px of the outer ring of each. Tape distances improve them. The
    covariance includes that of the lens. Raises CalibrationError if one of the three targets of the axes is not seen.
    """
    ids, uv, size = _seen(sightings, device)
    n, at = len(ids), {i: k for k, i in enumerate(ids)}
    alike = np.stack([np.full(n, _SIZE_SIGMA[0]), _RADIUS_SIGMA[0] / size], axis=1)
    alone = np.hypot(_SIZE_SIGMA[1], _RADIUS_SIGMA[1] / size)

    def moved(x: Array, lens: InteriorOrientation = camera) -> Array:
        """Places, (n, 3), for normalised errors x: two of all sizes, one of each size, two of each centre."""
        sizes = size * np.exp(-(alike @ x[:2]) - alone * x[2 : 2 + n])
        return _by_size(uv + _CENTRE_SIGMA * x[2 + n :].reshape(n, 2), sizes, at, device, lens)

    taped = [d for d in device.distances if d.start in at and d.end in at]

    def residuals(x: Array) -> Array:
        p = moved(x)
        tape = [(np.linalg.norm(p[at[d.start]] - p[at[d.end]]) - d.metres) / d.sigma for d in taped]
        return np.asarray(np.concatenate([x, tape]), dtype=float)

    x = np.zeros(2 + 3 * n)
    if taped:
        x = np.asarray(least_squares(residuals, x, x_scale="jac").x)
    places = moved(x)
    R = _axes_of(places, at, device)

    def places_and_axes(y: Array, lens: InteriorOrientation = camera) -> Array:
        there = moved(y, lens)
        return np.concatenate([there.ravel(), log(_axes_of(there, at, device) @ R.T)])

    by_x, seen_through = jacobian(places_and_axes, x), changes_by_lens(lambda c: places_and_axes(x, c), camera)
    own, by_lens = _propagated(by_x, seen_through, residuals(x), places, taped, at)
    joint = own + by_lens @ by_lens.T
    four = np.eye(4)[:, :3]  # rings give no distance of the ball
    return Axes(
        R,
        joint[-3:, -3:],
        targets_cam=places,
        targets_cam_covariance=joint,
        targets_cam_by_lens=by_lens,
        codes=tuple(code for i, code in zip(device.ids, device.codes, strict=True) if i in at),
        parts=Parts(four @ own[-3:, -3:] @ four.T, np.zeros((4, 3)), four @ by_lens[-3:], np.zeros((3 * n, 4))),
    )


def _seen(sightings: Sequence[tuple[str, Array, float]], device: Device) -> tuple[list[int], Array, Array]:
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


def _propagated(
    by_x: Array, by_lens: Array, r: Array, places: Array, taped: Sequence[Distance], at: dict[int, int]
) -> tuple[Array, Array]:
    """Covariance of places and axes without the lens' part, (3n + 3, 3n + 3), and that part, (3n + 3, 9).

    `by_x` and `by_lens` are the Jacobians of places and axes by normalised errors and by the lens. The distances
    `taped` correct both; `r` are all residuals of the adjustment.
    """
    J, pull = np.eye(by_x.shape[1]), np.zeros((by_x.shape[1], 9))  # pull: of the lens, on the corrections by distances
    for d in taped:
        i, j = at[d.start], at[d.end]
        along = (places[i] - places[j]) / np.linalg.norm(places[i] - places[j]) / d.sigma
        row = along @ (by_x[3 * i : 3 * i + 3] - by_x[3 * j : 3 * j + 3])
        J = np.vstack([J, row])
        pull += np.outer(row, along @ (by_lens[3 * i : 3 * i + 3] - by_lens[3 * j : 3 * j + 3]))
    factor = max(float(r @ r) / len(taped), 1.0) if taped else 1.0
    Q = np.asarray(np.linalg.inv(J.T @ J), dtype=float)
    return by_x @ (factor * Q) @ by_x.T, by_lens - by_x @ Q @ pull


def _by_size(uv: Array, size: Array, at: dict[int, int], device: Device, camera: InteriorOrientation) -> Array:
    """Places, (n, 3) m in cam, of targets seen at `uv`, (n, 2) px, as large as `size`, (n,) px, facing along Z."""
    outer = float(device.target_radii[2])
    xy, by_uv = unproject(uv, camera)
    depth = outer * np.sqrt(camera.fx * camera.fy) / size
    R = np.diag([1.0, -1.0, -1.0])
    places = depth[:, None] * np.column_stack([xy, np.ones(len(xy))])
    for _ in range(50):  # foreshortening depends on the axes, and the axes on the places
        normal = np.broadcast_to(R[2], places.shape)
        centre, shape = ellipse_to_pixel(*project_circle(places, normal, outer), camera)
        seen = np.linalg.det(shape) ** 0.25
        xy = xy + np.einsum("nij,nj->ni", by_uv, uv - centre)
        depth = depth * seen / size
        places = depth[:, None] * np.column_stack([xy, np.ones(len(xy))])
        R = _axes_of(places, at, device)
        if np.abs(seen / size - 1.0).max() < 1e-10:
            break
    return places


def _axes_of(places: Array, at: dict[int, int], device: Device) -> Array:
    """R_obj_cam of the three targets that define the axes, (n, 3) in cam; Z towards the camera."""
    origin, up, plane = (places[at[i]] for i in (device.axes.origin, device.axes.up, device.axes.plane))
    y = up - origin
    y = y / np.linalg.norm(y)
    z = np.cross(y, plane - origin)
    if np.linalg.norm(z) < 1e-3 * np.linalg.norm(plane - origin):
        raise CalibrationError("the three targets of `axes` lie in a line: name another for `plane` in the device file")
    z = z / np.linalg.norm(z)
    z = -z if z @ origin > 0.0 else z
    return np.array([np.cross(y, z), y, z])
