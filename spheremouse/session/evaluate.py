"""Run a tracker on a recording and compare it with the recording's truth, as `spheremouse evaluate` reports it."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.build import build
from spheremouse.ball.rig import Rig, in_axes, in_metres
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker
from spheremouse.ball.truth import Truth
from spheremouse.evaluation.metrics import report
from spheremouse.evaluation.run import History, Reference
from spheremouse.evaluation.wand import WandHistory, assign_truths, wand_report
from spheremouse.files.dataset.ball import Recording
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.wand import WandRecording
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, log
from spheremouse.session.offline import Known, initialise, merged, track, track_wand
from spheremouse.tracker import Frame
from spheremouse.wand.ball import WandBall
from spheremouse.wand.state import WandTracker

_OTHER_AXES = float(np.radians(10.0))  # no calibration is that wrong


class BallRun(NamedTuple):
    """Results of a tracker on the frames of a recording."""

    history: History
    tracker: Tracker[Any]
    found: Pose | None  # of the camera; None if the rig has it
    frames: int  # that were given, also those before the first that was tracked


class FurtherCamera(NamedTuple):
    """A further camera of the same ball."""

    frames: Iterator[Frame]
    rig: Rig
    turn: Array  # (3, 3) from the axes of this rig to those of the first one


def numbered_frames(recording: Recording, first: int = 0) -> Iterator[Frame]:
    """Yield the frames numbered as the rows of the truth: a live camera also counts the frames that it dropped."""
    return (replace(frame, sequence=i) for i, frame in enumerate(read_frames(recording), first))


def join(one: Recording, other: Recording) -> Recording:
    """Return the recording of two cameras: the truth of both, in the axes of the first, and no truth of pictures."""
    truth = None
    if one.truth is not None and other.truth is not None:
        both = one.truth, _rotate_truth(other.truth, other.turn)
        truth = Truth(*(np.concatenate([getattr(t, name) for t in both]) for name in ("stamp", "attitude", "rate")))
    return replace(one, truth=truth, discs=None, name=f"{one.name} and {other.name}")


def rig_of(recording: Recording, given: Rig | None) -> Rig:
    """Return the given rig in the unit of the truth, else that of the recording."""
    if given is None:
        return recording.rig
    if given.scale_free and not recording.rig.scale_free:  # the truth is in metres
        return in_metres(given, recording.rig.ball.radius / given.ball.radius)
    return given


def run_ball(
    frames: Iterator[Frame],
    rig: Rig,
    settings: Settings,
    known: BallMap | None = None,
    log: Callable[[str], None] = lambda _: None,
    others: Sequence[FurtherCamera] = (),
) -> BallRun:
    """Track frames, with a `known` map of the ball or without. `log` gets the problem of first views without a pose.

    Frames of `others` are merged by their stamps. Raises PoseError if no views show enough targets.
    """
    start = initialise(frames, rig, settings, report=log)
    history, tracker = History(), build(rig, start.pose, settings)
    starts = [initialise(other.frames, other.rig, settings, report=log) for other in others]
    placed = [in_axes(other.rig, its.pose, other.turn) for other, its in zip(others, starts, strict=True)]
    every = merged([start.frames, *(its.frames for its in starts)])
    for epoch in track(every, tracker, known, [build(*each, settings) for each in placed]):
        history.add(epoch)
    given = start.passed + sum(its.passed for its in starts) + len(history.epochs)
    return BallRun(history, tracker, None if start.resection is None else start.pose, given)


def ball_reports(run: BallRun, recording: Recording, smooth: bool = False) -> list[dict[str, Any]]:
    """Return the report of the filter, and with `smooth` that of the smoother, whose dataset ends in `, smoothed`."""
    discs = recording.discs if run.tracker.detector.sees_discs else None
    reference = Reference(_in_axes_of(run.tracker.rig, recording), discs, recording.pose, recording.truth_directions)
    histories = {"": run.history}
    if smooth:
        histories[", smoothed"] = run.history.smoothed(run.tracker)
    rig, same = run.tracker.rig, {"tracker": run.tracker.settings.tracker, "frames": run.frames, "found": run.found}
    return [
        report(history.run(), reference, rig, dataset=f"{recording.name}{suffix}", **same)
        for suffix, history in histories.items()
    ]


def _in_axes_of(rig: Rig, recording: Recording) -> Truth | None:
    """Return the truth of a recording in the axes of a rig with a camera pose, if they are others by its pose.

    Axes that differ by less than `_OTHER_AXES` are the same ones, with an error that counts.
    """
    truth = recording.truth
    if truth is None or rig.pose is None or recording.pose is None:
        return truth
    R = rig.pose.rotation @ recording.pose.rotation.T
    if np.linalg.norm(log(R)) < _OTHER_AXES:
        return truth
    return _rotate_truth(truth, R)


def _rotate_truth(truth: Truth, R: Array) -> Truth:
    return replace(truth, attitude=R @ truth.attitude, rate=truth.rate @ R.T)


def run_wand(frames: Iterable[Frame], tracker: WandTracker, seed: int = 1, known: Known | None = None) -> WandHistory:
    """Track frames of balls in a hand, with the `known` poses at the first frame or without."""
    history = WandHistory()
    for epoch in track_wand(frames, tracker, seed, known):
        history.add(epoch)
    return history


def wand_reports(
    recording: WandRecording, balls: Sequence[WandBall], histories: Sequence[WandHistory]
) -> dict[str, Any]:
    """Return the metrics of the first ball over all runs; those of the other balls are in its `more_balls`.

    `assign_truths` decides which filmed ball gives the truth for each tracked one.
    """
    runs = [[history.run(k) for k in range(len(balls))] for history in histories]
    truths = [assign_truths(each, balls, recording.truths, recording.balls) for each in runs]
    reports = []
    for k, ball in enumerate(balls):
        own = [truth for each in truths if (truth := each[k]) is not None]
        own = own if len(own) == len(runs) else None  # of a tracker with more balls than the film, one has no truth
        name = recording.name if k == 0 else f"{recording.name}, ball {k + 1}"
        of_ball = [run[k] for run in runs]
        reports.append(wand_report(of_ball, own, dataset=name, frames=recording.frames, radius=ball.radius))
    first, *more = reports
    return {**first, "more_balls": more} if more else first
