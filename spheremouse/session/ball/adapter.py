"""The tracker of the ball in its frame: search the targets until the camera's pose is known, then track every frame.

Another thread does any work that may take longer than a frame.
"""

import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from spheremouse.ball.build import begin, build, check_discs, detector_of, map_kind
from spheremouse.ball.camera_moved import shows_targets
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.events import CameraMoved
from spheremouse.ball.pose import Resection
from spheremouse.ball.rig import Rig
from spheremouse.ball.smooth import Observation, observe
from spheremouse.ball.state import Epoch, Tracker, Tracking, TrackState, current, lost
from spheremouse.ball.track import step, wants_colour, with_pose, with_settings
from spheremouse.errors import PoseError, SpheremouseError
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.output import Counts
from spheremouse.output.counts import Counter
from spheremouse.output.sample import Sample
from spheremouse.session import messages
from spheremouse.session.ball.map_keeper import MapKeeper, Newest
from spheremouse.session.ball.recorded import ball_subject, kept, sought
from spheremouse.session.ball.search import BallMessages, PoseRecovery, PoseSearch
from spheremouse.session.control.protocol import internal_error
from spheremouse.session.control.status import PoseStatus, TargetsStatus, TrackerStatus
from spheremouse.session.directions import of_ball
from spheremouse.session.offline import initialise
from spheremouse.session.overlay.annotations import of_discs, of_still, of_targets, plain
from spheremouse.session.overlay.drawing import picture_of
from spheremouse.session.run_config import RunConfig
from spheremouse.session.settings import Configuration
from spheremouse.session.tracker_adapter import (
    MAP,
    POSE,
    TARGETS,
    Do,
    FrameResult,
    LogMessages,
    Subject,
    TrackerAdapter,
    camera_scene,
    here,
)
from spheremouse.tracker import Estimate, Frame, Status, Step, check_size

_MIN_TARGETS = 3  # for a pose


class _Reinitialisation(NamedTuple):
    """A request to estimate the camera's pose again while the ball is tracked with the old one."""

    search: PoseSearch
    answer: Callable[[str | None, str], None]
    wanted: Callable[[], bool]


class BallAdapter(TrackerAdapter):
    """Tracker adapter of the ball in its frame, for one device and its settings."""

    def __init__(
        self,
        rig: Rig,
        settings: Configuration,
        keeper: MapKeeper | None,
        log: Callable[[str], None],
        do: Do = here,
        given: Rig | None = None,
    ) -> None:
        """Create the adapter, which tracks at once if the rig has the camera's pose.

        `keeper` saves the map of the ball; None saves none. `log` prints a line. `do` has another thread do work.
        `given` is the rig of the source, if it has one. Raises PoseError if the rig has neither the camera's pose nor
        three targets, or if the ball is not in view, and ConfigurationError if the ball has no discs.
        """
        check_discs(rig, settings)
        self.rig, self.settings, self._keeper, self._log = rig, settings, keeper, log
        self._do, self._given = do, given
        self.pose: Pose | None = None
        self.resection: Resection | None = None  # of the first pose
        self._posed = 0.0  # s, time.monotonic() when the pose was found
        self.state: TrackState | None = None
        self.waiting = "the ring targets are looked for"
        self.status = Status.SEARCHING
        self._messages = BallMessages(partial(do, TARGETS))
        self.untracked = 0  # frames before the first pose
        self._tracker: Tracker | None = None
        self._subject: Subject | None = None
        self.mapping = self._counter = Counter(settings.motion.matrix(rig.radius_m))
        self._estimate: Estimate | None = None  # of the last frame
        self._interval = 0.0  # s, between the last two frames
        self._still: tuple[Pose, dict[str, Any]] | None = None  # annotations that hold for this pose
        self._forget_views()
        self._reinitialisation: _Reinitialisation | None = None
        self._detected = 0.0
        if rig.pose is not None:
            self._set_camera_pose(rig.pose, "camera pose: from the rig file")
        elif len(rig.targets.codes) < _MIN_TARGETS:
            raise PoseError("the rig has fewer than three targets and no camera pose: calibrate the device first")

    @property
    def tracker(self) -> Tracker | None:
        """The tracker in use; None while the camera's pose is not known."""
        return self._tracker if self.state is None or self._tracker is None else current(self.state, self._tracker)

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

    def begin(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Take the camera's pose from the first frames with enough targets, and return the frames to track.

        Raises PoseError if no frames show enough targets.
        """
        reports = list[str]()
        start = initialise(frames, self.rig, self.settings, report=reports.append)
        self.untracked = start.passed
        for report in reports:
            self._log(f"views passed over: {report}")
        if start.resection is not None:
            self._set_camera_pose(start.pose, messages.standing(start.resection, self.rig), start.resection)
        if self.rig.scale_free:
            scale = self.settings.motion.scale(None)
            self._log(f"the rig's scale is free: {scale:g} counts per radian (motion.counts_per_radian)")
        return start.frames

    def _set_camera_pose(self, pose: Pose, text: str, resection: Resection | None = None) -> None:
        """Set the pose and its tracker, and log `text`. `resection` is the estimate from targets, if there was one.

        Raises PoseError if the ball is not in view.
        """
        self._tracker = build(self.rig, pose, self.settings)
        self.pose, self._posed, self.waiting, self.resection = pose, time.monotonic(), "", resection
        self._log(text)

    def wants_colour(self, stamp: float) -> bool:
        again = self._reinitialisation
        if self._tracker is None or (again is not None and again.search.wants_colour):
            return True
        return self.state is None or wants_colour(self.state, stamp)

    def follow(self, frame: Frame) -> FrameResult | None:
        """Track a frame. While the camera's pose is unknown, search the frame for targets instead, and return None.

        The frame that gives the pose is not tracked either. Raises SourceError if the frame has another size than the
        camera.
        """
        check_size(frame, self.rig.camera)
        if self._tracker is None:
            self._look_for_targets(frame)
            return None
        return self._track(frame, self._tracker)

    def observation(self, tracked: FrameResult) -> Observation | None:
        tracker, epoch = self.tracker, tracked.epoch
        if tracker is None or self.settings.tracker != "so3":
            return None
        return observe(epoch.estimate, epoch.state.filter, epoch.state.points, tracker.filter)

    def take_messages(self) -> LogMessages:
        return LogMessages(self._messages.take())

    def interrupted(self, reason: str) -> None:
        """Drop the work on past frames, since the camera may be moved meanwhile."""
        self._forget_views()
        self._cancel_reinitialisation(reason)

    def slept(self) -> None:
        """Have the ball recognised by its map, as after a gap in the stamps: their clock stood."""
        self.interrupted("the computer slept")
        if self.state is not None and isinstance(self.state.phase, Tracking):
            self.state = lost(self.state)

    def restart(self, reason: str) -> None:
        """Search the ball again, with the known camera pose. `reason` is the state in words until the ball is found."""
        self._tracker = self.tracker  # at the pose that a bumped camera was given since
        self.state, self.status = None, Status.SEARCHING
        self._messages.restart(reason)
        self._forget_views()

    def prepare(self, plan: RunConfig, changed: Collection[str]) -> Callable[[], TrackerAdapter]:
        """Prepare other settings, another map or another device. The result saves the map before it reads another."""
        settings = plan.configuration
        rig = plan.device(self._given) if "rig" in changed else self.rig
        mapped = not {"rig", "map"}.isdisjoint(changed)
        if "rig" in changed:
            BallAdapter(rig, settings, None, _discard)
        if mapped and plan.map_path is not None:
            MapKeeper(plan.map_path, rig, map_kind(rig, settings), _discard)
        state, tracker = self.state, self._tracker
        tuned = "tracker" in changed and "rig" not in changed
        if tuned and tracker is not None and state is not None:
            state, tracker = with_settings(state, tracker, settings)
        elif tuned and tracker is not None:
            tracker = build(self.rig, tracker.pose, settings)

        def apply() -> TrackerAdapter:
            if mapped:
                self.close()
                self._keeper = self._next_keeper(plan, rig)
            if "rig" in changed:
                self.interrupted("another rig is in use now")
                return BallAdapter(rig, settings, self._keeper, self._log, self._do, self._given)
            self.state, self._tracker, self._subject = state, tracker, None
            self.status = Status.SEARCHING if state is None else state.status
            if settings.tracker != self.settings.tracker:
                self._messages.restart("another filter begins")
            elif map_kind(rig, settings) != map_kind(rig, self.settings):
                self._messages.restart("another detector begins")
            self.settings = settings
            self._counter.matrix = settings.motion.matrix(self.rig.radius_m)
            if tuned:
                self._forget_views()
            return self

        return apply

    def reinitialise(self, answer: Callable[[str | None, str], None], wanted: Callable[[], bool]) -> None:
        if self._tracker is None:
            answer(None, f"the pose is being looked for: {self.waiting}")
        elif len(self.rig.targets.codes) < _MIN_TARGETS:
            answer("the rig has fewer than three targets: its camera pose is that of the rig file", "")
        elif self._reinitialisation is not None:
            answer("the camera's pose is being estimated already; wait for its end", "")
        else:
            search = PoseSearch(self.rig, self.settings, partial(self._do, POSE))
            self._reinitialisation = _Reinitialisation(search, answer, wanted)

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
            pose=self._pose_status(),
            targets=self._targets_status(),
        )

    def _centre_shift_mm(self) -> float | None:
        """Return how far the discs show the ball from its calibrated place; None before, or without a length."""
        if self.state is None or self.rig.scale_free:
            return None
        return 1e3 * float(np.linalg.norm(self.state.filter.centre))

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

    def annotations(self, tracked: FrameResult | None) -> dict[str, Any]:
        """Return the marks on the last frame as plain data. Before the pose is known, they are the targets found."""
        tracker, state, view = self.tracker, self.state, self._first_pose.view
        if tracker is None:
            found = {} if view is None else of_targets(view, self.rig.targets.codes)
            return plain(None, self.status, **found)
        if self._still is None or self._still[0] is not tracker.pose:
            self._still = tracker.pose, of_still(tracker.rig, tracker.pose)
        if tracked is None or state is None:
            return plain(None, self.status, **self._still[1])
        return plain(
            tracked.samples[0].sequence, self.status, **self._still[1], **of_discs(state, tracker, self._interval)
        )

    def picture(self, tracked: FrameResult, counts: Counts, everything: bool) -> Callable[[], Image]:
        tracker = self.tracker
        assert tracker is not None
        keep = None if everything else partial(kept, self.rig, tracker.pose, self.settings)
        return picture_of(tracked, self.annotations(tracked), counts, keep)

    def sight(self, frame: Frame, everything: bool) -> Callable[[], Image]:
        return partial(sought, frame.image.copy(), self.rig, self.settings, everything=everything)

    def failure(self, unused: str) -> SpheremouseError | None:
        why = self.waiting if self.untracked else unused or "the source gave no frame"
        return PoseError(why) if self.waiting else None

    def close(self) -> None:
        if self._keeper is not None:
            self._keeper.close()

    # ---- within ----

    def _next_keeper(self, plan: RunConfig, rig: Rig) -> MapKeeper | None:
        if plan.map_path is None:
            return None
        try:
            kind = map_kind(rig, plan.configuration)
            return MapKeeper(plan.map_path, rig, kind, self._log, elsewhere=partial(self._do, MAP))
        except SpheremouseError as e:
            self._log(f"map: {e}; going on without")
            return None

    def _pose_status(self) -> PoseStatus | None:
        pose = self.pose
        if pose is None:
            return None
        sigma = np.sqrt(np.maximum(np.diag(pose.covariance), 0.0))
        return PoseStatus(
            position_m=pose.position.tolist(),
            sigma_mm=(1e3 * sigma[:3]).tolist(),
            sigma_deg=np.degrees(sigma[3:]).tolist(),
            age_s=time.monotonic() - self._posed,
        )

    def _targets_status(self) -> TargetsStatus | None:
        if not self.waiting:
            return None
        seen, known = self._first_pose.seen, self.rig.targets.codes
        return TargetsStatus(
            seen=[c for c in known if c in seen],
            missing=[c for c in known if c not in seen],
            strangers=[c for c in seen if c not in known],
        )

    def _forget_views(self) -> None:
        """Drop the views of past frames, and the results of searches that run."""
        self._first_pose = PoseSearch(self.rig, self.settings, partial(self._do, TARGETS))
        self._recovery = PoseRecovery(partial(self._do, TARGETS))

    def _look_for_targets(self, frame: Frame) -> None:
        """Add a view. Once there are enough, set the pose, or `waiting` to the reason why it was not found."""
        self.untracked += 1
        try:
            found = self._first_pose.look(frame)
            if found is not None:
                self._set_camera_pose(found.pose, messages.standing(found, self.rig), found)
        except PoseError as e:
            self.waiting = str(e)

    def _track(self, frame: Frame, tracker: Tracker) -> FrameResult:
        known = None if self._keeper is None else self._keeper.known
        before = self.state or begin(tracker, frame.stamp, known=known)
        begun = self._detected = time.monotonic()
        found = None if self._reinitialisation is None else self._estimate_pose(frame, self._reinitialisation)
        sought = self._recovery.found(current(before, tracker))
        if found is not None and not shows_targets(frame, tracker, found.pose):
            self._cancel_reinitialisation("the targets are not where the frames before showed them")
            found = None
        if found is not None:
            made = self._with_pose(before, frame, tracker, found)
        elif sought is not None and shows_targets(frame, tracker, sought):
            made = with_pose(before, frame, tracker, sought)
        else:
            made = step(before, frame, tracker, self._note_detected, self._recovery)
        seconds = {"detect": self._detected - begun, "filter": time.monotonic() - self._detected}
        self._remember(made, frame, tracker)
        epoch = Epoch(frame, made.state, made.estimate, made.events, seconds)
        sample = Sample(made.estimate, events=tuple(event.name for event in made.events), camera=self.pose)
        return FrameResult(frame, (sample,), 0, seconds, epoch)

    def _note_detected(self) -> None:
        self._detected = time.monotonic()

    def _with_pose(self, state: TrackState, frame: Frame, tracker: Tracker, found: Resection) -> Step[TrackState]:
        """Return the step at the requested new pose `found`, or at the earlier one if the ball is not in view from it.

        The client gets its answer.
        """
        assert self._reinitialisation is not None
        try:
            made = with_pose(state, frame, tracker, found.pose)
        except PoseError as e:
            self._cancel_reinitialisation(str(e))
            return step(state, frame, tracker, self._note_detected, self._recovery)
        except Exception:
            self._cancel_reinitialisation("internal error")
            raise
        self._reinitialisation.answer(None, messages.standing(found, self.rig))
        self._reinitialisation = None
        asked = tuple(replace(e, asked=True) if isinstance(e, CameraMoved) else e for e in made.events)
        return made._replace(events=asked)

    def _estimate_pose(self, frame: Frame, again: _Reinitialisation) -> Resection | None:
        """Add a view for a requested estimate of the pose. Return the estimate once there is one, else None."""
        if not again.wanted():
            self._cancel_reinitialisation("given up: the client has disconnected")
            return None
        try:
            return again.search.look(frame)
        except SpheremouseError as e:
            self._cancel_reinitialisation(str(e))
        except Exception as e:
            self._cancel_reinitialisation(internal_error(e))
        return None

    def _cancel_reinitialisation(self, reason: str) -> None:
        again, self._reinitialisation = self._reinitialisation, None
        if again is not None:
            again.answer(f"{reason}; the pose before stays", "")

    def _remember(self, made: Step[TrackState], frame: Frame, tracker: Tracker) -> None:
        if self._estimate is not None:
            self._interval = made.estimate.stamp - self._estimate.stamp
        self.state, self.status, self._estimate = made.state, made.state.status, made.estimate
        tracker = current(made.state, tracker)
        self._messages.add(made, frame, tracker)
        pose = tracker.pose
        if pose is not self.pose:
            self.pose, self._posed = pose, time.monotonic()
        if self._keeper is not None:
            self._keeper.keep(Newest(partial(tracker.method.to_map, made.state), made.state.absolute))


def _discard(_: str) -> None:
    """Log nothing during a trial."""
