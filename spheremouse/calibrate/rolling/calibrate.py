"""A rolled calibration from frames to result, in several passes, each with a better rig than the one before.

Dark spots in the first seconds give a start. The tracker runs on those seconds, then on all frames, and again if the
rig changed much. An adjustment follows each pass. The first pass also keeps a few views for the targets, and for a
check that the camera stood still.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from spheremouse.ball.detect.appearance import ball_mask
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import PROJECTIONS, DiscSettings
from spheremouse.ball.detect.projection import Projection, projected
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.calibrate.rolling.adjust import adjust_rolling
from spheremouse.calibrate.rolling.footage import Footage
from spheremouse.calibrate.rolling.problem import Rolling, RollingAdjustment
from spheremouse.calibrate.rolling.sightings import TrackedRolling, provisional_pose, track_rolling
from spheremouse.calibrate.rolling.start import RollingStart, Spots, dark_spots, start, start_rig
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.tracker import Frame, check_size

BLOCK = 15.0  # s of rolling for a start; then two and four times as much
_MIN_SECONDS = 2.9  # three, less a frame at 10 Hz
_MAX_CHANGE = 2e-3  # of the ratio, or rad: a rig that is off by less measures as well
_VIEW_INTERVAL = 0.5  # s
_MAX_VIEWS, _MAX_COLOUR_VIEWS = 240, 30
_MAX_FEATURES = 150  # places in the room, for the check that the camera stood still
_MAX_SHIFT = 0.5  # px; a larger one is that of a camera that was moved


@dataclass(slots=True)
class Views:
    """A few of the frames: in colour for the targets, grey for the check that the camera stood still."""

    colour: list[Image] = field(default_factory=list)
    grey: list[tuple[float, Image]] = field(default_factory=list)
    first: float | None = None  # s, stamp of the first frame
    last: float = 0.0  # s, stamp of the last frame
    due: float = -np.inf  # s, when the next grey view is kept
    colour_due: float = -np.inf  # s, when the next colour view is kept

    def add(self, frame: Frame) -> None:
        """Keep a frame if it is due."""
        self.first = frame.stamp if self.first is None else self.first
        self.last = frame.stamp
        image = frame.image
        if image.ndim == 3 and frame.stamp >= self.colour_due and len(self.colour) < _MAX_COLOUR_VIEWS:
            self.colour_due = frame.stamp + _VIEW_INTERVAL
            self.colour.append(image.copy())
        if frame.stamp < self.due or len(self.grey) >= _MAX_VIEWS:
            return
        self.due = frame.stamp + _VIEW_INTERVAL
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        self.grey.append((frame.stamp, grey))


@dataclass(frozen=True, slots=True)
class Solution:
    """Result of all passes."""

    rolled: RollingAdjustment
    tracked: TrackedRolling
    disc_angle: float  # rad, radius of the discs over the ball's, as seen
    views: Views
    seconds: float  # s, from the first frame to the last


Progress = Callable[[str, Iterator[Frame]], Iterator[Frame]]


def solve(
    footage: Footage,
    camera: InteriorOrientation,
    readout: tuple[float, float],
    disc_angle: Callable[[RollingAdjustment, Views], float | None],
    progress: Progress,
) -> Solution:
    """Return the ball's direction and size, its discs and its attitudes in a recording, from a known `camera`.

    `readout` is in s, with its standard deviation. `disc_angle` gets a first result and returns the discs' radius over
    the ball's, or None to take it from the images. `progress` wraps the frames of each pass. After three passes, the
    last result counts. Raises CalibrationError if the recording does not determine it.
    """
    views, settings, (rolled, tracked, rig) = _begin(footage, camera, readout, progress)
    assert views.first is not None
    given = disc_angle(rolled, views)
    rig = rig if given is None else replace(rig, disc_radius=given)
    for _ in range(3):
        before = rolled.rolling
        try:
            rolled, tracked, refined_rig = _adjusted(progress("tracking", footage(None)), rig, before, settings)
        except CalibrationError as e:
            if given is None:
                raise
            raise CalibrationError(
                f"{e}. If the ball did turn, check the lengths: they give {given:.3g} for a disc's radius over the "
                "ball's, and neither may be a diameter"
            ) from None
        rig = refined_rig if given is None else rig
        change = abs(np.log(rolled.rolling.ratio / before.ratio)) + np.linalg.norm(
            rolled.rolling.direction - before.direction
        )
        if change < _MAX_CHANGE:
            break
    return Solution(rolled, tracked, rig.disc_angle, views, views.last - views.first)


Adjusted = tuple[RollingAdjustment, TrackedRolling, Rig]  # the rig with the fitted size of the discs


def _begin(
    footage: Footage, camera: InteriorOrientation, readout: tuple[float, float], progress: Progress
) -> tuple[Views, Settings, Adjusted]:
    """Find and track the ball by dark discs, or else by light ones; of two failures raise the first.

    The dark ball between light discs may pass for dark discs until it is tracked.
    """
    failed: list[CalibrationError] = []
    for polarity, projection in PROJECTIONS.items():
        settings = Settings(discs=DiscSettings(polarity=polarity))
        try:
            views, found, seconds = _first_pass(footage, camera, progress, projection)
            _check_still(views, found, camera)
            rig = replace(start_rig(found, camera), readout_s=readout[0], readout_sigma_s=readout[1])
            return views, settings, _adjusted(progress("first tracking", footage(seconds)), rig, found, settings)
        except CalibrationError as e:
            failed.append(e)
    raise failed[0]


def _adjusted(frames: Iterator[Frame], rig: Rig, at: RollingStart | Rolling, settings: Settings) -> Adjusted:
    """Track the discs and adjust."""
    tracked = track_rolling(frames, rig, provisional_pose(at.direction, at.ratio), settings)
    rolled = adjust_rolling(tracked.sightings, tracked.rolling, rig.camera, rig.readout_sigma_s)
    return rolled, tracked, replace(rig, disc_radius=rig.disc_angle * tracked.size)


def _first_pass(
    footage: Footage, camera: InteriorOrientation, progress: Progress, projection: Projection
) -> tuple[Views, RollingStart, float | None]:
    """Read all frames once: keep views, and find a start in the first seconds, or in more if necessary."""
    views, spots = Views(), list[Spots]()
    found: RollingStart | None = None
    used, limit = 0.0, BLOCK
    failed: CalibrationError | None = None
    for frame in progress("looking for the ball", footage(None)):
        check_size(frame, camera)
        views.add(frame)
        assert views.first is not None
        if found is not None:
            continue
        spots.append(dark_spots(projected(frame.image, projection)))
        used = frame.stamp - views.first
        if used > limit:
            limit *= 2.0
            try:
                found = start(spots, camera)
            except CalibrationError as e:
                failed = e
    if views.first is None or views.last - views.first < _MIN_SECONDS:
        length = 0.0 if views.first is None else views.last - views.first
        raise CalibrationError(f"{length:.1f} s are too short: roll the ball for a minute; ten seconds are the least")
    if found is None:
        try:
            found = start(spots, camera)
        except CalibrationError as e:
            raise (failed or e) from None
    return views, found, used


def _check_still(views: Views, found: RollingStart, camera: InteriorOrientation) -> None:
    """Raise CalibrationError if the image of the room, outside of the ball, shifts."""
    rig, pose = start_rig(found, camera), provisional_pose(found.direction, found.ratio)
    size = max(3, round(0.03 * camera.width))
    outside = cv2.bitwise_not(cv2.dilate(ball_mask(rig, pose), np.ones((size, size), np.uint8)))
    (begin, reference), *later = views.grey
    places = cv2.goodFeaturesToTrack(reference, _MAX_FEATURES, 0.02, 0.015 * camera.width, mask=outside)
    if places is None or len(places) < 12:
        return
    for stamp, image in later:
        tracked, ok, _ = cv2.calcOpticalFlowPyrLK(reference, image, places, np.zeros_like(places))
        way = (tracked - places)[ok.ravel() > 0].reshape(-1, 2)
        if len(way) < 12:
            continue
        middle = np.median(way, axis=0)
        alike = np.mean(np.linalg.norm(way - middle, axis=1) < 0.3 * np.linalg.norm(middle) + 0.2)
        if np.linalg.norm(middle) > _MAX_SHIFT and alike > 0.5:
            raise CalibrationError(
                f"the camera was moved by {np.linalg.norm(middle):.1f} px within {stamp - begin:.1f} s: fix it, and "
                "roll again, or use the time before it with --seconds"
            )
