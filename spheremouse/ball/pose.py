"""Resection: targets seen in a few frames -> the camera's pose in `obj` with its covariance.

The method is least squares on the reprojection error of the targets (Wittich 2017, sections 2.4.3 and 3.4). Closed-form
poses start it, so the user need not give a camera position. The targets' joint covariance, and theirs with the ball,
propagate to the pose. An error in the position of all targets relative to the ball shifts the camera by the same
amount, and no image reveals it.
"""

from dataclasses import dataclass
from itertools import product
from math import prod
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball import outline
from spheremouse.ball.detect.blur import blur_of
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.rings import MAX_COPIES, TargetDetections
from spheremouse.ball.rig import Rig
from spheremouse.errors import PoseError
from spheremouse.geometry.camera import Pose, project, project_rings, unproject
from spheremouse.geometry.matching import suppress
from spheremouse.geometry.rotation import Array, exp, hat
from spheremouse.settings import param

TARGET_SIGMA_PX = 0.05  # standard deviation of a centre in one view that no averaging removes: print, sampling, lens
_MIN_SEEN_SHARE = 0.3  # of the views; a target seen in fewer is left out
# combinations of one copy of each target: each needs its own resection, which takes milliseconds
_MAX_COMBINATIONS = 250
_CROWDED = (
    f"the picture has more shapes like targets than the search examines ({MAX_COPIES} of a kind): cover or remove "
    "colourful objects, or narrow the hues (rings.cyan, rings.magenta, rings.yellow)"
)
_BLURRED = "the picture is blurred, by {:.1f} px: focus the lens (camera.focus), and wipe it"
_MAX_BLUR = 1.5  # px, standard deviation: rings of 4 px are lost in 2
_STRANGE = "{} seen, which the rig does not have: correct its codes, or give the rig of this device"


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """Parameters of the initial camera pose."""

    frames: int = param(
        10,
        "frames",
        "views averaged at the start. Noise of 20 grey values moves a centre by 0.02 px in one view; systematic errors "
        "of 0.05 px stay in all",
        ge=1,
        le=100,
    )


@dataclass(frozen=True, slots=True)
class Sighting:
    """One target of the rig, or a look-alike with its code, over several views."""

    code: str
    centre: Array  # (2,) px, mean over the views
    covariance: Array  # (2, 2) px², of that mean: the floor of one view plus the scatter's share
    views: int


@dataclass(frozen=True, slots=True)
class Resection:
    """A camera pose, the targets used for it, and their residuals."""

    pose: Pose
    codes: tuple[str, ...]
    centre: Array  # (n, 2) px, measured centres of the targets used
    residual: Array  # (n, 2) px, measured minus predicted
    variance_factor: float  # a posteriori, 1 without redundancy


def find_pose(views: list[TargetDetections], rig: Rig, image: Image) -> Resection:
    """Return the camera pose from the targets in some views of a still scene; `image` is any of them.

    Raises PoseError as `resect` does. The error adds three causes: targets that the rig does not have, too many shapes
    like targets, and blur.
    """
    sightings = gather(views)
    try:
        return resect(sightings, rig, image)
    except PoseError as e:
        strangers = sorted({s.code for s in sightings} - set(rig.targets.codes))
        more = [_STRANGE.format(", ".join(strangers))] if strangers else []
        more += [_CROWDED] if any(view.crowded for view in views) else []
        more += [_BLURRED.format(blur)] if (blur := blur_of(image)) > _MAX_BLUR else []
        raise PoseError("; ".join((str(e), *more))) from None


def gather(views: list[TargetDetections]) -> list[Sighting]:
    """Return the targets that keep their place over the views, without objects that appear rarely or move.

    Views of a still scene share their systematic errors. Only the noise averages out, and the covariance of the mean
    never falls below TARGET_SIGMA_PX squared.
    """
    groups: dict[str, list[list[Array]]] = {}
    for view in views:
        for code, centre, radius in zip(view.codes, view.centre, view.radius, strict=True):
            places = groups.setdefault(code, [])
            near = next((g for g in places if np.linalg.norm(g[0] - centre) < radius), None)
            (places.append([]) or places[-1] if near is None else near).append(centre)
    sightings = []
    for code, places in groups.items():
        for group in places:
            if len(group) < max(_MIN_SEEN_SHARE * len(views), 1):
                continue
            c = np.array(group)
            middle = np.median(c, axis=0)
            spread = 1.4826 * np.median(np.abs(c - middle), axis=0)
            c = c[np.all(np.abs(c - middle) <= 4 * spread + 0.2, axis=1)]  # a hand that brushed the target
            noise = np.diag(np.var(c, axis=0)) / len(c)
            sightings.append(Sighting(code, c.mean(axis=0), TARGET_SIGMA_PX**2 * np.eye(2) + noise, len(c)))
    return sightings


def resect(sightings: list[Sighting], rig: Rig, image: Image) -> Resection:
    """Return the camera pose from at least three targets of the rig; `image`, any view, shows the ball's outline.

    With three targets up to four poses fit (Gao et al. 2003), with four in a plane sometimes two. The ball's outline
    decides between them, and must confirm the pose of three targets in any case. Residuals separate copies of a
    target in the room from the real one.
    Raises PoseError if targets are missing, no pose fits, or two poses fit equally.
    """
    known = {code: i for i, code in enumerate(rig.targets.codes)}
    seen = {code: [s for s in sightings if s.code == code] for code in known}
    seen = {code: s for code, s in seen.items() if s}
    if len(seen) < 3:
        missing = [c for c in known if c not in seen]
        raise PoseError(
            f"{len(seen)} of {len(known)} targets found ({', '.join(seen) or 'none'}), at least 3 are needed; missing: "
            f"{', '.join(missing)}: light them, uncover them, or widen the colour bounds (rings.*)"
        )
    if _in_a_line(rig.targets.position[[known[c] for c in seen]]):
        raise PoseError(
            f"the targets found ({', '.join(seen)}) lie in a line in the rig, which leaves the turn about it open: "
            "uncover one beside that line"
        )
    _refuse_many(seen, prod(len(options) for options in seen.values()))
    fits: list[Resection] = []
    for combination in product(*seen.values()):
        fits += _candidates(list(combination), np.array([known[s.code] for s in combination]), rig)
    if not _is_complete(fits):
        chosen = [[*options, None] if len(options) > 1 else options for options in seen.values()]
        _refuse_many(seen, prod(len(options) for options in chosen))
        for combination in product(*chosen):
            used = [s for s in combination if s is not None]
            if 3 <= len(used) < len(combination):
                fits += _candidates(used, np.array([known[s.code] for s in used]), rig)
    fits = _distinct(fits)
    if not fits:
        raise PoseError(
            f"no camera position fits the targets {', '.join(seen)}: their positions in the rig, or the camera's "
            "calibration, belong to another device"
        )
    if len(fits) == 1 and len(fits[0].codes) > 3:
        return fits[0]
    return _by_outline(fits, rig, image)


def describe(resection: Resection, rig: Rig) -> str:
    """Pose, standard deviations and correlations as in Wittich 2017, table 12; lengths in mm, or radii of the ball."""
    pose = resection.pose
    scale, unit, digits = (1.0 / rig.ball.radius, "R", 4) if rig.scale_free else (1e3, "mm", 2)
    sigma = np.sqrt(np.diag(pose.covariance))
    correlation = pose.covariance / np.outer(sigma, sigma)
    names = ["X", "Y", "Z", "rot X", "rot Y", "rot Z"]
    lines = [f"targets {', '.join(resection.codes)}; residual RMS {np.sqrt(np.mean(resection.residual**2)):.3f} px"]
    lines.append("          " + "".join(f"{n:>9}" for n in names))
    lines += [f"{names[i]:<10}" + "".join(f"{correlation[i, j]:9.3f}" for j in range(i)) for i in range(1, 6)]
    lines.append("sigma     " + "".join(f"{scale * s:{8 - len(unit)}.{digits}f} {unit}" for s in sigma[:3]))
    lines[-1] += "".join(f"{np.rad2deg(s):7.3f} °" for s in sigma[3:])
    place = scale * pose.position
    lines.append("position  " + "".join(f"{x:{8 - len(unit)}.{digits - 2}f} {unit}" for x in place))
    return "\n".join(lines)


def predict_targets(pose: Pose, rig: Rig) -> Array:
    """Return the predicted mean centroids of all targets, (n, 2) px, with eccentricity."""
    return _predict(pose, rig, np.arange(len(rig.targets.codes)))[0]


def _predict(pose: Pose, rig: Rig, which: NDArray[np.intp]) -> tuple[Array, Array]:
    """Predicted mean centroids, (n, 2) px, and d_centre_d_point_cam, (n, 2, 3), of the targets `which`."""
    points = pose.to_cam(rig.targets.position[which])
    normal = np.broadcast_to(pose.rotation.T @ rig.targets.normal, points.shape)
    _, J = project(points, rig.camera)
    return project_rings(points, normal, rig.targets.radii, rig.camera), J


def _in_a_line(points: Array) -> bool:
    """Return whether points (n, 3) span no plane, or one narrower than a thousandth of its length."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] <= 1e-3 * spread[0])


def _candidates(used: list[Sighting], which: NDArray[np.intp], rig: Rig) -> list[Resection]:
    """Return all poses that satisfy one choice of sightings: closed-form starts, each adjusted."""
    points = rig.targets.position[which]
    xy, _ = unproject(np.array([s.centre for s in used]), rig.camera)
    if not np.all(np.isfinite(xy)) or _in_a_line(points):
        return []
    found = []
    for start in closed_form_poses(points, xy):
        adjusted = _adjust(start, used, which, rig)
        if adjusted is not None and _possible(adjusted.pose, rig, which):
            found.append(adjusted)
    return found


def closed_form_poses(points: Array, xy: Array) -> list[Pose]:
    """Return camera poses in the frame of the points (n, 3) m, n >= 3, from their images, (n, 2) on the plane z = 1.

    Three points give up to four poses (P3P), four or more in a plane two (IPPE), others one or more (SQPnP).
    """
    frame, origin = np.eye(3), np.zeros(3)
    if len(points) == 3:
        _, rvecs, tvecs = cv2.solveP3P(points, xy[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_P3P)
    else:
        local, method = points, cv2.SOLVEPNP_SQPNP
        middle = points.mean(axis=0)
        _, spread, axes = np.linalg.svd(points - middle)
        if spread[2] < 1e-3 * spread[1]:  # a plane; off z = 0 OpenCV 5 mirrors the pose for every other order of points
            frame, origin, method = axes * np.sign(np.linalg.det(axes)), middle, cv2.SOLVEPNP_IPPE
            local = (points - origin) @ frame.T * (1.0, 1.0, 0.0)
        _, rvecs, tvecs, _ = cv2.solvePnPGeneric(local, xy[:, None], np.eye(3), None, flags=method)
    starts = []
    for rvec, tvec in zip(rvecs, tvecs, strict=True):
        R = (exp(np.asarray(rvec, dtype=float).ravel()) @ frame).T
        starts.append(Pose(R, origin - R @ np.asarray(tvec, dtype=float).ravel()))
    return starts


class PoseFit(NamedTuple):
    """A pose adjusted to k targets, from the last iteration."""

    pose: Pose
    residual: Array  # (2k,) px, measured minus predicted
    A: Array  # (2k, 6) d_centre_d_pose; position, then rotation, as in `Pose`
    J: Array  # (2k, 3k) d_centre_d_targets, px/m
    W: Array  # (2k, 2k) weights
    covariance: Array  # (6, 6)


def adjust_pose(
    start: Pose, observed: Array, which: NDArray[np.intp], rig: Rig, noise: Array, targets: Array
) -> PoseFit | None:
    """Return the pose that minimises the reprojection error of the targets `which`, by Gauss-Newton; None without one.

    `observed` (k, 2) px. The weights follow from the covariances `noise` (2k, 2k) px² of the image and `targets`
    (3k, 3k) m² of the targets.
    """
    pose, points, fit = start, rig.targets.position[which], None
    for _ in range(30):
        try:
            predicted, dc_dcam = _predict(pose, rig, which)
            if not np.all(np.isfinite(predicted)):
                return None
            residual = (observed - predicted).ravel()
            dc_dobj = dc_dcam @ pose.rotation.T
            # a point in cam is R^T (X - P): dP moves it by -R^T, theta turns X - P by -theta
            A = np.concatenate([-dc_dobj, dc_dobj @ hat(points - pose.position)], axis=2).reshape(-1, 6)
            J = _block_diagonal(dc_dobj)
            W = np.asarray(np.linalg.inv(noise + J @ targets @ J.T), dtype=float)
            N = A.T @ W @ A
            step = np.asarray(np.linalg.solve(N, A.T @ W @ residual), dtype=float)
            pose = Pose(exp(step[3:]) @ pose.rotation, pose.position + step[:3])
            fit = PoseFit(pose, residual, A, J, W, np.asarray(np.linalg.inv(N), dtype=float))
        except np.linalg.LinAlgError:  # so far off that a target is seen edge-on, or too few targets
            return None
        if np.linalg.norm(step) < 1e-10:
            break
    return fit


def _block_diagonal(blocks: Array) -> Array:
    """Return the matrix, (n a, n b), with blocks (n, a, b) on its diagonal."""
    n, a, b = blocks.shape
    return np.einsum("nij,nm->nimj", blocks, np.eye(n)).reshape(n * a, n * b)


def _adjust(start: Pose, used: list[Sighting], which: NDArray[np.intp], rig: Rig) -> Resection | None:
    """Return the pose adjusted to k sightings from `start`; None if that fails. It rejects no outliers.

    `which` (k,) are their indices in the rig's targets. The weights include the targets' joint covariance. If the
    residuals are too large, the covariance of the image alone grows. With three targets nothing checks it.
    """
    observed = np.array([s.centre for s in used])
    image = _block_diagonal(np.array([s.covariance for s in used]))
    rows = (3 * which[:, None] + np.arange(3)).ravel()
    targets = rig.targets.covariance[np.ix_(rows, rows)]
    fit = adjust_pose(start, observed, which, rig, image, targets)
    if fit is None:
        return None
    r, J, covariance = fit.residual, fit.J, fit.covariance
    freedom = 2 * len(used) - 6
    factor = float(r @ fit.W @ r) / freedom if freedom > 0 else 1.0
    G = covariance @ fit.A.T @ fit.W  # pose error = G (image noise - J target error)
    if factor > 1.0:
        component = _image_component(r, image, J @ targets @ J.T, freedom)
        covariance = covariance + (component - 1.0) * G @ image @ G.T
    with_ball = np.zeros((6, 4)) if rig.cross_covariance is None else -G @ J @ rig.cross_covariance[rows]
    by_focal = -G @ (observed - (rig.camera.cx, rig.camera.cy)).ravel()
    pose = Pose(fit.pose.rotation, fit.pose.position, 0.5 * (covariance + covariance.T), with_ball, by_focal)
    return Resection(pose, tuple(s.code for s in used), observed, r.reshape(-1, 2), factor)


def _image_component(r: Array, image: Array, targets: Array, freedom: int) -> float:
    """Return the factor on the covariance `image` with which residuals (m,) are as large as expected.

    Use only factors above 1. A few targets give few degrees of freedom, so the factor may enlarge the pose's
    covariance, but never shrink it. It applies to the image's covariance alone. A common shift of all targets leaves
    no residual, so residuals do not show its size.
    """

    def excess(factor: float) -> float:
        return float(r @ np.linalg.solve(factor * image + targets, r)) / freedom - 1.0

    low = excess(1.0) + 1.0  # exact where the targets are
    high = float(r @ np.linalg.solve(image, r)) / freedom
    while high - low > 1e-9 * low:  # halved: scipy's root finders would cost a program that runs for months 20 MB
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return high


def _possible(pose: Pose, rig: Rig, which: NDArray[np.intp]) -> bool:
    """In front of the targets, on the side they face, and outside the ball."""
    points = rig.targets.position[which]
    return bool(
        np.all(pose.to_cam(points)[:, 2] > 0)
        and np.all((pose.position - points) @ rig.targets.normal > 0.0)
        and np.linalg.norm(pose.position - rig.ball.centre) > rig.ball.radius
    )


def _refuse_many(seen: dict[str, list[Sighting]], choices: int) -> None:
    if choices > _MAX_COMBINATIONS:
        copies = ", ".join(f"{len(options)} of {code}" for code, options in seen.items() if len(options) > 1)
        raise PoseError(f"the picture has too many copies of the rig's targets ({copies}): cover the copies")


def _is_complete(fits: list[Resection]) -> bool:
    """Return whether a fit of one copy of each visible target shows that no target of the rig is missing."""
    if not fits:
        return False
    best = min(np.sqrt(np.mean(f.residual**2)) for f in fits)
    return best <= 2.0 or len(fits[0].codes) == 3


def _distinct(fits: list[Resection]) -> list[Resection]:
    """Return the fits with residuals as good as the best: most targets first, then chi-square within 4 sigma."""
    if not fits:
        return []
    most = max(len(f.codes) for f in fits)
    limit = 30.0  # px RMS of a fit that means anything at all
    fits = [f for f in fits if np.sqrt(np.mean(f.residual**2)) < limit]
    full = [f for f in fits if len(f.codes) == most]
    if full and not _is_complete(full):
        full = [f for f in fits if np.sqrt(np.mean(f.residual**2)) < 2.0]  # a copy of a target was among them
    if not full:
        return []
    cost = [f.variance_factor * max(2 * len(f.codes) - 6, 0) for f in full]
    scale = max(min(cost) / max(2 * most - 6, 1), 1.0)
    near = [k for k in sorted(range(len(full)), key=cost.__getitem__) if cost[k] - min(cost) < 16.0 * scale]
    place = np.array([full[k].pose.position for k in near])
    return [full[near[k]] for k in suppress(place, np.full(len(near), 1e-3))]


def _by_outline(fits: list[Resection], rig: Rig, image: Image) -> Resection:
    """Return the fit with the ball's outline on an edge of the image. Raises PoseError if two fits have one, or none.

    Three targets always fit. So even a single pose of three targets needs the ball's outline as confirmation.
    """
    scores = [outline.support(image, rig, f.pose) for f in fits]
    order = np.argsort(scores)[::-1]
    best = scores[order[0]]
    second = scores[order[1]] if len(fits) > 1 else 0.0
    if len(fits) == 1 and best < 0.3:
        raise PoseError(
            f"the camera position that fits the targets {', '.join(fits[0].codes)} has the ball's outline where none "
            "is seen: uncover a fourth target, or the edge of the ball, or give the rig of this device"
        )
    if best < 0.3 or second > 0.7 * best:
        seen = fits[0].codes
        raise PoseError(
            f"{len(fits)} camera positions fit the targets {', '.join(seen)} and the ball's outline does not decide "
            "between them: uncover a fourth target, or the edge of the ball"
        )
    return fits[int(order[0])]
