"""What is done with each shot: decoded, the targets looked for until the camera's pose is known, then tracked.

One thread calls this; it waits for nothing. What others want to know of it are plain attributes.
"""

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from spheremouse.ball.build import begin, build, check_size
from spheremouse.ball.detect.rings import detect_targets
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.pose import Resection, describe, find_pose
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Epoch, Phase, Tracker, TrackState, current
from spheremouse.ball.track import posed_anew, retuned, shows_targets, step, wants_colour
from spheremouse.capture.newest import Arrival
from spheremouse.capture.owned import Owned
from spheremouse.errors import DamagedFrameError, PoseError, SourceError, SpheremouseError
from spheremouse.geometry.camera import Pose
from spheremouse.session.looking import Elsewhere, FirstPose, Seeker, at_once
from spheremouse.session.process.threads import Work
from spheremouse.session.timing import FrameTimes
from spheremouse.tracker import Frame, Motion

_FAULTS, _FAULTS_WITHIN = 5, 60.0  # errors of our own in so many s that end the process: it is begun anew from outside
_DAMAGED = 1.0  # s of nothing but damaged frames that are told
STAGES = ("wait", "decode", "detect", "filter")


@dataclass(frozen=True, slots=True)
class Step:
    """What a tracked frame gave, and when."""

    epoch: Epoch
    rate: tuple[float, float, float]  # counts/s of the three axes
    holds: bool  # its discs hold the attitude: the rate may be carried on


class Worker:
    """Frames in, motion out, for a device and its settings."""

    def __init__(
        self,
        rig: Rig,
        settings: Settings,
        known: DiscMap | None,
        say: Callable[[str], None],
        elsewhere: Elsewhere = at_once,
    ) -> None:
        """`elsewhere` has done by another thread what may take longer than a frame."""
        self.rig, self.settings, self._known, self._say = rig, settings, known, say
        self._elsewhere = elsewhere
        self.pose: Pose | None = None
        self.posed = 0.0  # s, time.monotonic() when the pose was found
        self.state: TrackState | None = None
        self.trouble = ""  # why no frame can be used
        self.targets = "the ring targets are looked for"  # why there is no pose; empty where there is one
        self.ball = ""  # what the tracker said last of the ball
        self.times = {name: FrameTimes() for name in STAGES}
        self.frames = 0  # tracked
        self.seen = 0  # worked on, whatever came of them
        self.damaged = 0
        self.lost = 0  # times
        self._tracker: Tracker | None = None
        self._forget_views()
        self._anew: _Reinitialisation | None = None
        self._own = Owned()
        self._faults: deque[float] = deque(maxlen=_FAULTS)
        self.good = time.monotonic()  # when a frame last could be used
        self._detected = 0.0
        self._event = ""
        if rig.pose is not None:
            self._stands(rig.pose, "camera pose: as the rig says")
        elif len(rig.targets.codes) < 3:
            raise PoseError("the rig has fewer than three targets and no camera pose: calibrate the device first")

    @property
    def tracker(self) -> Tracker | None:
        """The tracker in use."""
        return self._tracker if self.state is None or self._tracker is None else current(self.state, self._tracker)

    @property
    def phase(self) -> Phase:
        """What the tracker knows of the ball."""
        return Phase.SEARCHING if self.state is None else self.state.phase

    def work(self, arrival: Arrival, colour: bool = False) -> Step | None:
        """Do what there is to be done with a shot; in `colour`, whatever tracking wants.

        None where it was not tracked: damaged, of another size, or the camera's pose is not known yet. The frame of the
        step is good until the shot is released.
        """
        shot, begun = arrival.shot, time.monotonic()
        self.seen += 1
        try:
            frame = self._own(shot.frame(colour or self._in_colour(shot.stamp)))
            check_size(frame, self.rig)
            decoded = time.monotonic()
            self.trouble, self.good = "", decoded
            if self._tracker is None:
                self._look_for_targets(frame)
                return None
            made = self._track(frame, decoded)
            self.times["wait"].add(begun - arrival.taken, decoded)
            self.times["decode"].add(decoded - begun, decoded)
            return made
        except DamagedFrameError as e:
            self.damaged += 1
            if begun - self.good > _DAMAGED:
                self.trouble = f"nothing but damaged frames for {begun - self.good:.0f} s ({e})"
        except SourceError as e:
            self.trouble = str(e)
        except Exception:
            if self._too_many_faults(begun):
                raise
        return None

    def carry_on(self, before: "Worker") -> None:
        """Count on from where another one, for the device as it was, has ended."""
        self.times, self._faults = before.times, before._faults
        self.frames, self.seen, self.damaged, self.lost = before.frames, before.seen, before.damaged, before.lost

    def interrupted(self, reason: str) -> None:
        """No frames come: what has been begun with those before is void, for the camera may be moved meanwhile."""
        self._forget_views()
        if self._anew is not None:
            self._anew.give_up(f"{reason}; the pose before stays")
            self._anew = None

    def take_event(self) -> str:
        """What the tracker has said since this was last asked."""
        event, self._event = self._event, ""
        return event

    def retune(self, settings: Settings) -> None:
        """Other parameters from the next frame on. Raises PoseError where they cannot be used; then all stays."""
        if self._tracker is not None and self.state is not None:
            self.state, self._tracker = retuned(self.state, self._tracker, settings)
        elif self._tracker is not None:
            self._tracker = build(self.rig, self._tracker.pose, settings)
        if settings.tracker != self.settings.tracker:
            self.ball = "another filter begins"
        self.settings = settings
        self._forget_views()

    def reinitialise(
        self,
        answer: Callable[[str | None, str], None],
        elsewhere: Callable[[Work], None],
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        """Estimate the camera's pose anew while the ball is tracked on by the one before; `answer` (error, text).

        `elsewhere` has another thread do it, and call what that returns; it is given up when not `wanted` any more.
        """
        if self._tracker is None:
            answer(None, f"the pose is being looked for: {self.targets}")
        elif len(self.rig.targets.codes) < 3:
            answer("the rig has fewer than three targets: its camera pose is that of the rig file", "")
        elif self._anew is not None:
            answer("the camera's pose is being estimated already; wait for its end", "")
        else:
            self._anew = _Reinitialisation(self.rig, self.settings, answer, elsewhere, wanted)

    # ---- within ----

    def _in_colour(self, stamp: float) -> bool:
        if self._tracker is None or (self._anew is not None and self._anew.hungry):
            return True
        return self.state is None or wants_colour(self.state, stamp)

    def _forget_views(self) -> None:
        """What has been begun with the frames before says nothing of those to come."""
        self._first_pose = FirstPose(self.rig, self.settings, self._elsewhere)
        self._seeker = Seeker(self._elsewhere)

    def _look_for_targets(self, frame: Frame) -> None:
        """One view more; the pose once there are enough, or why not."""
        try:
            found = self._first_pose.look(frame)
            if found is not None:
                self._stands(found.pose, f"camera pose: {_in_a_line(found, self.rig)}")
        except PoseError as e:
            self.targets = str(e)

    def _stands(self, pose: Pose, text: str) -> None:
        self._tracker = build(self.rig, pose, self.settings)
        self.pose, self.posed, self.targets = pose, time.monotonic(), ""
        self._say(text)

    def _track(self, frame: Frame, begun: float) -> Step:
        assert self._tracker is not None
        before = self.state or begin(self._tracker, frame.stamp, known=self._known)
        self._detected = begun
        found = None if self._anew is None else self._anew.look(frame)
        sought = self._seeker.found(current(before, self._tracker))
        if found is not None:
            state, motion = self._with_pose(before, frame, found)
        elif sought is not None and shows_targets(frame, self._tracker, sought):
            state, motion = posed_anew(before, frame, self._tracker, sought)
        else:
            state, motion = step(before, frame, self._tracker, self._note_detected, self._seeker)
        done = time.monotonic()
        seconds = {"detect": self._detected - begun, "filter": done - self._detected}
        for name, time_taken in seconds.items():
            self.times[name].add(time_taken, done)
        self._remember(before, state)
        self.state = state
        self.frames += 1
        in_use = current(state, self._tracker)
        rate = in_use.counts @ motion.rate
        holds = state.phase is Phase.TRACKING and state.holds
        return Step(Epoch(frame, state, motion, seconds), (float(rate[0]), float(rate[1]), float(rate[2])), holds)

    def _note_detected(self) -> None:
        self._detected = time.monotonic()

    def _with_pose(self, state: TrackState, frame: Frame, found: Resection) -> tuple[TrackState, Motion]:
        """The frame with a pose estimated anew; with the one before where the ball would not be seen from there."""
        assert self._tracker is not None
        assert self._anew is not None
        anew, self._anew = self._anew, None
        try:
            new, motion = posed_anew(state, frame, self._tracker, found.pose)
        except PoseError as e:
            anew.give_up(f"{e}; the pose before stays")
            return step(state, frame, self._tracker, self._note_detected, self._seeker)
        except Exception:
            anew.give_up("internal error; the ball is looked for anew")
            raise
        anew.answer(None, f"camera pose: {_in_a_line(found, self.rig)}")
        return replace(new, event=new.event.removeprefix("the camera was moved: ")), motion

    def _remember(self, before: TrackState, state: TrackState) -> None:
        assert self._tracker is not None
        if self._anew is not None and self._anew.over:
            self._anew = None
        if state.event:
            self.ball = state.event.removeprefix("lost: ").removeprefix("tracking: ")
            self._event = state.event
        if state.phase is Phase.LOST and before.phase is not Phase.LOST:
            self.lost += 1
        pose = current(state, self._tracker).pose
        if pose is not self.pose:
            self.pose, self.posed = pose, time.monotonic()

    def _too_many_faults(self, now: float) -> bool:
        """An error of our own: told with its traceback, the ball looked for anew. Are there so many that we give up?"""
        self._say("internal error, please report it:\n" + traceback.format_exc().rstrip())
        self.state, self.ball = None, "an internal error; the ball is looked for anew"
        self._forget_views()
        self._faults.append(now)
        return len(self._faults) == _FAULTS and now - self._faults[0] < _FAULTS_WITHIN


def _in_a_line(found: Resection, rig: Rig) -> str:
    """What a log has room for: the targets and how well they fit."""
    return describe(found, rig).splitlines()[0]


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
        """Does it want another view, in colour?"""
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
        """Whoever asked is told, once."""
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
            found = find_pose(seen, self._rig, self._frames[0].image, self._settings.pose)
        except SpheremouseError as e:
            return partial(self.give_up, f"{e}; the pose before stays")
        except Exception as e:
            what = f"internal error ({type(e).__name__}: {' '.join(str(e).split())})"
            return partial(self.give_up, f"{what}; the pose before stays")
        return partial(setattr, self, "_found", found)
