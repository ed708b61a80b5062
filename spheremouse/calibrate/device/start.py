"""Approximate targets and cameras from the apparent size of the rings, photo by photo.

A ring of radius r with the semi-major axis a in reduced coordinates is at a depth of r / a at any slant, within a
percent or so. Wittich 2017, section 3.3.1, uses measured coordinates instead.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from spheremouse.ball.detect.rings import TargetDetections
from spheremouse.ball.device import Device, DistanceError
from spheremouse.calibrate.device.bundle import Block, ImagePoints, Problem, distances, predicted, solve_block
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation, Pose, unproject
from spheremouse.geometry.rotation import Array, align

_DEPTH_SIGMA = 0.02  # relative: half a pixel of a ring of 25 px
_CENTRE_SIGMA = 0.5  # px, of a ring's centre in this start
_MAX_RMS = 0.3  # px per axis: six standard deviations of a ring's centre
_MAX_REMAINING = 0.7  # of the squared residuals without a wrong photo
_MAX_NAMED = 3
_MAX_DISTANCE_ERROR = 0.05  # relative; the rings' is a few percent


@dataclass(frozen=True, slots=True)
class TargetViews:
    """The targets of a device in the photos with three or more of them."""

    photos: tuple[int, ...]  # which photos
    image: ImagePoints  # `photo` counts those
    depth: Array  # (n, 2) m: depth by apparent size, and its standard deviation
    skipped: tuple[tuple[int, str], ...]  # photos left out, and why
    strangers: tuple[str, ...] = ()  # codes in most photos that the device does not have
    ring_scale: float = 1.0  # factor on lengths by the rings' size, from distances


def target_views(
    seen: Sequence[TargetDetections], device: Device, camera: InteriorOrientation, sigma: float
) -> TargetViews:
    """Return image points of the device's targets, of photos with three or more; `sigma` px is that of a centre."""
    row = {code: i for i, code in enumerate(device.codes)}
    photos: list[int] = []
    parts: list[tuple[int, int, Array, float]] = []
    skipped = []
    for k, found in enumerate(seen):
        codes = [c for c in found.codes if c in row]
        repeated = sorted({c for c in codes if codes.count(c) > 1})
        known_targets = []
        for code, centre, contour, radius in zip(found.codes, found.centre, found.contours, found.radius, strict=True):
            if code in row and code not in repeated:
                depth = _depth(centre, contour, radius, device, camera)
                if np.isfinite(depth):
                    known_targets.append((row[code], centre, depth))
        if len(known_targets) < 3:
            missing = ", ".join(c for c in device.codes if c not in codes)
            reason = f"{len(known_targets)} of {len(device.codes)} targets found, 3 are needed"
            reason += f"; {', '.join(repeated)} seen twice: cover the copy" if repeated else f"; missing: {missing}"
            skipped.append((k, reason))
            continue
        parts += [(len(photos), i, centre, depth) for i, centre, depth in known_targets]
        photos.append(k)
    n = len(parts)
    image = ImagePoints(
        np.array([p[0] for p in parts], dtype=np.intp),
        np.array([p[1] for p in parts], dtype=np.intp),
        np.array([p[2] for p in parts]).reshape(-1, 2),
        np.broadcast_to(sigma**2 * np.eye(2), (n, 2, 2)).copy(),
    )
    z = np.array([p[3] for p in parts])
    shown = [c for found in seen for c in set(found.codes) - set(row)]
    strangers = tuple(c for c in sorted(set(shown)) if shown.count(c) > len(seen) / 2)
    return TargetViews(tuple(photos), image, np.stack([z, _DEPTH_SIGMA * z], axis=1), tuple(skipped), strangers)


def first_block(
    views: TargetViews, device: Device, camera: InteriorOrientation, names: Sequence[str]
) -> tuple[Block, TargetViews]:
    """Return poses of all photos and coordinates of all targets, in the frame of the targets, to some mm.

    Photos are left out if their targets do not fit the others. Raises CalibrationError if too few photos remain, and
    DistanceError if a distance differs far from the others.
    """
    while True:
        _enough(views, device, names)
        block = _adjust(views, device, camera)
        behind = [i for i, pose in enumerate(block.poses) if pose.position[2] < 0.0]
        if behind:
            reason = (
                "its targets are seen from behind: the photo is mirrored, as some cameras save them; switch that off"
            )
            views = _without(views, behind[0], reason)
            continue
        inconsistent = _inconsistent_photo(views, block, device, camera)
        if inconsistent is None:
            return _scale(views, block, device)
        photo, residual_px = inconsistent
        reason = (
            f"its targets do not fit the other photos ({residual_px:.0f} px): another device, or a target was moved"
        )
        views = _without(views, photo, reason)


def _inconsistent_photo(
    views: TargetViews, block: Block, device: Device, camera: InteriorOrientation
) -> tuple[int, float] | None:
    """Return the index of the photo without which the others fit best, and the largest RMS of a photo of all, px.

    None if all fit, with fewer than three photos, or if the others fit little better without it.
    """
    rms = _rms(views, block, device, camera)
    if np.max(rms) <= _MAX_RMS or len(views.photos) < 3:
        return None
    squares_without = []
    for i in range(len(views.photos)):
        others = _without(views, i, "")
        try:
            squares_without.append(float(np.sum(_rms(others, _adjust(others, device, camera), device, camera) ** 2)))
        except CalibrationError:
            squares_without.append(np.inf)
    worst = int(np.argmin(squares_without))
    fits = squares_without[worst] < _MAX_REMAINING * float(np.sum(rms**2))
    return (worst, float(np.max(rms))) if fits else None


def _scale(views: TargetViews, block: Block, device: Device) -> tuple[Block, TargetViews]:
    """Return poses, points and depths scaled by the median ratio of the measured distances to those in `block`.

    Without measured distances, nothing changes. Raises DistanceError if a ratio is too far from the median.
    """
    if not device.distances:
        return block, views
    ratio = np.array([d.metres for d in device.distances]) / distances(device, block.points)
    scale = float(np.median(ratio))
    deviation = np.abs(ratio / scale - 1.0)
    worst = int(np.argmax(deviation))
    if deviation[worst] > _MAX_DISTANCE_ERROR:
        raise DistanceError(device, worst, device.distances[worst].metres / ratio[worst] * scale)
    poses = tuple(Pose(p.rotation, scale * p.position) for p in block.poses)
    views = replace(views, depth=scale * views.depth, ring_scale=scale)
    return Block(block.camera, poses, scale * block.points), views


def _depth(centre: Array, contour: Array, radius: float, device: Device, camera: InteriorOrientation) -> float:
    """Depth of a ring, m; nan if no ray maps to its place."""
    (_, axes, angle) = cv2.fitEllipse(np.asarray(contour, dtype=np.float32))
    ratio = np.sqrt(max(axes) / max(min(axes), 1.0))
    turn = np.deg2rad(angle if axes[0] >= axes[1] else angle + 90.0)  # of the longer axis
    along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    shape = radius**2 * (ratio**2 * np.outer(along, along) + np.outer(across, across) / ratio**2)
    _, J = unproject(centre[None], camera)
    value = np.linalg.eigvalsh(J[0] @ shape @ J[0].T)[-1]
    return float(device.target_radii[2] / np.sqrt(value)) if value > 0 else np.nan


def _enough(views: TargetViews, device: Device, names: Sequence[str]) -> None:
    """Raise CalibrationError if fewer than two photos fit together, or a target is in fewer than two."""
    if len(views.photos) < 2:
        whys = [f"{names[k]}: {w}" for k, w in views.skipped]
        more = f"; and {len(whys) - _MAX_NAMED} more" if len(whys) > _MAX_NAMED else ""
        photos = "1 photo shows" if len(views.photos) == 1 else "no photo shows"
        raise CalibrationError(
            f"{photos} targets of this device that fit together, at least 2 must"
            + (f" ({'; '.join(whys[:_MAX_NAMED])}{more}): take sharp, bright ones" if whys else ": give more photos")
        )
    missing = [c for i, c in enumerate(device.codes) if np.count_nonzero(views.image.point == i) < 2]
    if missing and views.strangers:
        raise CalibrationError(
            f"target {', '.join(missing)} is seen in fewer than 2 of {len(views.photos)} photos, but "
            f"{', '.join(views.strangers)}, which device.yaml does not list, in most: correct the code"
        )
    if missing:
        raise CalibrationError(
            f"target {', '.join(missing)} is seen in fewer than 2 of {len(views.photos)} photos: uncover it, or take "
            "it out of device.yaml"
        )


def _adjust(views: TargetViews, device: Device, camera: InteriorOrientation) -> Block:
    """Return poses and targets: photos join the one with most targets, and an adjustment follows."""
    image = views.image
    xy, _ = unproject(image.centre, camera)
    cam = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) * views.depth[:, :1]
    n, m = len(views.photos), len(device.ids)
    # the photo with most targets is the first frame; the others join when they share three known targets
    counts = np.bincount(image.photo, minlength=n)
    points = np.full((m, 3), np.nan)
    poses: list[Pose | None] = [None] * n
    first = int(np.argmax(counts))
    poses[first] = Pose(np.eye(3), np.zeros(3))
    mine = image.photo == first
    points[image.point[mine]] = cam[mine]
    for _ in range(n):
        for k in range(n):
            mine = image.photo == k
            known = np.isfinite(points[image.point[mine], 0])
            if poses[k] is None and np.count_nonzero(known) >= 3:
                a, b = cam[mine][known], points[image.point[mine]][known]
                R = align(a - a.mean(axis=0), b - b.mean(axis=0))
                P = b.mean(axis=0) - R @ a.mean(axis=0)
                poses[k] = Pose(R, P)
                points[image.point[mine][~known]] = cam[mine][~known] @ R.T + P
    if any(p is None for p in poses) or not np.all(np.isfinite(points)):
        raise CalibrationError("the photos share too few targets: each must show three that another shows too")
    found = [p for p in poses if p is not None]
    block = _in_axes(Block(camera, tuple(found), points), device)
    rough = replace(image, covariance=np.tile(_CENTRE_SIGMA**2 * np.eye(2), (len(image), 1, 1)))
    sure = replace(camera, covariance=np.zeros((9, 9)))
    # the size of the rings gives a scale to begin with
    problem = Problem(replace(device, distances=()), sure, rough, scale_free=False, depth=views.depth)
    try:
        block = solve_block(problem, block, knee=2.0).block
    except np.linalg.LinAlgError:
        raise CalibrationError("the photos do not fix the targets: take them from places further apart") from None
    return _in_axes(block, device)


def _in_axes(block: Block, device: Device) -> Block:
    """The block in the frame of the targets, Z on the side of the cameras."""
    R = axes_of(block.points, device.row, device, np.mean([p.position for p in block.poses], axis=0))
    origin = block.points[device.row[device.axes.origin]]
    poses = tuple(Pose(R @ p.rotation, R @ (p.position - origin)) for p in block.poses)
    return Block(block.camera, poses, (block.points - origin) @ R.T)


def axes_of(places: Array, row: Mapping[int, int], device: Device, camera: Array) -> Array:
    """Return the rotation, (3, 3), to the axes that three targets define; Z points towards `camera`, (3,).

    `places`, (n, 3), are the targets, and `row` gives the row of each target's number. Raises CalibrationError if the
    three lie in a line.
    """
    origin, up, plane = (places[row[i]] for i in (device.axes.origin, device.axes.up, device.axes.plane))
    y = (up - origin) / np.linalg.norm(up - origin)
    z = np.cross(y, plane - origin)
    if np.linalg.norm(z) < 0.02 * np.linalg.norm(plane - origin):
        raise CalibrationError("the three targets of `axes` lie in a line: name another for `plane` in the device file")
    z = z / np.linalg.norm(z)
    z = -z if z @ (camera - origin) < 0.0 else z
    return np.array([np.cross(y, z), y, z])


def _rms(views: TargetViews, block: Block, device: Device, camera: InteriorOrientation) -> Array:
    """RMS per axis of each photo's targets, px."""
    image, n = views.image, len(block.poses)
    problem = Problem(device, camera, image, not device.distances)
    squared = np.sum((predicted(block, image, problem)[0] - image.centre) ** 2, axis=1)
    return np.sqrt(np.bincount(image.photo, squared, minlength=n) / (2.0 * np.bincount(image.photo, minlength=n)))


def _without(views: TargetViews, photo: int, why: str) -> TargetViews:
    keep = views.image.photo != photo
    image = views.image.take(keep)
    image = replace(image, photo=image.photo - (image.photo > photo))
    photos = tuple(p for i, p in enumerate(views.photos) if i != photo)
    skipped = (*views.skipped, (views.photos[photo], why))
    return replace(views, photos=photos, image=image, depth=views.depth[keep], skipped=skipped)
