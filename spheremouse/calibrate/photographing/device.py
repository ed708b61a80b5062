"""The choice of frames of a device: those from a new direction, where they help the adjustment most.

Targets place a frame among the photos, as at the start of `calibrate device`. The adjustment of all photos so far finds
the next places by the same plans that `calibrate device` reports, so both want the same photos.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import DiscSettings
from spheremouse.ball.detect.rings import RingSettings, TargetDetections, detect_targets
from spheremouse.ball.device import Axes, Device
from spheremouse.calibrate.device.bundle import Block
from spheremouse.calibrate.device.calibrate import TARGET_SIGMA, calibrate_device
from spheremouse.calibrate.device.correspond import MIN_RAY_ANGLE
from spheremouse.calibrate.device.plans import ENOUGH, best_plans
from spheremouse.calibrate.device.start import first_block, target_views
from spheremouse.calibrate.photographing.selector import (
    MAX_MOTION,
    FrameCheck,
    FrameMotion,
    Sharpness,
    is_dark,
    motion_fault,
)
from spheremouse.calibrate.photos import DEVICE_ENOUGH, DEVICE_MOST
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation

_NEARER = 0.8  # of the distance of the photos from there
# Least angles of a photo from a side, degrees: half of what a frame's targets allow; below, the floor is near.
_MIN_ANGLES = {"from the left": 20.0, "from the right": 20.0, "from above": 20.0, "from below": 5.0}
_MIN_TARGETS = 3  # to place a camera
_MIN_PHOTOS = 3  # for an adjustment


@dataclass(frozen=True, slots=True)
class Assessment:
    """The adjustment of some photos, in short."""

    photos: int
    words: str  # accuracy so far, or why there is none
    wanted: tuple[str, ...] = ()  # more photos, the best first
    good: bool = False  # enough for the tracker


class DeviceSelector:
    """The photos of a device so far, and the check of further frames; see `selector.Selector`."""

    def __init__(
        self, device: Device, camera: InteriorOrientation, rings: RingSettings | None, discs: DiscSettings | None
    ) -> None:
        self._device = replace(device, distances=())  # a wrong distance is no fault of a photo
        self._camera = camera
        self._rings, self._discs = rings or RingSettings(), discs or DiscSettings()
        self._seen: list[TargetDetections] = []
        self._read: list[Callable[[], Image]] = []
        self._block: Block | None = None  # of the photos so far
        self._motion, self._sharpness = FrameMotion(_MIN_TARGETS), Sharpness()
        self.assessment = Assessment(0, "")

    @property
    def count(self) -> int:
        """Number of photos."""
        return len(self._seen)

    @property
    def enough(self) -> bool:
        """True for a good adjustment of enough photos, or for as many photos as the instructions allow."""
        known = self.assessment
        good = known.photos == self.count and known.good and not known.wanted
        return self.count >= DEVICE_MOST or (self.count >= DEVICE_ENOUGH and good)

    def check(self, picture: Image) -> FrameCheck:
        """Check the next frame, (h, w, 3) BGR. Raises CalibrationError if it is grey."""
        if picture.ndim == 2:
            raise CalibrationError("the camera gives grey pictures, but the targets differ only in colour")
        found = detect_targets(picture, self._device.target_radii, self._rings)
        moved = self._motion.update(found.codes, found.centre)
        fault = self._fault(found)
        if fault:
            return FrameCheck(found, "the picture is dark" if is_dark(picture) else fault)
        where = f"{len(self._known(found))} of {len(self._device.codes)} targets"
        if moved >= MAX_MOTION:
            return FrameCheck(found, f"{where}; the camera {motion_fault(moved)}")
        new, place = self._place(found)
        if not new:
            return FrameCheck(found, f"{where}; {place}")
        fault = self._sharpness.fault(picture, found.centre)
        return FrameCheck(found, f"{where}; {fault}" if fault else where, "" if fault else place)

    def resume(self, read: Callable[[], Image]) -> bool:
        """Count an existing photo with three targets."""
        found = detect_targets(read(), self._device.target_radii, self._rings)
        if self._fault(found):
            return False
        self.add(FrameCheck(found, ""), read)
        return True

    def add(self, check: FrameCheck, read: Callable[[], Image]) -> None:
        """Count a checked frame as a photo."""
        found = check.seen
        assert isinstance(found, TargetDetections)
        self._seen.append(found)
        self._read.append(read)
        self._block = self._placed(self._seen)

    def wanted(self) -> list[str]:
        """List places to go to; left and right as the camera sees them."""
        known = self.assessment
        if known.wanted:
            return list(known.wanted)
        return [f"take one {side}" for side in self._missing_sides()] or ["take more from places between"]

    def status(self) -> list[str]:
        """Describe the photos, and the accuracy that they give."""
        known = self.assessment
        words = f"; of {known.photos}: {known.words}" if known.words else ""
        return [f"{self.count} photos of {DEVICE_ENOUGH} to {DEVICE_MOST}{words}"]

    def pending_work(self) -> Callable[[], None] | None:
        """Return the adjustment of the photos so far; None if it is done, or if the photos are too few for one."""
        n, reads = self.count, list(self._read)
        if n < _MIN_PHOTOS or n == self.assessment.photos:
            return None

        def adjust() -> None:
            self.assessment = self._assessed(n, reads)

        return adjust

    def _assessed(self, n: int, reads: Sequence[Callable[[], Image]]) -> Assessment:
        try:
            done = calibrate_device(reads, self._device, self._camera, self._rings, self._discs)
        except CalibrationError as e:
            return Assessment(n, str(e))
        part = float(np.sqrt(np.diag(done.ball_covariance)).max()) / done.radius
        often = int(np.count_nonzero(done.sightings >= 3))
        words = f"{len(done.discs)} discs, {often} of them in three photos or more; ball to {100.0 * part:.2g} % of it"
        odd = [f"photo {k + 1}: {why}" for k, why in (*done.skipped, *done.doubtful)]
        plans = tuple(a.text for a in best_plans(done))
        return Assessment(n, "; ".join([words, *odd]), plans, part <= ENOUGH)

    def _known(self, found: TargetDetections) -> set[str]:
        return set(found.codes) & set(self._device.codes)

    def _fault(self, found: TargetDetections) -> str:
        """Describe why a picture is of no use by itself; empty if it is."""
        views = target_views([found], self._device, self._camera, TARGET_SIGMA)
        return views.skipped[0][1] if views.skipped else ""

    def _place(self, found: TargetDetections) -> tuple[bool, str]:
        """Return True for a picture from a new place, and how far off it is, or why not."""
        if not self._seen:
            return True, "the first"
        try:
            block = self._placed([*self._seen, found], strict=True)
        except CalibrationError as e:
            return False, str(e)
        assert block is not None
        way = np.array([pose.position for pose in block.poses]) - block.points.mean(axis=0)
        distance = np.linalg.norm(way, axis=1)
        cosine = np.clip(way[:-1] @ way[-1] / (distance[:-1] * distance[-1]), -1.0, 1.0)
        angle = np.arccos(cosine)
        near = angle < MIN_RAY_ANGLE
        if not near.any():
            return True, f"{np.degrees(angle.min()):.0f}° from the nearest photo"
        if distance[-1] < _NEARER * distance[:-1][near].min():
            return True, "from nearer"
        least = np.degrees(MIN_RAY_ANGLE)
        return False, f"{np.degrees(angle.min()):.0f}° from a photo there is, {least:.0f}° are wanted: go further round"

    def _placed(self, seen: Sequence[TargetDetections], strict: bool = False) -> Block | None:
        """Find the places of all pictures, by targets that two of them show.

        If `strict`, raises CalibrationError if the last picture has no place.
        """
        twice = [c for c in self._device.codes if sum(c in found.codes for found in seen) >= 2]
        if len(seen) < 2 or len(twice) < _MIN_TARGETS:
            if strict:
                raise CalibrationError("it shares too few targets with the photos there are: three must be in both")
            return None
        device = _only(self._device, twice)
        try:
            views = target_views(seen, device, self._camera, TARGET_SIGMA)
            block, views = first_block(views, device, self._camera, [f"photo {k + 1}" for k in range(len(seen))])
        except CalibrationError:
            if strict:
                raise
            return None
        if strict and len(seen) - 1 not in views.photos:
            raise CalibrationError(dict(views.skipped)[len(seen) - 1])
        return block

    def _missing_sides(self) -> list[str]:
        """Sides without a photo, as far as the axes are known."""
        if self._block is None:
            return list(_MIN_ANGLES) if self._seen else ["from the front"]
        if len(self._block.points) < len(self._device.codes):
            return []  # the axes may differ
        x, y, z = (np.array([pose.position for pose in self._block.poses]) - self._block.points.mean(axis=0)).T
        azimuth, height = np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))
        reached = (-azimuth.min(), azimuth.max(), height.max(), -height.min())
        sides = zip(_MIN_ANGLES.items(), np.degrees(reached), strict=True)
        return [side for (side, least), angle in sides if angle < least]


def _only(device: Device, codes: Sequence[str]) -> Device:
    """The device with these targets alone; in other axes if one of the axes' targets is missing."""
    ids = tuple(i for i, c in zip(device.ids, device.codes, strict=True) if c in codes)
    axes = device.axes
    if not {axes.origin, axes.up, axes.plane} <= set(ids):
        axes = Axes(*ids[:3])
    return replace(device, ids=ids, codes=tuple(c for c in device.codes if c in codes), axes=axes)
