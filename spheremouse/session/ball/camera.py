"""One camera of a run with a ball in its frame: its device, and the search for its pose."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from spheremouse.ball.build import build
from spheremouse.ball.camera_moved import shows_targets
from spheremouse.ball.camera_state import current_of, part_of
from spheremouse.ball.events import CameraMoved
from spheremouse.ball.pose import Resection
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.ball.track import step, with_pose
from spheremouse.errors import PoseError, SpheremouseError
from spheremouse.geometry.camera import Pose
from spheremouse.session import messages
from spheremouse.session.ball.search import PoseRecovery, PoseSearch
from spheremouse.session.control.protocol import internal_error
from spheremouse.session.control.status import PoseStatus, TargetsStatus
from spheremouse.session.tracker_adapter import POSE, TARGETS, Submit
from spheremouse.tracker import Frame, Status, Step

_MIN_TARGETS = 3  # for a pose
_MAX_MOVING_S = 1.0  # s of a moving camera that are not reported
_AGREEMENT_S = 2.0  # s; time constant of the share of a camera's points that are discs of the map
_MIN_AGREEMENT = 0.5  # share below which most points of a camera are no discs: it was moved, or its rig has other axes
_MIN_POINTS = 2  # of a frame that counts for it: fewer show a hand before the camera as well
_MAX_LATE = 30  # late frames in a row that are not reported


class _Reinitialisation(NamedTuple):
    """A request to estimate the camera's pose again while the ball is tracked with the old one."""

    search: PoseSearch
    answer: Callable[[str | None, str], None]
    wanted: Callable[[], bool]


class PosedCamera:
    """A camera with its rig and, once it is known, its pose and tracker. The worker's thread calls it."""

    def __init__(self, number: int, rig: Rig, settings: Settings, log: Callable[[str], None], submit: Submit) -> None:
        """Create the camera, whose frames have the `number`. If the rig has the camera's pose, it tracks at once.

        Raises PoseError if the rig has neither the camera's pose nor three targets, or if the ball is not in view.
        """
        self.number, self.rig, self.settings = number, rig, settings
        self._log, self._submit = log, submit
        self.pose: Pose | None = None
        self.resection: Resection | None = None  # of the first pose
        self._posed = 0.0  # s, time.monotonic() when the pose was found
        self.tracker: Tracker | None = None  # at the first pose; None while that is not known
        self.waiting = "the ring targets are looked for"  # reason why nothing can be tracked; empty if it can
        self.late_frames = 0  # in a row, that were older than those of another camera
        self.lag_s = 0.0  # s, by which the last one was
        self._seen_at = np.inf  # s, stamp of the last frame
        self._agreement = 1.0  # share of the points that are discs of the map, in the mean over the last frames
        self.detected = 0.0  # s, time.monotonic() at the end of the last detection
        self._reinitialisation: _Reinitialisation | None = None
        self.forget_views()
        if rig.pose is not None:
            self.set_pose(rig.pose, "camera pose: from the rig file")
        elif len(rig.targets.codes) < _MIN_TARGETS:
            raise PoseError("the rig has fewer than three targets and no camera pose: calibrate the device first")

    @property
    def wants_colour(self) -> bool:
        """True if a search for targets takes the next frame."""
        again = self._reinitialisation
        return self.tracker is None or (again is not None and again.search.wants_colour)

    def set_pose(self, pose: Pose, text: str, resection: Resection | None = None) -> None:
        """Set the pose and its tracker, and log `text`. `resection` is the estimate from targets, if there was one.

        Raises PoseError if the ball is not in view.
        """
        self.tracker = build(self.rig, pose, self.settings)
        self.pose, self._posed, self.waiting, self.resection = pose, time.monotonic(), "", resection
        self._log(text)

    def is_late(self, frame: Frame, state: TrackState) -> bool:
        """Return whether a frame is older than the last one of another camera, which `state` includes. Count it."""
        self.lag_s = state.filter.stamp - frame.stamp
        self.late_frames = self.late_frames + 1 if self.lag_s > 0.0 else 0
        return self.lag_s > 0.0

    def trouble(self, state: TrackState | None) -> str:
        """Return the reason why this camera takes no part in tracking; empty if there is none. Thread-safe."""
        if self.waiting:
            return self.waiting
        if self.late_frames > _MAX_LATE:
            lag = f"its frames are {1e3 * self.lag_s:.0f} ms older than those of the other camera"
            return f"{lag}: set both to the same mode"
        if state is None:
            return ""
        if self._agreement < _MIN_AGREEMENT and state.status is Status.TRACKING:
            problem = "its discs are not where the other camera has them"
            hint = "if it sees other targets than the other camera, run `spheremouse calibrate tie`"
            return f"{problem}: uncover its view; if it was moved, initialise it again; {hint}"
        part = part_of(state, self.number)
        moving_since = None if part is None or part.watch is None else part.watch.moving_since
        if part is not None and moving_since is not None and part.shown_at - moving_since > _MAX_MOVING_S:
            return "it was moved, and its new pose is not found: uncover its targets"
        return ""

    def look_for_targets(self, frame: Frame) -> None:
        """Add a view. Once there are enough, set the pose, or `waiting` to the reason why it was not found."""
        try:
            found = self.first_pose.look(frame)
            if found is not None:
                self.set_pose(found.pose, messages.describe_camera_pose(found, self.rig), found)
        except PoseError as e:
            self.waiting = str(e)

    def forget_views(self) -> None:
        """Drop the views of past frames, and the results of searches that run."""
        self.first_pose = PoseSearch(self.rig, self.settings, partial(self._submit, TARGETS))
        self._recovery = PoseRecovery(partial(self._submit, TARGETS))

    def interrupted(self, reason: str) -> None:
        """Drop the work on past frames, since the camera may be moved meanwhile."""
        self.forget_views()
        self._cancel(reason)

    def step(self, before: TrackState, frame: Frame) -> Step[TrackState]:
        """Track a frame of this camera, with a new pose if a search has found one."""
        assert self.tracker is not None
        tracker = self.tracker
        self.detected = time.monotonic()
        found = None if self._reinitialisation is None else self._estimate_pose(frame, self._reinitialisation)
        sought = self._recovery.found(current_of(before, self.number, tracker))
        if found is not None and not shows_targets(frame, tracker, found.pose):
            self._cancel("the targets are not where the frames before showed them")
            found = None
        if found is not None:
            made = self._with_pose(before, frame, tracker, found)
        elif sought is not None and shows_targets(frame, tracker, sought):
            made = with_pose(before, frame, tracker, sought)
        else:
            made = step(before, frame, tracker, self._note_detected, self._recovery)
        self._note_agreement(made, frame.stamp)
        pose = current_of(made.state, self.number, tracker).pose
        if pose is not self.pose:
            self.pose, self._posed = pose, time.monotonic()
        return made

    def reinitialise(self, answer: Callable[[str | None, str], None], wanted: Callable[[], bool]) -> None:
        """Estimate the pose again, as `TrackerAdapter.reinitialise`."""
        if self.tracker is None:
            answer(None, f"the pose is being looked for: {self.waiting}")
        elif len(self.rig.targets.codes) < _MIN_TARGETS:
            answer("the rig has fewer than three targets: its camera pose is that of the rig file", "")
        elif self._reinitialisation is not None:
            answer("the camera's pose is being estimated already; wait for its end", "")
        else:
            search = PoseSearch(self.rig, self.settings, partial(self._submit, POSE))
            self._reinitialisation = _Reinitialisation(search, answer, wanted)

    @property
    def gives_frames(self) -> bool:
        """True if a frame came just now."""
        return time.monotonic() - self.detected < _MAX_MOVING_S

    def pose_status(self) -> PoseStatus | None:
        """Return the pose for the status; None while it is not known."""
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

    def targets_status(self) -> TargetsStatus | None:
        """Return the targets for the status; None once the pose is known."""
        if not self.waiting:
            return None
        seen, known = self.first_pose.seen, self.rig.targets.codes
        return TargetsStatus(
            seen=[c for c in known if c in seen],
            missing=[c for c in known if c not in seen],
            strangers=[c for c in seen if c not in known],
        )

    # ---- within ----

    def _note_detected(self) -> None:
        self.detected = time.monotonic()

    def _note_agreement(self, step: Step[TrackState], stamp: float) -> None:
        """Update the share of the points that are discs of the map."""
        seen, used = (step.estimate.statistics[name] for name in ("discs_seen", "discs_used"))
        if seen >= _MIN_POINTS and step.state.status is Status.TRACKING:
            gain = min(max(stamp - self._seen_at, 0.0) / _AGREEMENT_S, 1.0)
            self._agreement += gain * (min(used / seen, 1.0) - self._agreement)
        self._seen_at = stamp

    def _with_pose(self, state: TrackState, frame: Frame, tracker: Tracker, found: Resection) -> Step[TrackState]:
        """Return the step at the requested new pose `found`, or at the earlier one if the ball is not in view from it.

        The client gets its answer.
        """
        assert self._reinitialisation is not None
        try:
            made = with_pose(state, frame, tracker, found.pose)
        except PoseError as e:
            self._cancel(str(e))
            return step(state, frame, tracker, self._note_detected, self._recovery)
        except Exception:
            self._cancel("internal error")
            raise
        self._reinitialisation.answer(None, messages.describe_camera_pose(found, self.rig))
        self._reinitialisation = None
        asked = tuple(replace(e, asked=True) if isinstance(e, CameraMoved) else e for e in made.events)
        return made._replace(events=asked)

    def _estimate_pose(self, frame: Frame, again: _Reinitialisation) -> Resection | None:
        """Add a view for a requested estimate of the pose. Return the estimate once there is one, else None."""
        if not again.wanted():
            self._cancel("given up: the client has disconnected")
            return None
        try:
            return again.search.look(frame)
        except SpheremouseError as e:
            self._cancel(str(e))
        except Exception as e:
            self._cancel(internal_error(e))
        return None

    def _cancel(self, reason: str) -> None:
        again, self._reinitialisation = self._reinitialisation, None
        if again is not None:
            again.answer(f"{reason}; the pose before stays", "")
