"""The tracker of the ball in its frame: search the targets until the camera's pose is known, then track every frame.

Another thread does any work that may take longer than a frame.
"""

import threading
import time
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.rings import detect_targets
from spheremouse.ball.events import CameraMoved
from spheremouse.ball.pose import Resection, find_pose
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Epoch, Tracker, TrackState, current
from spheremouse.ball.track import shows_targets, step, wants_colour, with_pose, with_settings
from spheremouse.errors import PoseError, SpheremouseError
from spheremouse.geometry.camera import Pose
from spheremouse.output import Output, open_output
from spheremouse.output.counts import Counter
from spheremouse.output.pointer import Counts
from spheremouse.session import messages
from spheremouse.session.ball.looking import FirstPose, PoseRecovery
from spheremouse.session.ball.map_keeper import MapKeeper
from spheremouse.session.ball.news import BallNews
from spheremouse.session.ball.subject import BallSubject, picture, sought
from spheremouse.session.directions import of_ball
from spheremouse.session.follower import MAP, POSE, TARGETS, Change, Do, FrameResult, LogMessages, TrackerAdapter, here
from spheremouse.session.plan import Plan
from spheremouse.session.process.threads import Work
from spheremouse.session.settings import Configuration
from spheremouse.tracker import Estimate, Frame, Status, Step, check_size


class BallFollower:
    """Frames in, motion out, for a device and its settings."""

    def __init__(
        self,
        rig: Rig,
        settings: Configuration,
        keeper: MapKeeper | None,
        say: Callable[[str], None],
        do: Do = here,
        given: Rig | None = None,
        outputs: tuple[Callable[[], Output], ...] = (),
    ) -> None:
        """`keeper` keeps the map of the discs; `given` is the device as the source knows it.

        Raises PoseError where the camera's pose is not known and will not be found.
        """
        self.rig, self.settings, self._keeper, self.say = rig, settings, keeper, say
        self._do, self._given, self.outputs = do, given, outputs
        self.pose: Pose | None = None
        self.resection: Resection | None = None  # that the first one is from
        self.posed = 0.0  # s, time.monotonic() when the pose was found
        self.state: TrackState | None = None
        self.waiting = "the ring targets are looked for"
        self._news = BallNews(partial(do, TARGETS))
        self.untracked = 0  # frames that came before the pose was known
        self._tracker: Tracker | None = None
        self._subject: BallSubject | None = None
        self._counter = Counter(settings.motion.matrix(rig.radius_m))
        self._estimate: Estimate | None = None  # of the last frame
        self._forget_views()
        self._anew: _Reinitialisation | None = None
        self._detected = 0.0
        if rig.pose is not None:
            self.stands(rig.pose, "camera pose: as the rig says")
        elif len(rig.targets.codes) < 3:
            raise PoseError("the rig has fewer than three targets and no camera pose: calibrate the device first")

    @property
    def tracker(self) -> Tracker | None:
        """The tracker in use; None while the camera's pose is not known."""
        return self._tracker if self.state is None or self._tracker is None else current(self.state, self._tracker)

    @property
    def status(self) -> Status:
        """Status of the tracker."""
        return Status.SEARCHING if self.state is None else self.state.status

    @property
    def reason(self) -> str:
        """State of the ball, in words."""
        return self._news.reason

    @property
    def subject(self) -> BallSubject | None:
        """The device as it is seen now; another one where the camera was moved."""
        tracker = self.tracker
        if tracker is None:
            return None
        if self._subject is None or self._subject.pose is not tracker.pose:
            self._subject = BallSubject(self.rig, tracker.pose, self.settings)
        return self._subject

    def stands(self, pose: Pose, text: str, resection: Resection | None = None) -> None:
        """The camera's pose is known, as `text` says: all is ready. Raises PoseError where the ball is not in view."""
        self._tracker = build(self.rig, pose, self.settings)
        self.pose, self.posed, self.waiting, self.resection = pose, time.monotonic(), "", resection
        self.say(text)

    def wants_colour(self, stamp: float) -> bool:
        """Return True if the targets may be searched in the frame of `stamp`."""
        if self._tracker is None or (self._anew is not None and self._anew.hungry):
            return True
        return self.state is None or wants_colour(self.state, stamp)

    def check(self, frame: Frame) -> None:
        """Raise SourceError where a frame has another size than the camera was calibrated for."""
        check_size(frame, self.rig.camera)

    def follow(self, frame: Frame) -> FrameResult | None:
        """Look for the targets until the camera's pose is known, then track."""
        if self._tracker is None:
            self._look_for_targets(frame)
            return None
        return self._track(frame, self._tracker)

    def take_news(self) -> LogMessages:
        """Return the log lines about the ball since the previous call."""
        return LogMessages(self._news.take())

    def interrupted(self, reason: str) -> None:
        """Drop the work on past frames, since the camera may be moved meanwhile."""
        self._forget_views()
        if self._anew is not None:
            self._anew.give_up(f"{reason}; the pose before stays")
            self._anew = None

    def restart(self, reason: str) -> None:
        """Search the ball again, with the known pose."""
        self.state = None
        self._news.restart(reason)
        self._forget_views()

    def prepare(self, plan: Plan, changed: Collection[str]) -> Change:
        """Other parameters, another map, or another device; the map is saved before another is read."""
        settings, quiet, outputs = plan.configuration, _unsaid, outputs_of(plan)
        rig = plan.device(self._given) if "rig" in changed else self.rig
        mapped = not {"rig", "map"}.isdisjoint(changed)
        if "rig" in changed:
            BallFollower(rig, settings, None, quiet)
        if mapped and plan.map_path is not None:
            MapKeeper(plan.map_path, rig, quiet)
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
                return BallFollower(rig, settings, self._keeper, self.say, self._do, self._given, outputs)
            self.state, self._tracker, self._subject, self.outputs = state, tracker, None, outputs
            if settings.tracker != self.settings.tracker:
                self._news.restart("another filter begins")
            self.settings = settings
            self._counter.matrix = settings.motion.matrix(self.rig.radius_m)
            if tuned:
                self._forget_views()
            return self

        return Change(outputs, apply)

    def reinitialise(self, answer: Callable[[str | None, str], None], wanted: Callable[[], bool]) -> None:
        """Estimate the camera's pose again while tracking continues with the old one."""
        if self._tracker is None:
            answer(None, f"the pose is being looked for: {self.waiting}")
        elif len(self.rig.targets.codes) < 3:
            answer("the rig has fewer than three targets: its camera pose is that of the rig file", "")
        elif self._anew is not None:
            answer("the camera's pose is being estimated already; wait for its end", "")
        else:
            self._anew = _Reinitialisation(self.rig, self.settings, answer, partial(self._do, POSE), wanted)

    def figures(self, seeing: bool) -> dict[str, Any]:
        """Return the discs and the camera's pose."""
        estimate = self._estimate
        found = {} if estimate is None else estimate.statistics
        tracking = seeing and self.status is Status.TRACKING
        return {
            "discs": found.get("discs_used", 0) if tracking else 0,
            "discs_seen": found.get("discs_seen", 0),
            "discs_known": found.get("discs_known", 0),
            "motion": of_ball(self.settings.motion).figures(estimate) if tracking and estimate is not None else None,
            "pose": self._pose_figures(),
            "targets": self._target_figures(),
            "balls": None,
        }

    def picture(self, tracked: FrameResult, counts: Counts, everything: bool) -> Callable[[], Image]:
        """The overlay of a frame, whose picture is copied; black but for ball and targets unless `everything`."""
        epoch, tracker = tracked.epoch, self._tracker
        assert isinstance(epoch, Epoch)
        assert tracker is not None
        epoch = replace(epoch, frame=replace(epoch.frame, image=epoch.frame.image.copy()))
        return lambda: picture(epoch, tracker, counts, everything=everything)

    def sight(self, frame: Frame, everything: bool) -> Callable[[], Image]:
        """Draw the targets in a copy of a frame; unless `everything`, the rest is coarse."""
        return partial(sought, frame.image.copy(), self.rig, self.settings, everything=everything)

    def failure(self, unused: str) -> SpheremouseError | None:
        """PoseError where the camera's pose was never found."""
        why = self.waiting if self.untracked else unused or "the source gave no frame"
        return PoseError(why) if self.waiting else None

    def last_words(self, failed: bool) -> tuple[str, ...]:
        """Nothing else."""
        return ()

    def close(self) -> None:
        """Save the map."""
        if self._keeper is not None:
            self._keeper.__exit__(None, None, None)

    # ---- within ----

    def _next_keeper(self, plan: Plan, rig: Rig) -> MapKeeper | None:
        if plan.map_path is None:
            return None
        try:
            return MapKeeper(plan.map_path, rig, self.say, elsewhere=partial(self._do, MAP))
        except SpheremouseError as e:
            self.say(f"map: {e}; going on without")
            return None

    def _pose_figures(self) -> dict[str, Any] | None:
        pose = self.pose
        if pose is None:
            return None
        sigma = np.sqrt(np.maximum(np.diag(pose.covariance), 0.0))
        return {
            "position_m": pose.position.tolist(),
            "sigma_mm": (1e3 * sigma[:3]).tolist(),
            "sigma_deg": np.degrees(sigma[3:]).tolist(),
            "age_s": time.monotonic() - self.posed,
        }

    def _target_figures(self) -> dict[str, Any] | None:
        if not self.waiting:
            return None
        seen, known = self._first_pose.seen, self.rig.targets.codes
        return {
            "seen": [c for c in known if c in seen],
            "missing": [c for c in known if c not in seen],
            "strangers": [c for c in seen if c not in known],
        }

    def _forget_views(self) -> None:
        """Drop the views of past frames."""
        self._first_pose = FirstPose(self.rig, self.settings, partial(self._do, TARGETS))
        self._seeker = PoseRecovery(partial(self._do, TARGETS))

    def _look_for_targets(self, frame: Frame) -> None:
        """One view more; the pose once there are enough, or why not."""
        self.untracked += 1
        try:
            found = self._first_pose.look(frame)
            if found is not None:
                self.stands(found.pose, messages.standing(found, self.rig), found)
        except PoseError as e:
            self.waiting = str(e)

    def _track(self, frame: Frame, tracker: Tracker) -> FrameResult:
        known = None if self._keeper is None else self._keeper.known
        before = self.state or begin(tracker, frame.stamp, known=known)
        begun = self._detected = time.monotonic()
        found = None if self._anew is None else self._anew.look(frame)
        sought = self._seeker.found(current(before, tracker))
        if found is not None:
            made = self._with_pose(before, frame, tracker, found)
        elif sought is not None and shows_targets(frame, tracker, sought):
            made = with_pose(before, frame, tracker, sought)
        else:
            made = step(before, frame, tracker, self._note_detected, self._seeker)
        seconds = {"detect": self._detected - begun, "filter": time.monotonic() - self._detected}
        self._remember(made, frame, tracker)
        epoch = Epoch(frame, made.state, made.estimate, made.events, seconds)
        return FrameResult(frame, self._counter.report(made.estimate), seconds, epoch)

    def _note_detected(self) -> None:
        self._detected = time.monotonic()

    def _with_pose(self, state: TrackState, frame: Frame, tracker: Tracker, found: Resection) -> Step[TrackState]:
        """Return the step at a new pose; at the earlier one if the new pose does not show the ball."""
        assert self._anew is not None
        anew, self._anew = self._anew, None
        try:
            made = with_pose(state, frame, tracker, found.pose)
        except PoseError as e:
            anew.give_up(f"{e}; the pose before stays")
            return step(state, frame, tracker, self._note_detected, self._seeker)
        except Exception:
            anew.give_up("internal error; the ball is looked for anew")
            raise
        anew.answer(None, messages.standing(found, self.rig))
        asked = tuple(replace(e, asked=True) if isinstance(e, CameraMoved) else e for e in made.events)
        return made._replace(events=asked)

    def _remember(self, made: Step[TrackState], frame: Frame, tracker: Tracker) -> None:
        self.state, self._estimate = made.state, made.estimate
        if self._anew is not None and self._anew.over:
            self._anew = None
        tracker = current(made.state, tracker)
        self._news.add(made, frame, tracker)
        pose = tracker.pose
        if pose is not self.pose:
            self.pose, self.posed = pose, time.monotonic()
        if self._keeper is not None:
            self._keeper.keep(made.state)


def outputs_of(plan: Plan) -> tuple[Callable[[], Output], ...]:
    """The one of the plan."""
    return (partial(open_output, plan.output),)


def _unsaid(_: str) -> None:
    """Log nothing for a trial."""


class _Reinitialisation:
    """Views for a pose, looked at in a thread of its own while the ball is tracked on."""

    def __init__(
        self,
        rig: Rig,
        settings: Settings,
        answer: Callable[[str | None, str], None],
        elsewhere: Callable[[Work], None],
        wanted: Callable[[], bool],
    ) -> None:
        self._rig, self._settings, self._answer = rig, settings, answer
        self._elsewhere, self._wanted = elsewhere, wanted
        self.over = False  # without a pose
        self._answering = threading.Lock()
        self._frames: list[Frame] = []
        self._looking = False
        self._found: Resection | None = None

    @property
    def hungry(self) -> bool:
        """True if another view in colour is needed."""
        return not self._looking

    def look(self, frame: Frame) -> Resection | None:
        """One view more, or what came of them."""
        if not self._wanted():
            self.give_up("given up: who asked has hung up; the pose before stays")
            return None
        if not self._looking:
            self._frames.append(replace(frame, image=frame.image.copy()))
            if len(self._frames) == self._settings.pose.frames:
                self._looking = True
                self._elsewhere(self._estimate)
        return self._found

    def answer(self, error: str | None, text: str) -> None:
        """Answer the request, once."""
        if self._answering.acquire(blocking=False):
            self._answer(error, text)

    def give_up(self, error: str) -> None:
        """There will be no pose."""
        self.over = True
        self.answer(error, "")

    def _estimate(self) -> Callable[[], None]:
        """Look at the views; what becomes of it, which is to be called when this is done."""
        try:
            if any(f.image.ndim != 3 for f in self._frames):
                raise PoseError("the frames are grey: the ring targets need colour")
            seen = [detect_targets(f.image, self._rig.targets.radii, self._settings.rings) for f in self._frames]
            found = find_pose(seen, self._rig, self._frames[0].image)
        except SpheremouseError as e:
            return partial(self.give_up, f"{e}; the pose before stays")
        except Exception as e:
            what = f"internal error ({type(e).__name__}: {' '.join(str(e).split())})"
            return partial(self.give_up, f"{what}; the pose before stays")
        return partial(setattr, self, "_found", found)
