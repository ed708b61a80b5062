"""The choice of frames of a device: those from a new direction.

Targets place a frame among the photos, as at the start of `calibrate device`. It reports the same missing sides.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.rings import RingSettings, TargetDetections, detect_targets
from spheremouse.ball.device import Axes, Device
from spheremouse.calibrate.device.advice import missing_sides
from spheremouse.calibrate.device.bundle import Block
from spheremouse.calibrate.device.calibrate import TARGET_SIGMA
from spheremouse.calibrate.device.correspond import MIN_RAY_ANGLE
from spheremouse.calibrate.device.start import TargetViews, first_block, target_views
from spheremouse.calibrate.photographing.selector import Selector
from spheremouse.calibrate.photos import DEVICE_ENOUGH, DEVICE_MOST
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array

_MAX_NEARER_RATIO = 0.8  # of the distance of the photos from there
_MIN_TARGETS = 3  # to place a camera
_MIN_ADDED = 2  # photos of a session that continues, so that a complete set can grow


class DeviceSelector(Selector[TargetDetections]):
    """The photos of a device so far, and the check of further frames."""

    def __init__(self, device: Device, camera: InteriorOrientation, rings: RingSettings | None = None) -> None:
        super().__init__("the camera", _MIN_TARGETS)
        self._device = replace(device, distances=())  # a wrong distance is no fault of a photo
        self._camera = camera
        self._rings = rings or RingSettings()
        self._seen: list[TargetDetections] = []
        self._resumed = 0  # photos that were there before
        self._block: Block | None = None  # of the photos so far

    @property
    def count(self) -> int:
        return len(self._seen)

    @property
    def enough(self) -> bool:
        """True for enough photos from all sides, or for as many photos as the instructions allow."""
        least = max(DEVICE_ENOUGH, self._resumed + _MIN_ADDED if self._resumed else 0)
        return self.count >= DEVICE_MOST or (self.count >= least and not self._missing_sides())

    def detect(self, picture: Image, *, quick: bool) -> TargetDetections:
        """Detect the targets; `quick` changes nothing. Raises CalibrationError if the picture is grey."""
        if picture.ndim == 2:
            raise CalibrationError("the camera gives grey pictures, but the targets differ only in colour")
        return detect_targets(picture, self._device.target_radii, self._rings)

    def fault(self, seen: TargetDetections) -> str:
        views = target_views([seen], self._device, self._camera, TARGET_SIGMA)
        return views.skipped[0][1] if views.skipped else ""

    def points(self, seen: TargetDetections) -> tuple[Sequence[str], Array]:
        return seen.codes, seen.centre

    def describe(self, seen: TargetDetections) -> str:
        return f"{len(set(seen.codes) & set(self._device.codes))} of {len(self._device.codes)} targets"

    def resume(self, picture: Image) -> bool:
        counts = super().resume(picture)
        self._resumed += counts
        return counts

    def add(self, seen: TargetDetections) -> None:
        self._seen.append(seen)
        try:
            self._block, _ = self._placed(self._seen)
        except CalibrationError:
            self._block = None

    def wanted(self) -> list[str]:
        return [f"take one {side}" for side in self._missing_sides()] or ["take more from places between"]

    def status(self) -> list[str]:
        return [f"{self.count} photos of {DEVICE_ENOUGH} to {DEVICE_MOST}"]

    def gain(self, seen: TargetDetections) -> tuple[str, str]:
        if not self._seen:
            return "the first", ""
        try:
            block, views = self._placed([*self._seen, seen])
        except CalibrationError as e:
            return "", str(e)
        if len(self._seen) not in views.photos:
            return "", dict(views.skipped)[len(self._seen)]
        way = np.array([pose.position for pose in block.poses]) - block.points.mean(axis=0)
        distance = np.linalg.norm(way, axis=1)
        cosine = np.clip(way[:-1] @ way[-1] / (distance[:-1] * distance[-1]), -1.0, 1.0)
        angle = np.arccos(cosine)
        near = angle < MIN_RAY_ANGLE
        if not near.any():
            return f"{np.degrees(angle.min()):.0f}° from the nearest photo", ""
        if distance[-1] < _MAX_NEARER_RATIO * distance[:-1][near].min():
            return "from nearer", ""
        least = np.degrees(MIN_RAY_ANGLE)
        return "", f"{np.degrees(angle.min()):.0f}° from a photo there is, {least:.0f}° are wanted: go further round"

    def _placed(self, seen: Sequence[TargetDetections]) -> tuple[Block, TargetViews]:
        """Find the places of the pictures, by targets that two of them show; CalibrationError if there are too few."""
        repeated_codes = [c for c in self._device.codes if sum(c in found.codes for found in seen) >= 2]
        if len(repeated_codes) < _MIN_TARGETS:
            raise CalibrationError("it shares too few targets with the photos there are: three must be in both")
        device = _only(self._device, repeated_codes)
        views = target_views(seen, device, self._camera, TARGET_SIGMA)
        return first_block(views, device, self._camera, [f"photo {k + 1}" for k in range(len(seen))])

    def _missing_sides(self) -> list[str]:
        """Sides without a photo, as far as the axes are known."""
        if self._block is None:
            return ["from another side"] if self._seen else ["from the front"]
        if len(self._block.points) < len(self._device.codes):
            return []  # the axes may differ
        return missing_sides(np.array([p.position for p in self._block.poses]), self._block.points.mean(axis=0))


def _only(device: Device, codes: Sequence[str]) -> Device:
    """The device with these targets alone; in other axes if one of the axes' targets is missing."""
    ids = tuple(i for i, c in zip(device.ids, device.codes, strict=True) if c in codes)
    axes = device.axes
    if not {axes.origin, axes.up, axes.plane} <= set(ids):
        axes = Axes(*ids[:3])
    return replace(device, ids=ids, codes=tuple(c for c in device.codes if c in codes), axes=axes)
