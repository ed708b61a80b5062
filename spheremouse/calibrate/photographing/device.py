"""Which pictures of a device become photos: those from a new direction, and from where they help the adjustment most.

A picture is placed among the photos by its targets, as `calibrate device` begins (start). What is wanted is what the
whole adjustment of the photos so far would ask for (plans): the two cannot disagree.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import DiscSettings
from spheremouse.ball.detect.projection import GREY, projected
from spheremouse.ball.detect.rings import RingSettings, TargetDetections, detect_targets
from spheremouse.ball.device import Axes, Device
from spheremouse.calibrate.device.bundle import Block
from spheremouse.calibrate.device.calibrate import TARGET_SIGMA, calibrate_device, dark_spots
from spheremouse.calibrate.device.correspond import APART
from spheremouse.calibrate.device.plans import ENOUGH, work_of
from spheremouse.calibrate.device.start import first_block, target_views
from spheremouse.calibrate.photographing.edges import blur_of_spots, not_sharp
from spheremouse.calibrate.photographing.look import STILL, Look, Motion, is_dark, moving
from spheremouse.calibrate.photos import DEVICE_ENOUGH, DEVICE_MOST
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation

_NEARER = 0.8  # of the distance of photos from there: what plans call nearer
# From how many degrees on a photo is from a side: half of what a frame's targets allow; below, the floor is near.
_SIDES = {"from the left": 20.0, "from the right": 20.0, "from above": 20.0, "from below": 5.0}
_THREE = 3  # targets that place a camera, and photos from which an adjustment says something


@dataclass(frozen=True, slots=True)
class Assessment:
    """The adjustment of some photos, in short."""

    photos: int
    words: str  # what is known how well, or why nothing is
    wanted: tuple[str, ...] = ()  # more photos, the best first
    good: bool = False  # as the tracker wants it


class DeviceJudge:
    """The photos of a device so far, and whether a picture adds to them; see look.Judge."""

    def __init__(
        self, device: Device, camera: InteriorOrientation, rings: RingSettings | None, discs: DiscSettings | None
    ) -> None:
        self._device = replace(device, distances=())  # a slip of the tape is no fault of a photo
        self._camera = camera
        self._rings, self._discs = rings or RingSettings(), discs or DiscSettings()
        self._seen: list[TargetDetections] = []
        self._read: list[Callable[[], Image]] = []
        self._block: Block | None = None  # of the photos so far
        self._motion, self._sharpest = Motion(_THREE), np.inf
        self.assessment = Assessment(0, "")

    @property
    def count(self) -> int:
        """Photos."""
        return len(self._seen)

    @property
    def enough(self) -> bool:
        """As many as the recipe wants, and known well; or as many as it allows."""
        known = self.assessment
        good = known.photos == self.count and known.good and not known.wanted
        return self.count >= DEVICE_MOST or (self.count >= DEVICE_ENOUGH and good)

    def look(self, picture: Image) -> Look:
        """Judge the next frame."""
        if picture.ndim == 2:
            raise CalibrationError("the camera gives grey pictures, and the targets are told apart by their colours")
        found = detect_targets(picture, self._device.target_radii, self._rings)
        moved = self._motion.since_last(found.codes, found.centre)
        fault = self._fault(found)
        if fault:
            return Look(found, "the picture is dark" if is_dark(picture) else fault)
        where = f"{len(self._known(found))} of {len(self._device.codes)} targets"
        if moved >= STILL:
            return Look(found, f"{where}; the camera {moving(moved)}")
        new, place = self._place(found)
        if not new:
            return Look(found, f"{where}; {place}")
        grey = np.asarray(projected(picture, self._discs.projection or GREY), np.uint8)
        spots = dark_spots(grey, found, self._device.disc_radius / self._device.target_radii[2])
        blur = blur_of_spots(grey, spots)
        self._sharpest = min(self._sharpest, blur)  # nan is not less
        hindered = not_sharp(blur, self._sharpest)
        return Look(found, f"{where}; {hindered}" if hindered else where, "" if hindered else place)

    def resume(self, read: Callable[[], Image]) -> bool:
        """Count a photo that shows three targets."""
        found = detect_targets(read(), self._device.target_radii, self._rings)
        if self._fault(found):
            return False
        self.add(Look(found, ""), read)
        return True

    def add(self, look: Look, read: Callable[[], Image]) -> None:
        """Count a photo."""
        found = look.seen
        assert isinstance(found, TargetDetections)
        self._seen.append(found)
        self._read.append(read)
        self._block = self._placed(self._seen)

    def wanted(self) -> list[str]:
        """Where to go, left and right as the camera sees them."""
        known = self.assessment
        if known.wanted:
            return list(known.wanted)
        sides = self._sides()
        return [f"take one {side}" for side in sides] or ["take more from places between"]

    def status(self) -> list[str]:
        """Photos, and what they tell."""
        known = self.assessment
        told = f"; of {known.photos}: {known.words}" if known.words else ""
        return [f"{self.count} photos of {DEVICE_ENOUGH} to {DEVICE_MOST}{told}"]

    def pending_work(self) -> Callable[[], None] | None:
        """The adjustment of the photos so far, where it is not done."""
        n, reads = self.count, list(self._read)
        if n < _THREE or n == self.assessment.photos:
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
        often = int(np.count_nonzero(done.sightings >= _THREE))
        words = f"{len(done.discs)} discs, {often} of them in three photos or more; ball to {100.0 * part:.2g} % of it"
        odd = [f"photo {k + 1}: {why}" for k, why in (*done.skipped, *done.doubtful)]
        plans = tuple(a.text for a in work_of(done))
        return Assessment(n, "; ".join([words, *odd]), plans, part <= ENOUGH)

    # ---- where it is ----

    def _known(self, found: TargetDetections) -> set[str]:
        return set(found.codes) & set(self._device.codes)

    def _fault(self, found: TargetDetections) -> str:
        """The reason why a picture is of no use by itself."""
        views = target_views([found], self._device, self._camera, TARGET_SIGMA)
        return views.skipped[0][1] if views.skipped else ""

    def _place(self, found: TargetDetections) -> tuple[bool, str]:
        """Whether a picture is from a new place; how far off, or why not."""
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
        near = angle < APART
        if not near.any():
            return True, f"{np.degrees(angle.min()):.0f}° from the nearest photo"
        if distance[-1] < _NEARER * distance[:-1][near].min():
            return True, "from nearer"
        least = np.degrees(APART)
        return False, f"{np.degrees(angle.min()):.0f}° from a photo there is, {least:.0f}° are wanted: go further round"

    def _placed(self, seen: Sequence[TargetDetections], strict: bool = False) -> Block | None:
        """Where all were taken from, by targets that two of them show. Strict: CalibrationError if the last is out."""
        twice = [c for c in self._device.codes if sum(c in found.codes for found in seen) >= 2]
        if len(seen) < 2 or len(twice) < _THREE:
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

    def _sides(self) -> list[str]:
        """Sides from which no photo is, as far as the axes tell."""
        if self._block is None:
            return list(_SIDES) if self._seen else ["from the front"]
        if len(self._block.points) < len(self._device.codes):
            return []  # the axes may be other ones
        x, y, z = (np.array([pose.position for pose in self._block.poses]) - self._block.points.mean(axis=0)).T
        azimuth, height = np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))
        reached = (-azimuth.min(), azimuth.max(), height.max(), -height.min())
        sides = zip(_SIDES.items(), np.degrees(reached), strict=True)
        return [side for (side, least), angle in sides if angle < least]


def _only(device: Device, codes: Sequence[str]) -> Device:
    """The device with these targets alone; where one of its axes' is not among them, in other axes."""
    ids = tuple(i for i, c in zip(device.ids, device.codes, strict=True) if c in codes)
    axes = device.axes
    if not {axes.origin, axes.up, axes.plane} <= set(ids):
        axes = Axes(*ids[:_THREE])
    return replace(device, ids=ids, codes=tuple(c for c in device.codes if c in codes), axes=axes)
