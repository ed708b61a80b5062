"""The tracker of hand-held balls, of which one moves the pointer."""

import time
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from spheremouse.errors import SourceError, SpheremouseError, format_count
from spheremouse.files.dataset.format import BALL_FILES
from spheremouse.files.dataset.wand import wand_scene
from spheremouse.files.wand import wand_text
from spheremouse.geometry.camera import InteriorOrientation, Pose, sphere_outline
from spheremouse.output import Counts
from spheremouse.output.sample import Sample
from spheremouse.output.wand_mapping import WandMapping
from spheremouse.session.control.status import BallStatus, TrackerStatus
from spheremouse.session.directions import of_hand
from spheremouse.session.offline import check_wand_frame
from spheremouse.session.overlay.annotations import of_balls, plain
from spheremouse.session.overlay.drawing import picture_of
from spheremouse.session.overlay.pen import Image, in_blocks
from spheremouse.session.run_config import RunConfig
from spheremouse.session.settings import Configuration, configuration_text
from spheremouse.session.tracker_adapter import FrameResult, LogMessages, Subject, TrackerAdapter, camera_scene
from spheremouse.session.wand.messages import WandMessages
from spheremouse.tracker import Estimate, Event, Frame, Status
from spheremouse.wand.axes import axes_of as six_axes
from spheremouse.wand.events import BallEvent, BallHidden
from spheremouse.wand.state import WandEpoch, WandPose, WandState, WandTracker
from spheremouse.wand.track import begin, step

Make = Callable[[RunConfig], WandTracker]
_SNAPSHOT_RADIUS_RADII = 1.25  # radii of the ball that a snapshot shows: as far as a pose may be off


class WandAdapter(TrackerAdapter):
    """Frames in, motion out, for balls and their settings."""

    def __init__(self, make: Make, plan: RunConfig, log: Callable[[str], None]) -> None:
        """`make` builds the tracker of a plan. Raises ConfigurationError."""
        self._make, self._log = make, log
        self.mapping = WandMapping(plan.configuration.wand.pointing)
        self._state: WandState | None = None
        self._poses: tuple[WandPose, ...] = ()
        self._estimate: Estimate | None = None  # of the last frame
        self._frames = 0
        self.status = Status.SEARCHING
        self.untracked = 0  # each frame is tracked
        self._set_tracker(plan, make(plan))
        self._messages = WandMessages(self.pointing_index, self.tracker.balls[self.pointing_index].name)

    def _set_tracker(self, plan: RunConfig, tracker: WandTracker) -> None:
        self.pointing_index = plan.configuration.wand.points - 1  # index of the ball that moves the pointer
        self._plan, self.tracker = plan, replace(tracker, points=self.pointing_index)
        self._subject = wand_subject(self.tracker, plan.configuration)

    @property
    def subject(self) -> Subject:
        return self._subject

    @property
    def camera(self) -> InteriorOrientation:
        return self.tracker.camera

    @property
    def reason(self) -> str:
        return self._messages.reason

    def introduce(self) -> None:
        """Log the balls that are searched."""
        balls = (f"ball: {b.name}, {2e3 * b.radius:g} mm across, {len(b.discs)} discs" for b in self.tracker.balls)
        self._log("\n".join(balls))

    def wants_colour(self, stamp: float, camera: int = 0) -> bool:
        """Return True: the balls are searched by their colours."""
        return True

    def follow(self, frame: Frame) -> FrameResult:
        check_wand_frame(frame, self.tracker)
        begun = time.perf_counter()
        state = self._state or begin(self.tracker, 0, frame.stamp)
        self._state, self._estimate, events = step(state, frame, self.tracker)
        self._poses = self._state.poses
        epoch = WandEpoch(frame, self._state, self._estimate, time.perf_counter() - begun)
        samples = self._samples(self._state.estimates, events)
        self._frames += 1
        self.status = self._poses[self.pointing_index].phase
        self._messages.add(frame.stamp, self._poses, frame.image)
        return FrameResult(frame, samples, self.pointing_index, {"track": epoch.seconds}, epoch)

    def _samples(self, estimates: tuple[Estimate, ...], events: tuple[Event, ...]) -> tuple[Sample, ...]:
        """Return a sample for each ball, with its events; those of no ball go with the one that points."""
        names = [ball.name for ball in self.tracker.balls]
        of = [names.index(e.ball) if isinstance(e, BallEvent) else self.pointing_index for e in events]
        return tuple(
            Sample(estimate, k + 1, name, "cam", tuple(e.name for e, ball in zip(events, of, strict=True) if ball == k))
            for k, (estimate, name) in enumerate(zip(estimates, names, strict=True))
        )

    def take_messages(self) -> LogMessages:
        return self._messages.take()

    def interrupted(self, reason: str) -> None:
        """Count no motion to the place where the ball is seen next."""
        self.mapping.interrupted()
        self._messages.interrupted()

    def slept(self) -> None:
        self.interrupted("the computer slept")

    def restart(self, reason: str) -> None:
        self._state, self._poses, self.status = None, (), Status.SEARCHING
        self.mapping.interrupted()
        self._messages.reason = reason

    def prepare(self, plan: RunConfig, changed: Collection[str]) -> Callable[[], TrackerAdapter]:
        """Prepare another plan. Return the function that applies it and returns the adapter to use.

        That is this one, whose balls stay tracked, or after a change of `balls` or `rig` a new one, which searches.
        """
        if {"balls", "rig"} & set(changed):
            other = WandAdapter(self._make, plan, self._log)

            def begin_other() -> TrackerAdapter:
                other.introduce()
                return other

            return begin_other
        tracker = self._make(plan) if "tracker" in changed else self.tracker

        def apply() -> TrackerAdapter:
            """Use the plan from the next frame on; the balls stay tracked."""
            old_index = self.pointing_index
            self._set_tracker(plan, tracker)
            if "motion" in changed or self.pointing_index != old_index:
                self.mapping = WandMapping(plan.configuration.wand.pointing)
            if self.pointing_index != old_index:
                self._messages = WandMessages(self.pointing_index, tracker.balls[self.pointing_index].name)
                self.status = self._poses[self.pointing_index].phase if self._poses else Status.SEARCHING
            return self

        return apply

    def reinitialise(self, answer: Callable[[str | None, str], None], wanted: Callable[[], bool]) -> None:
        """Search for all balls again with the next frame, in case the tracker follows something else."""
        self.restart("searched again, as requested")
        names = " and ".join(ball.name for ball in self.tracker.balls)
        answer(None, f"{names}: searched again")

    def tracker_status(self, seeing: bool) -> TrackerStatus:
        poses, estimate, motion = self._poses, self._estimate, None
        if seeing and estimate is not None and self.status is Status.TRACKING:
            motion = of_hand(self._plan.configuration.wand.pointing).motion(estimate)
        if not seeing or not poses:
            poses = tuple(WandPose.unknown(b.name, Status.SEARCHING, event=None) for b in self.tracker.balls)
        balls = [_ball_status(pose) for pose in poses]
        return TrackerStatus(motion=motion, balls=balls)

    def scene(self) -> dict[str, Any]:
        """Return the camera at the origin of `cam`, the ball that points with its discs, and the names of all balls."""
        ball = self.tracker.balls[self.pointing_index]
        return {
            "camera": camera_scene(self.tracker.camera, Pose(np.eye(3), np.zeros(3))),
            "radius": ball.radius,
            "discs": [disc.direction.tolist() for disc in ball.discs],
            "disc_radius": ball.radius * ball.discs[0].angle if ball.discs else None,
            "targets": [],
            "balls": [b.name for b in self.tracker.balls],
        }

    def annotations(self, result: FrameResult | None) -> dict[str, Any]:
        if result is None:
            return plain(None, self.status)
        balls = zip(self.tracker.balls, result.epoch.poses, strict=True)
        marks = of_balls(balls, self.pointing_index, self.tracker.camera)
        return plain(result.samples[0].sequence, self.status, **marks)

    def picture(self, result: FrameResult, counts: Counts, everything: bool) -> Callable[[], Image]:
        keep = None if everything else partial(_around_balls, result.epoch.poses, self.tracker)
        return picture_of(result, self.annotations(result), counts, keep)

    def sight(self, frame: Frame, everything: bool) -> Callable[[], Image]:
        image = frame.image.copy()
        return lambda: image if everything else in_blocks(image, np.zeros(image.shape[:2], np.uint8))

    def failure(self, unused: str) -> SpheremouseError | None:
        if self.pointing_index in self._messages.found:
            return None
        frames = format_count(self._frames, "frame")
        reason = f"{self._messages.why} (looked for in {frames})" if self._frames else unused or "gave no frame"
        return SourceError(f"{self._plan.source}: {reason}")

    def final_messages(self, failed: bool) -> tuple[str, ...]:
        return self._messages.never_found(but=self.pointing_index if failed else None)


def wand_subject(tracker: WandTracker, settings: Configuration) -> Subject:
    """Return the subject of a recording: the camera, the balls, and whole pictures, since all of each is searched."""
    camera = tracker.camera

    def files() -> dict[str, str]:
        """Return a wand file of each ball, and the configuration that names them."""
        balls = {
            name: wand_text(ball, {c: tracker.colours[c] for c in ball.colours})
            for name, ball in zip(BALL_FILES, tracker.balls, strict=False)
        }
        wand = replace(settings.wand, balls=tuple(balls))
        return {**balls, "config.yaml": configuration_text(settings, wand=wand)}

    return Subject(
        camera=camera,
        view=camera,
        parts="",
        kept=lambda: np.full((camera.height, camera.width), 255, dtype=np.uint8),
        scene=lambda: wand_scene(camera, tracker.balls),
        files=files,
    )


def _is_hidden(pose: WandPose) -> bool:
    """Return whether the picture does not show a tracked ball. A picture that comes again shows it."""
    return isinstance(pose.event, BallHidden)


def _around_balls(poses: tuple[WandPose, ...], tracker: WandTracker) -> Image:
    """Return a mask, (h, w), that is 255 on the balls seen and close around them."""
    keep = np.zeros((tracker.camera.height, tracker.camera.width), dtype=np.uint8)
    for ball, pose in zip(tracker.balls, poses, strict=True):
        if (
            not _is_hidden(pose)
            and pose.position is not None
            and pose.position[2] > _SNAPSHOT_RADIUS_RADII * ball.radius
        ):
            around = sphere_outline(pose.position, _SNAPSHOT_RADIUS_RADII * ball.radius, tracker.camera)
            cv2.fillPoly(keep, [np.rint(around[np.isfinite(around).all(axis=1)]).astype(np.int32)], 255)
    return keep


def _ball_status(pose: WandPose) -> BallStatus:
    state, axes = "hidden" if _is_hidden(pose) else str(pose.phase), None
    if pose.position is not None and pose.rotation is not None and pose.covariance is not None:
        axes = six_axes(pose.position, pose.rotation, pose.covariance)
    return BallStatus(
        name=pose.name,
        state=state,
        position_m=None if axes is None else axes.position.tolist(),
        angles_deg=None if axes is None else np.degrees(axes.angles).tolist(),
        sigma_mm=None if axes is None else (1e3 * axes.position_sigma).tolist(),
        sigma_deg=None if axes is None else np.degrees(axes.angles_sigma).tolist(),
    )
