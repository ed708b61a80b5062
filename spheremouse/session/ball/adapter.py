"""The tracker of the ball in its frame: search the targets until a camera's pose is known, then track every frame.

Another thread does any work that may take longer than a frame.
"""

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from spheremouse.ball.build import build, check_discs, detector_of, map_kind
from spheremouse.ball.camera_state import cameras_of, current_of, facing
from spheremouse.ball.cameras import begin_with, check_cameras, with_camera
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.pose import Resection
from spheremouse.ball.rig import Rig
from spheremouse.ball.smooth import Observation, observe
from spheremouse.ball.state import Epoch, Tracker, Tracking, TrackState, lost
from spheremouse.ball.track import wants_colour, with_settings
from spheremouse.errors import PoseError, SpheremouseError
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.output import Counts
from spheremouse.output.counts import Counter
from spheremouse.output.sample import Sample
from spheremouse.session import messages
from spheremouse.session.ball.camera import PosedCamera
from spheremouse.session.ball.map_keeper import MapKeeper, Newest, open_keeper
from spheremouse.session.ball.recorded import ball_subject, draw_target_search, recorded_mask
from spheremouse.session.ball.search import BallMessages
from spheremouse.session.control.status import PoseStatus, TrackerStatus
from spheremouse.session.directions import of_ball
from spheremouse.session.offline import initialise, merged
from spheremouse.session.overlay.annotations import of_discs, of_still, of_targets, plain
from spheremouse.session.overlay.drawing import picture_of
from spheremouse.session.run_config import RunConfig
from spheremouse.session.settings import Configuration
from spheremouse.session.tracker_adapter import (
    TARGETS,
    FrameResult,
    LogMessages,
    Subject,
    Submit,
    TrackerAdapter,
    camera_scene,
    here,
)
from spheremouse.tracker import Estimate, Frame, Status, Step, check_size


class BallAdapter(TrackerAdapter):
    """Tracker adapter of the ball in its frame, for its settings, and the rig of each camera."""

    def __init__(
        self,
        rigs: Sequence[Rig],
        settings: Configuration,
        keeper: MapKeeper | None,
        log: Callable[[str], None],
        submit: Submit = here,
        given: Sequence[Rig | None] = (None,),
    ) -> None:
        """Create the adapter, which tracks at once if a rig has the camera's pose.

        `rigs` are those of the cameras by their numbers, in the same axes. `keeper` saves the map of the ball; None
        saves none. `log` prints a line. `submit` has another thread do work. `given` are the sources' own rigs, if
        any. Raises PoseError if a rig has neither the camera's pose nor three targets, or if the ball is not in
        view, and ConfigurationError if the ball has no discs.
        """
        for rig in rigs:
            check_discs(rig, settings)
        check_cameras(rigs, settings)
        self.settings, self._keeper, self._log = settings, keeper, log
        self._submit, self._given = submit, given
        names = [f"camera {k + 1}: " if len(rigs) > 1 else "" for k in range(len(rigs))]
        self.cameras = tuple(
            PosedCamera(k, rig, settings, lambda text, name=name: log(name + text), submit)
            for k, (rig, name) in enumerate(zip(rigs, names, strict=True))
        )
        self._names, self._shown = names, self.cameras[0]  # the camera of the last frame
        self.state: TrackState | None = None
        self.status = Status.SEARCHING
        self._messages = BallMessages(partial(submit, TARGETS))
        self.untracked = 0  # frames before the first pose
        self._subject: Subject | None = None
        self.mapping = self._counter = Counter(settings.motion.matrix(self.rig.radius_m))
        self._estimate: Estimate | None = None  # of the last frame
        self._interval = 0.0  # s, between the last two frames
        self._still: tuple[Pose, dict[str, Any]] | None = None  # annotations that hold for this pose

    @property
    def rig(self) -> Rig:
        """The rig of the first camera."""
        return self.cameras[0].rig

    @property
    def pose(self) -> Pose | None:
        """The pose of the first camera; None while it is not known."""
        return self.cameras[0].pose

    @property
    def resection(self) -> Resection | None:
        """The first pose of the first camera, from its targets; None if the rig has it."""
        return self.cameras[0].resection

    @property
    def tracker(self) -> Tracker | None:
        """The tracker in use for the first camera; None while its pose is not known."""
        return self._tracker_of(self.cameras[0])

    def _tracker_of(self, camera: PosedCamera) -> Tracker | None:
        tracker, state = camera.tracker, self.state
        return tracker if tracker is None or state is None else current_of(state, camera.number, tracker)

    @property
    def waiting(self) -> str:
        return "" if any(camera.tracker is not None for camera in self.cameras) else self.cameras[0].waiting

    @property
    def reason(self) -> str:
        return self._messages.reason

    @property
    def camera(self) -> InteriorOrientation:
        return self.rig.camera

    @property
    def subject(self) -> Subject | None:
        """The device as the camera sees it now; None while the camera's pose is not known."""
        tracker = self.tracker
        if tracker is None:
            return None
        if self._subject is None or self._subject.view is not tracker.pose:
            self._subject = ball_subject(self.rig, tracker.pose, self.settings)
        return self._subject

    def begin(self, *frames: Iterator[Frame]) -> Iterator[Frame]:
        """Take each camera's pose from its first frames with enough targets, and return the frames to track.

        Raises PoseError if no frames show enough targets.
        """
        starts = list[Iterator[Frame]]()
        for camera, name, its_frames in zip(self.cameras, self._names, frames, strict=True):
            reports = list[str]()
            start = initialise(its_frames, camera.rig, self.settings, report=reports.append)
            self.untracked += start.passed
            for report in reports:
                self._log(f"{name}views passed over: {report}")
            if start.resection is not None:
                camera.set_pose(start.pose, messages.describe_camera_pose(start.resection, camera.rig), start.resection)
            starts.append(start.frames)
        if self.rig.scale_free:
            scale = self.settings.motion.scale(None)
            self._log(f"the rig's scale is free: {scale:g} counts per radian (motion.counts_per_radian)")
        return starts[0] if len(starts) == 1 else merged(starts)

    def wants_colour(self, stamp: float, camera: int = 0) -> bool:
        if self.cameras[camera].wants_colour or self.state is None:
            return True
        if self.state.camera != camera:
            if camera not in cameras_of(self.state):
                return True
            self.state = facing(self.state, camera)
        return wants_colour(self.state, stamp)

    def follow(self, frame: Frame) -> FrameResult | None:
        """Track a frame. While its camera's pose is unknown, search it for targets instead, and return None.

        The frame that gives the pose is not tracked either, and so is one that is older than the last one of another
        camera. Raises SourceError if the frame has another size than the camera.
        """
        camera = self._shown = self.cameras[frame.camera]
        check_size(frame, camera.rig.camera)
        if camera.tracker is None:
            self.untracked += 1
            camera.look_for_targets(frame)
            return None
        if self.state is not None and self.state.camera != frame.camera and camera.is_late(frame, self.state):
            return None
        return self._track(frame, camera, camera.tracker)

    def observation(self, result: FrameResult) -> Observation | None:
        tracker, epoch = self.tracker, result.epoch
        if tracker is None or self.settings.tracker != "so3":
            return None
        state, ambiguous = epoch.state, bool(epoch.state.alternatives)
        return observe(epoch.estimate, state.filter, state.points, tracker.filter, ambiguous)

    def take_messages(self) -> LogMessages:
        return LogMessages(self._messages.take())

    def interrupted(self, reason: str) -> None:
        """Drop the work on past frames, since the camera may be moved meanwhile."""
        for camera in self.cameras:
            camera.interrupted(reason)

    def slept(self) -> None:
        """Have the ball recognised by its map, as after a gap in the stamps: their clock stood."""
        self.interrupted("the computer slept")
        if self.state is not None and isinstance(self.state.phase, Tracking):
            self.state = lost(self.state)

    def restart(self, reason: str) -> None:
        """Search the ball again, with the known camera pose. `reason` is the state in words until the ball is found."""
        for camera in self.cameras:
            camera.tracker = self._tracker_of(camera)  # at the pose that a bumped camera was given since
            camera.forget_views()
        self.state, self.status = None, Status.SEARCHING
        self._messages.restart(reason)

    def prepare(self, plan: RunConfig, changed: Collection[str]) -> Callable[[], TrackerAdapter]:
        """Prepare other settings, another map or another device. The result saves the map before it reads another."""
        settings = plan.configuration
        rigs = plan.devices(self._given) if "rig" in changed else tuple(camera.rig for camera in self.cameras)
        mapped, rig = not {"rig", "map"}.isdisjoint(changed), rigs[0]
        if "rig" in changed:
            BallAdapter(rigs, settings, None, _discard)
        if mapped:
            open_keeper(plan, rig, _discard)
        tuned = "tracker" in changed and "rig" not in changed
        state, trackers = self._with_settings(settings) if tuned else (self.state, [c.tracker for c in self.cameras])

        def apply() -> TrackerAdapter:
            if mapped:
                self.close()
                self._keeper = self._next_keeper(plan, rig)
            if "rig" in changed:
                self.interrupted("another rig is in use now")
                return BallAdapter(rigs, settings, self._keeper, self._log, self._submit, self._given)
            self.state, self._subject = state, None
            self.status = Status.SEARCHING if state is None else state.status
            if settings.tracker != self.settings.tracker:
                self._messages.restart("another filter begins")
            elif map_kind(rig, settings) != map_kind(rig, self.settings):
                self._messages.restart("another detector begins")
            self.settings = settings
            self._counter.matrix = settings.motion.matrix(rig.radius_m)
            for camera, tracker in zip(self.cameras, trackers, strict=True):
                camera.tracker, camera.settings = tracker, settings
                if tuned:
                    camera.forget_views()
            return self

        return apply

    def _with_settings(self, settings: Configuration) -> tuple[TrackState | None, list[Tracker | None]]:
        """Return the state and the trackers of the cameras with other settings."""
        check_cameras([camera.rig for camera in self.cameras], settings)
        state, trackers = self.state, list[Tracker | None]()
        for camera in self.cameras:
            tracker = camera.tracker
            if tracker is not None and state is not None and camera.number in cameras_of(state):
                state, tracker = with_settings(facing(state, camera.number), tracker, settings)
            elif tracker is not None:
                tracker = build(camera.rig, tracker.pose, settings)
            trackers.append(tracker)
        return state, trackers

    def trouble_of(self, camera: int) -> str:
        return self.cameras[camera].trouble(self.state)

    def pose_of(self, camera: int) -> PoseStatus | None:
        return self.cameras[camera].pose_status()

    def reinitialise(self, answer: Callable[[str | None, str], None], wanted: Callable[[], bool]) -> None:
        asked = [camera for camera in self.cameras if camera.gives_frames] or [self.cameras[0]]
        answers = list[tuple[str | None, str]]()

        def collect(name: str, error: str | None, text: str) -> None:
            answers.append((error and name + error, name + text if text else ""))
            if len(answers) == len(asked):
                errors, texts = ([part for part in parts if part] for parts in zip(*answers, strict=True))
                answer("; ".join(errors) or None, "; ".join(texts))

        for camera in asked:
            camera.reinitialise(partial(collect, self._names[camera.number]), wanted)

    def tracker_status(self, seeing: bool) -> TrackerStatus:
        estimate = self._estimate
        found = {} if estimate is None else estimate.statistics
        tracking = seeing and self.status is Status.TRACKING
        return TrackerStatus(
            discs=int(found.get("discs_used", 0)) if tracking else 0,
            discs_seen=int(found.get("discs_seen", 0)),
            discs_known=int(found.get("discs_known", 0)),
            centre_shift_mm=self._centre_shift_mm(),
            motion=of_ball(self.settings.motion).motion(estimate) if tracking and estimate is not None else None,
            pose=self.pose_of(0),
            targets=self.cameras[0].targets_status() if self.waiting else None,
        )

    def _centre_shift_mm(self) -> float | None:
        """Return how far the discs show the ball from its calibrated place; None before, or without a length."""
        if self.state is None or self.rig.scale_free:
            return None
        return 1e3 * float(np.linalg.norm(self.state.filter.seen_rig[1:]))

    def scene(self) -> dict[str, Any]:
        """Return camera, ball, discs of the map and targets.

        The discs are None before the first tracked frame, and for a ball that is followed by something else.
        """
        rig, state, targets = self.rig, self.state, self.rig.targets
        known = state if detector_of(rig, self.settings).sees_discs else None
        discs = None if known is None else np.asarray(known.filter.discs, dtype=float).reshape(-1, 3).tolist()
        return {
            "camera": camera_scene(rig.camera, self.pose),
            "radius": rig.ball.radius,
            "discs": discs,
            "disc_radius": rig.disc_radius,
            "targets": [
                {"code": code, "position": position}
                for code, position in zip(targets.codes, targets.position.tolist(), strict=True)
            ],
            "balls": None,
        }

    def annotations(self, result: FrameResult | None) -> dict[str, Any]:
        """Return the marks on the last frame as plain data. Before the pose is known, they are the targets found."""
        camera = self._shown
        tracker, state, view = self._tracker_of(camera), self.state, camera.first_pose.view
        if tracker is None:
            found = {} if view is None else of_targets(view, camera.rig.targets.codes)
            return plain(None, self.status, **found)
        if self._still is None or self._still[0] is not tracker.pose:
            self._still = tracker.pose, of_still(tracker.rig, tracker.pose)
        if result is None or state is None:
            return plain(None, self.status, **self._still[1])
        return plain(
            result.samples[0].sequence, self.status, **self._still[1], **of_discs(state, tracker, self._interval)
        )

    def picture(self, result: FrameResult, counts: Counts, everything: bool) -> Callable[[], Image]:
        tracker = self._tracker_of(self._shown)
        assert tracker is not None
        keep = None if everything else partial(recorded_mask, tracker.rig, tracker.pose, self.settings)
        return picture_of(result, self.annotations(result), counts, keep)

    def sight(self, frame: Frame, everything: bool) -> Callable[[], Image]:
        return partial(draw_target_search, frame.image.copy(), self._shown.rig, self.settings, everything=everything)

    def failure(self, unused: str) -> SpheremouseError | None:
        why = self.waiting if self.untracked else unused or "the source gave no frame"
        return PoseError(why) if self.waiting else None

    def close(self) -> None:
        if self._keeper is not None:
            self._keeper.close()

    # ---- within ----

    def _next_keeper(self, plan: RunConfig, rig: Rig) -> MapKeeper | None:
        try:
            return open_keeper(plan, rig, self._log, self._submit)
        except SpheremouseError as e:
            self._log(f"map: {e}; going on without")
            return None

    def _track(self, frame: Frame, camera: PosedCamera, tracker: Tracker) -> FrameResult:
        state = self.state
        if state is None:
            known = None if self._keeper is None else self._keeper.known
            state = begin_with(tracker, camera.number, frame.stamp, known)
        elif state.camera != frame.camera:
            state = self._facing(state, camera, tracker)
        begun = time.monotonic()
        made = camera.step(state, frame)
        seconds = {"detect": camera.detected - begun, "filter": time.monotonic() - camera.detected}
        self._remember(made, frame, current_of(made.state, camera.number, tracker))
        epoch = Epoch(frame, made.state, made.estimate, made.events, seconds)
        sample = Sample(made.estimate, events=tuple(event.name for event in made.events), camera=camera.pose)
        return FrameResult(frame, (sample,), 0, seconds, epoch)

    def _facing(self, state: TrackState, camera: PosedCamera, tracker: Tracker) -> TrackState:
        """Return the state for a frame of another camera than the last, which may be its first frame."""
        if camera.number not in cameras_of(state):
            present = [self._tracker_of(self.cameras[number]) for number in cameras_of(state)]
            state = with_camera(state, tracker, [each for each in present if each is not None], camera.number)
        return facing(state, camera.number)

    def _remember(self, step: Step[TrackState], frame: Frame, tracker: Tracker) -> None:
        if self._estimate is not None:
            self._interval = step.estimate.stamp - self._estimate.stamp
        self.state, self.status, self._estimate = step.state, step.state.status, step.estimate
        self._messages.add(step, frame, tracker, self._names[frame.camera])
        if self._keeper is not None:
            self._keeper.keep(Newest(partial(tracker.method.to_map, step.state), step.state.absolute))


def _discard(_: str) -> None:
    """Log nothing during a trial."""
