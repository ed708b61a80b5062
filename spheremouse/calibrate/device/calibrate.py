"""Calibration of a device from photos: image points of targets and discs, their numbers, and the adjustment.

Wittich 2017, section 3.3: targets give the cameras' poses, rays give discs. Discs are first dark spots. When the ball
is known, the tracker's detector measures them by their expected images.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.ball.detect.discs import DiscSettings, disc_detector
from spheremouse.ball.detect.projection import GREY, projected
from spheremouse.ball.detect.rings import RingSettings, TargetDetections, detect_targets
from spheremouse.ball.device import Device, DistanceError
from spheremouse.ball.published.blobs import BlobDetector
from spheremouse.ball.settings import BlobSettings
from spheremouse.calibrate.device.adjust import (
    BundleResult,
    DeviceCalibration,
    DiscViews,
    adjust_bundle,
    check_distances,
    shift_to_ball,
)
from spheremouse.calibrate.device.bundle import Block, ImagePoints, Problem, solve_block
from spheremouse.calibrate.device.correspond import (
    Spots,
    ball_rig,
    directions_on_ball,
    find_ball,
    has_wide_rays,
    is_before,
    number_discs,
)
from spheremouse.calibrate.device.start import TargetViews, first_block, target_views
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.least_squares.sphere import MIN_POINTS
from spheremouse.geometry.rotation import Array, hat

TARGET_SIGMA = 0.05  # px, of a ring's centre (TARGET_SIGMA_PX in ball/pose.py)
_SPOT_SIGMA = 0.5  # px, of a dark spot's centroid: threshold, slope of the light, eccentricity
_MIN_FACING = 0.5  # cosine, of a disc that every detector finds

Progress = Callable[[str, float], None]  # task, and share of all work done


def calibrate_device(
    photos: Sequence[Callable[[], Image]],
    device: Device,
    camera: InteriorOrientation,
    rings: RingSettings,
    discs: DiscSettings,
    names: Sequence[str],
    progress: Progress = lambda what, part: None,
) -> DeviceCalibration:
    """Calibrate a device from photos (h, w, 3) BGR of `camera`; each is read once.

    `names` of the photos are for messages. Photos with fewer than three targets, or of another device, are left out and
    named. Raises CalibrationError if too little remains, DistanceError if a tape distance contradicts the photos.
    """
    seen, grey = [], []
    for k, read in enumerate(photos):
        progress("looking for targets", 0.4 * k / len(photos))
        image = read()
        seen.append(detect_targets(image, device.target_radii, rings))
        grey.append(projected(image, discs.projection or GREY))
    views = target_views(seen, device, camera, TARGET_SIGMA)
    block, views = first_block(views, device, camera, names)
    progress("looking for the ball", 0.45)
    detections = [(grey[k], seen[k]) for k in views.photos]
    tolerance = _ray_tolerance(views, block, device, camera)

    def found(pictures: Sequence[tuple[Image, TargetDetections]]) -> tuple[BundleResult, Spots]:
        """Calibrate with discs that are dark in these pictures."""
        result = adjust_bundle(views, _first_discs(pictures, block, device, tolerance), block, device, camera)
        check_distances(result, device)
        spots = Spots(np.zeros(0, dtype=np.intp), np.zeros((0, 2)), np.zeros(0))
        for k in range(2):  # the second time with the ball of the first
            progress("measuring discs", 0.5 + 0.2 * k)
            spots, observed = _measured_discs(pictures, result, device, discs)
            progress("adjusting", 0.6 + 0.2 * k)
            result = adjust_bundle(views, observed, result.solution.block, device, camera)
        return result, spots

    failed: list[CalibrationError] = []
    for pictures in (
        (detections,) if discs.projection else (detections, [(cv2.bitwise_not(g), s) for g, s in detections])
    ):
        try:
            result, spots = found(pictures)
            return replace(shift_to_ball(result, views, device), doubtful=_doubtful(result, spots, views, device))
        except DistanceError:
            raise
        except CalibrationError as e:
            failed.append(e)
    raise failed[0] from None


def dark_spots(grey: Image, seen: TargetDetections, share: float) -> Detections:
    """Detect dark spots that may be discs of `share` of the targets' radius, at any distance and slant."""
    face = np.pi * (float(np.median(seen.radius)) * share) ** 2
    detector = BlobDetector(BlobSettings(masks=24, area=(max(0.1 * face, 12.0), 4.0 * face)))
    return detector.detect(grey)


def _first_discs(
    photos: Sequence[tuple[Image, TargetDetections]], block: Block, device: Device, tolerance: float
) -> DiscViews:
    """Dark spots on one ball with disc numbers; CalibrationError without a ball."""
    found = [dark_spots(grey, seen, device.disc_radius / device.target_radii[2]) for grey, seen in photos]
    spots = _spots_of(found)
    if not has_wide_rays(block.poses, block.points):
        raise CalibrationError("the photos are from places too close together: move further to the sides")
    K, R = find_ball(spots, block.poses, block.camera, device.disc_radius, tolerance)
    covariance = np.broadcast_to(_SPOT_SIGMA**2 * np.eye(2), (len(spots), 2, 2))
    return _numbered_points(spots, covariance, block, K, R, device.disc_radius)


def _spots_of(photos: Sequence[Detections]) -> Spots:
    photo = np.repeat(np.arange(len(photos)), [len(found) for found in photos])
    return Spots(photo, np.concatenate([f.centre for f in photos]), np.concatenate([f.area for f in photos]))


def _measured_discs(
    photos: Sequence[tuple[Image, TargetDetections]], result: BundleResult, device: Device, settings: DiscSettings
) -> tuple[Spots, DiscViews]:
    """Discs by the tracker's detector on the ball found so far: all, and those in two photos.

    In `photos` they are darker than the ball, for any setting of their colours.
    """
    settings = replace(settings, polarity="dark", weights=())
    block, K, R = result.solution.block, result.ball[:3], float(result.ball[3])
    if not is_before(block.poses, K, R):
        raise CalibrationError(
            "the dark spots lie on no ball that all photos show whole: see that disc_radius is a radius and no "
            "diameter, and light the ball so that its discs stand out"
        )
    rig = ball_rig(block.camera, K, R, device.disc_radius)
    detectors = (disc_detector(settings, rig, pose) for pose in block.poses)
    seen = [d.with_lens_blur(d.lens_blur(grey)).detect(grey) for (grey, _), d in zip(photos, detectors, strict=True)]
    spots, covariance = _spots_of(seen), np.concatenate([d.covariance for d in seen])
    return spots, _numbered_points(spots, covariance, block, K, R, 0.5 * device.disc_radius)


def _numbered_points(spots: Spots, covariance: Array, block: Block, K: Array, R: float, tolerance: float) -> DiscViews:
    """Spots on the ball that two photos or more show, at most `tolerance` m apart."""
    directions, index = directions_on_ball(spots, block.poses, block.camera, K, R)
    number = number_discs(spots.photo[index], directions, tolerance / R)
    if number.max(initial=-1) + 1 < MIN_POINTS:
        raise CalibrationError(
            f"{number.max(initial=-1) + 1} discs are seen in two photos or more, at least {MIN_POINTS} are needed: "
            "take sharp photos that overlap, keep the ball still between them, and see that disc_radius is a radius "
            "and no diameter"
        )
    index, directions, number = index[number >= 0], directions[number >= 0], number[number >= 0]
    middle = np.stack([np.bincount(number, directions[:, j]) for j in range(3)], axis=1)
    middle *= R / np.linalg.norm(middle, axis=1, keepdims=True)
    return DiscViews(ImagePoints(spots.photo[index], number, spots.centre[index], covariance[index]), K + middle)


def _ray_tolerance(views: TargetViews, block: Block, device: Device, camera: InteriorOrientation) -> float:
    """Largest distance, m, between rays to one disc while the targets alone give the poses.

    Three standard deviations of two rays at the targets, by the covariance of the poses and of a spot.
    """
    rough = replace(views.image, covariance=4.0 * views.image.covariance)  # eccentricity of the circles, camera, print
    solution = solve_block(Problem(device, camera, rough, not device.distances, views.depth), block)
    middle = solution.block.points.mean(axis=0)
    worst = 0.0
    for i, pose in enumerate(solution.block.poses):
        columns = solution.columns.pose(i)
        across = np.eye(3) - np.outer(pose.rotation[:, 2], pose.rotation[:, 2])
        J = across @ np.concatenate([np.eye(3), -hat(middle - pose.position)], axis=1)
        spot = _SPOT_SIGMA * np.linalg.norm(middle - pose.position) / block.camera.fx
        C = J @ solution.covariance[np.ix_(columns, columns)] @ J.T
        worst = max(worst, float(np.sqrt(np.linalg.eigvalsh(C)[-1] + spot**2)))
    return 3.0 * np.sqrt(2.0) * worst


def _doubtful(result: BundleResult, spots: Spots, views: TargetViews, device: Device) -> tuple[tuple[int, str], ...]:
    """Return the photos with discs at other places than in all other photos of that side: the ball turned before."""
    block, K, R = result.solution.block, result.ball[:3], float(result.ball[3])
    directions, index = directions_on_ball(spots, block.poses, block.camera, K, R)
    photo = spots.photo[index]
    discs = block.points[len(device.ids) :] - K
    discs /= np.linalg.norm(discs, axis=1, keepdims=True)
    known = np.max(directions @ discs.T, axis=1) > np.cos(0.5 * device.disc_radius / R)
    towards = np.array([p.position for p in block.poses])[None] - (K + R * directions)[:, None]
    cosine = np.sum(towards * directions[:, None], axis=2) / np.linalg.norm(towards, axis=2)
    cosine[np.arange(len(photo)), photo] = 0.0
    seen_elsewhere = np.max(cosine, axis=1) > _MIN_FACING
    doubtful = []
    for i, k in enumerate(views.photos):
        mine = (photo == i) & seen_elsewhere
        n, m = int(np.count_nonzero(mine)), int(np.count_nonzero(mine & known))
        if n >= MIN_POINTS and m < n / 3:
            doubtful.append(
                (k, f"only {m} of its {n} discs are where other photos show them: did the ball turn before it?")
            )
    return tuple(doubtful)
