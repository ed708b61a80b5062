"""Hand-held balls at work: each frame tracked, the pointer moved by one of them, all of their axes as text."""

import time
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse.errors import ConfigurationError, SourceError, SpheremouseError
from spheremouse.output import Output, open_output
from spheremouse.output.axes import PoseLog
from spheremouse.output.pointer import Counts
from spheremouse.output.wand_mapping import WandMapping
from spheremouse.session.directions import of_hand
from spheremouse.session.follower import Change, FrameResult, LogMessages, TrackerAdapter
from spheremouse.session.overlay.pen import Image, in_blocks
from spheremouse.session.plan import Plan
from spheremouse.session.wand.messages import Told
from spheremouse.session.wand.offline import check_wand_frame
from spheremouse.session.wand.subject import WandSubject, picture
from spheremouse.tracker import Estimate, Frame, Status
from spheremouse.wand.axes import axes_of as six_axes
from spheremouse.wand.state import WandEpoch, WandPose, WandState, WandTracker
from spheremouse.wand.track import begin, step

Make = Callable[[Plan], WandTracker]


class WandFollower:
    """Frames in, motion out, for balls and their settings."""

    def __init__(
        self, make: Make, plan: Plan, say: Callable[[str], None], axes: tuple[PoseLog, ...] | None = None
    ) -> None:
        """`make` gives the tracker that a plan asks for, `axes` are those that go on. Raises ConfigurationError."""
        self._make, self._say = make, say
        self._hand = WandMapping(plan.configuration.wand.pointing)
        self._state: WandState | None = None
        self._poses: tuple[WandPose, ...] = ()
        self._estimate: Estimate | None = None  # of the last frame
        self._frames = 0
        self._change, self._more = "", list[str]()
        self.waiting = ""
        self.status = Status.SEARCHING
        self.untracked = 0  # each is
        self._take_on(plan, make(plan), axes_of(plan) if axes is None else axes)
        self._told = Told(self.points, self.tracker.balls[self.points].name)

    def _take_on(self, plan: Plan, tracker: WandTracker, axes: tuple[PoseLog, ...]) -> None:
        self.points = plan.configuration.wand.points - 1  # index of the ball that moves the pointer
        self._plan, self.tracker, self._axes = plan, replace(tracker, points=self.points), axes
        self.subject = WandSubject(self.tracker, plan.configuration)

    @property
    def reason(self) -> str:
        """State of the ball that points."""
        return self._told.reason

    @property
    def outputs(self) -> tuple[Callable[[], Output], ...]:
        """The pointer's, and the axes' where they go elsewhere: text outputs get the axes with the counts."""
        return outputs_of(self._plan, self._axes)

    def introduce(self) -> None:
        """Say which balls are looked for."""
        balls = (f"ball: {b.name}, {2e3 * b.radius:g} mm across, {len(b.discs)} discs" for b in self.tracker.balls)
        self._say("\n".join(balls))

    def wants_colour(self, stamp: float) -> bool:
        """Always: it is colours that are looked for."""
        return True

    def check(self, frame: Frame) -> None:
        """Raise SourceError where a frame has another size than the camera's, or no colour."""
        check_wand_frame(frame, self.tracker)

    def follow(self, frame: Frame) -> FrameResult:
        """Track the balls."""
        begun = time.perf_counter()
        state = self._state or begin(self.tracker, 0, frame.stamp)
        self._state, self._estimate, _ = step(state, frame, self.tracker)
        self._poses = self._state.poses
        epoch = WandEpoch(frame, self._state, self._estimate, time.perf_counter() - begun)
        report = self._hand.report(self._estimate)
        for axes in self._axes:
            axes.push(frame.stamp, self._poses, self.points)
        self._frames += 1
        self.status = self._poses[self.points].phase
        news = self._told.frame(frame.stamp, self._poses, frame.image)
        self._change = news.change or self._change
        self._more += news.more
        return FrameResult(frame, report, {"track": epoch.seconds}, epoch)

    def take_news(self) -> LogMessages:
        """Return the log lines since the previous call."""
        news = LogMessages(self._change, tuple(self._more))
        self._change = ""
        self._more.clear()
        return news

    def interrupted(self, reason: str) -> None:
        """Nothing moves to where the ball is next seen."""
        self._hand.interrupted()
        self._told.interrupted()

    def restart(self, reason: str) -> None:
        """Search for all balls again."""
        self._state, self._poses, self.status = None, (), Status.SEARCHING
        self._hand.interrupted()
        self._told.reason = reason

    def prepare(self, plan: Plan, changed: Collection[str]) -> Change:
        """Prepare other parameters, with the balls tracked on; with other balls or another camera, search again."""
        axes = axes_of(plan) if {"output", "axes"} & set(changed) else self._axes
        if {"balls", "rig"} & set(changed):
            other = WandFollower(self._make, plan, self._say, axes)

            def begin_other() -> TrackerAdapter:
                other.introduce()
                return other

            return Change(other.outputs, begin_other)
        tracker = self._make(plan) if "tracker" in changed else self.tracker

        def apply() -> TrackerAdapter:
            before = self.points
            self._take_on(plan, tracker, axes)
            if "motion" in changed or self.points != before:
                self._hand = WandMapping(plan.configuration.wand.pointing)
            if self.points != before:
                self._told = Told(self.points, tracker.balls[self.points].name)
                self.status = self._poses[self.points].phase if self._poses else Status.SEARCHING
            return self

        return Change(outputs_of(plan, axes), apply)

    def reinitialise(self, answer: Callable[[str | None, str], None], wanted: Callable[[], bool]) -> None:
        """Search for all balls again with the next frame, in case the tracker follows something else."""
        self.restart("looked for anew, as asked")
        names = " and ".join(ball.name for ball in self.tracker.balls)
        answer(None, f"{names}: looked for anew")

    def figures(self, seeing: bool) -> dict[str, Any]:
        """Return the pose of each ball, and the motion of the one that points."""
        none, poses = dict.fromkeys(("discs", "discs_seen", "discs_known", "pose", "targets", "motion")), self._poses
        estimate = self._estimate
        if seeing and estimate is not None and self.status is Status.TRACKING:
            none["motion"] = of_hand(self._plan.configuration.wand.pointing).figures(estimate)
        if not seeing or not poses:
            poses = tuple(WandPose(b.name, None, None, None, Status.SEARCHING, None) for b in self.tracker.balls)
        return {**none, "balls": [_figures(pose) for pose in poses]}

    def picture(self, tracked: FrameResult, counts: Counts, everything: bool) -> Callable[[], Image]:
        """The overlay of a frame, whose picture is copied; black but about the balls unless `everything`."""
        epoch, tracker = tracked.epoch, self.tracker
        assert isinstance(epoch, WandEpoch)
        image = epoch.frame.image.copy()
        return lambda: picture(epoch, image, tracker, self.points, counts, everything=everything)

    def sight(self, frame: Frame, everything: bool) -> Callable[[], Image]:
        """A frame that cannot be used, whose picture is copied; coarse unless `everything`."""
        image = frame.image.copy()
        return lambda: image if everything else in_blocks(image, np.zeros(image.shape[:2], np.uint8))

    def failure(self, unused: str) -> SpheremouseError | None:
        """SourceError where the ball that points was never seen."""
        if self.points in self._told.found:
            return None
        frames = f"{self._frames} frame{'' if self._frames == 1 else 's'}"
        why = f"{self._told.why} (looked for in {frames})" if self._frames else unused or "gave no frame"
        return SourceError(f"{self._plan.source}: {why}")

    def last_words(self, failed: bool) -> tuple[str, ...]:
        """Return a line for each ball never seen, except the pointing one if the failure names it."""
        return self._told.never_found(but=self.points if failed else None)

    def close(self) -> None:
        """Nothing is learnt of balls."""


def axes_of(plan: Plan) -> tuple[PoseLog, ...]:
    """Return the destinations of a plan's axes. ConfigurationError if one occurs twice."""
    kind, _, argument = plan.output.partition(":")
    places = [argument] if kind == "text" else []
    further = plan.configuration.wand.axes
    if further is not None:
        if places and _place(argument) == _place(further):
            raise ConfigurationError(f"--axes {further}: is the output already, which has the axes; leave it out")
        places.append(further)
    return tuple(map(PoseLog, places))


def outputs_of(plan: Plan, axes: tuple[PoseLog, ...]) -> tuple[Callable[[], Output], ...]:
    """Return functions that open the pointer's output and those of the axes. A text output carries both."""
    opened = [a.open for a in axes]
    return tuple(opened) if plan.output.partition(":")[0] == "text" else (partial(open_output, plan.output), *opened)


def _place(argument: str) -> str:
    return "-" if argument in ("", "-") else str(Path(argument).absolute())


def _figures(pose: WandPose) -> dict[str, Any]:
    """A ball as a status has it; the pose null where it is not known."""
    known: dict[str, Any] = dict.fromkeys(("position_m", "angles_deg", "sigma_mm", "sigma_deg"))
    if pose.position is not None and pose.rotation is not None and pose.covariance is not None:
        axes = six_axes(pose.position, pose.rotation, pose.covariance)
        known = {
            "position_m": axes.position.tolist(),
            "angles_deg": np.degrees(axes.angles).tolist(),
            "sigma_mm": (1e3 * axes.position_sigma).tolist(),
            "sigma_deg": np.degrees(axes.angles_sigma).tolist(),
        }
    hidden = pose.phase is Status.TRACKING and not pose.seen
    return {"name": pose.name, "state": "hidden" if hidden else str(pose.phase), **known}
