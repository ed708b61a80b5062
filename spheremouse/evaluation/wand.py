"""Compute the metrics of `evaluate --tracker wand` from runs of the particle filter and the truth of a recording.

Errors are over the frames with a pose, in the camera's axes: that of the centre, and the angle of the rotation
R_est R_true^T. A value that run or recording cannot give is None. The experiments compare them with Grzonka 2005,
chapter 4.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from spheremouse.evaluation.metrics import frame_times, mean_nees, nees
from spheremouse.evaluation.run import number
from spheremouse.geometry.rotation import Array, log
from spheremouse.geometry.statistics import gate
from spheremouse.tracker import Event
from spheremouse.wand.ball import WandBall, WandTruth
from spheremouse.wand.state import WandEpoch, WandPose

# Beside the ball, or another side of it taken for this one (the pattern repeats after 90 degrees, but for its colours)
OFF_ANGLE = np.radians(45.0)
MAX_RECOVERY_S = 1.0  # s: maximum time to recover from a distractor
_MIN_RECOVERY_FRAMES = 2  # frames, where a second is less than that
_MAX_DIFFERENCE_OF_SAME_BALL = 1e-5  # m and rad by which one ball's descriptions differ, which files round
# m: an arm's length and more is another ball
_MAX_DISTANCE_M, _FORBIDDEN_DISTANCE_M = (1.0, 1e6)


@dataclass(frozen=True, slots=True)
class WandRun:
    """Results of a tracker for one ball, one entry per frame that it was given; nan in frames without a pose."""

    stamp: Array  # (n,) s
    position: Array  # (n, 3) m, centre in cam
    rotation: Array  # (n, 3, 3) R_cam_ball
    covariance: Array  # (n, 6, 6) of the centre (m) and the rotation (rad, exp(e) @ R), in cam
    seconds: Array  # (n,) s that each frame took, measured by the caller

    @property
    def found(self) -> NDArray[np.bool_]:
        """True for frames with a pose, (n,)."""
        return np.asarray(np.isfinite(self.position).all(axis=1))


def position_error(run: WandRun, truth: WandTruth) -> Array:
    """Return estimate less truth of the centre, (n, 3) m in cam; nan in frames without an estimate."""
    return run.position - truth.position[: len(run.stamp)]


def rotation_error(run: WandRun, truth: WandTruth) -> Array:
    """Return the rotation vectors of R_est R_true^T, (n, 3) rad in cam; nan in frames without an estimate."""
    error = np.full((len(run.stamp), 3), np.nan)
    k = np.flatnonzero(run.found)
    error[k] = log(run.rotation[k] @ truth.rotation[k].transpose(0, 2, 1))
    return error


def assign_truths(
    runs: Sequence[WandRun], balls: Sequence[WandBall], truths: Sequence[WandTruth], filmed: Sequence[WandBall]
) -> list[WandTruth | None]:
    """Return the truth for each run. `runs` are those of the tracker's `balls`, `truths` those of the `filmed` balls.

    Equal balls get their numbers in the order of detection, so positions assign runs to balls. Among filmed balls of
    its description, the assignment has the least sum of mean distances over all frames. A frame without a pose, or more
    than a metre off, counts as a metre. The assignment holds for the whole film, so a run that changes from one ball to
    another is wrong in one part. A ball without a match in the film takes an undescribed one, or None.
    """
    may = np.array([[alike(ball, other) for other in filmed[: len(truths)]] for ball in balls], dtype=bool)
    may = may.reshape(len(balls), len(truths))
    may[~may.any(axis=1)] = ~may.any(axis=0)
    cost = np.array([[_distance(run, truth) for truth in truths] for run in runs]).reshape(may.shape)
    found: list[WandTruth | None] = [None] * len(runs)
    for i, k in zip(*linear_sum_assignment(np.where(may, cost, _FORBIDDEN_DISTANCE_M)), strict=True):
        found[i] = truths[k] if may[i, k] else None
    return found


def alike(a: WandBall, b: WandBall) -> bool:
    """Return True if two balls look the same. Their names and the order of their discs do not count."""
    if (a.body, len(a.discs)) != (b.body, len(b.discs)) or abs(a.radius - b.radius) > _MAX_DIFFERENCE_OF_SAME_BALL:
        return False
    left = list(b.discs)
    for disc in a.discs:
        same = [
            k
            for k, other in enumerate(left)
            if disc.colour == other.colour
            and abs(disc.angle - other.angle) < _MAX_DIFFERENCE_OF_SAME_BALL
            and np.linalg.norm(disc.direction - other.direction) < _MAX_DIFFERENCE_OF_SAME_BALL
        ]
        if not same:
            return False
        del left[same[0]]
    return True


def _distance(run: WandRun, truth: WandTruth) -> float:
    """Return the mean distance of the centres, m; frames above `_MAX_DISTANCE_M` or without a pose count as that."""
    distance = np.linalg.norm(position_error(run, truth), axis=1)
    return float(np.mean(np.fmin(distance, _MAX_DISTANCE_M))) if len(distance) else _MAX_DISTANCE_M


def off(run: WandRun, truth: WandTruth, radius: float) -> NDArray[np.bool_]:
    """Return True for frames, (n,), without a pose or with a wrong one.

    A pose is wrong if it is off by more than `radius` m across the line of sight, or by more than 45° in rotation.
    """
    error = position_error(run, truth)
    sight = truth.position[: len(run.stamp)]
    sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    across = np.linalg.norm(error - np.sum(error * sight, axis=1, keepdims=True) * sight, axis=1)
    turned = np.linalg.norm(rotation_error(run, truth), axis=1)
    return ~((across <= radius) & (turned <= OFF_ANGLE))  # nan is wrong


def is_lost(run: WandRun, truth: WandTruth, radius: float) -> bool:
    """Return True if the run lost the ball: it was never right, wrong for over 1 s and two frames, or wrong at the end.

    `radius` as in `off`. Frames before the first right pose do not count.
    """
    right = np.flatnonzero(~off(run, truth, radius))
    if len(right) == 0 or right[-1] < len(run.stamp) - 1:
        return True
    before, after = right[:-1], right[1:]
    wrong_s = run.stamp[after - 1] - run.stamp[before]
    return bool(np.any((after - before - 1 > _MIN_RECOVERY_FRAMES) & (wrong_s > MAX_RECOVERY_S)))


def found_from(run: WandRun, truth: WandTruth, radius: float) -> int | None:
    """Return the index of the first frame with a right pose, from 0; None if there is none.

    A pose is right within `radius` (m) across the line of sight and 45° in rotation. Its depth does not count.
    """
    right = np.flatnonzero(~off(run, truth, radius))
    return int(right[0]) if len(right) else None


def wand_report(
    runs: Sequence[WandRun], truth: WandTruth | Sequence[WandTruth] | None, *, dataset: str, frames: int, radius: float
) -> dict[str, Any]:
    """Return all metrics of runs over one recording, each with another seed or ball, as `evaluate --json` writes them.

    `truth` is that of the ball, or one for each run (see `assign_truths`). `dataset` is the name in the report,
    `frames` the length of the recording, and `radius` (m) the ball's. Errors are over all frames with a pose of all
    runs, and percentiles are of absolute values. `fps` is frames per second of the tracker's own time, with first frame
    and searches.
    """
    tracked = [int(run.found.sum()) for run in runs]
    report: dict[str, Any] = {
        "dataset": dataset,
        "tracker": "wand",
        "frames": frames,
        "runs": len(runs),
        "tracked": number(np.mean(tracked)),
        "lost_runs": None,
        "found_from_frame": None,
        **errors([], []),
        "fps": _fps(runs),
        "frame_us": frame_times({"all": np.concatenate([run.seconds for run in runs])} if runs else {}),
    }
    if truth is None:
        return report
    truths = [truth] * len(runs) if isinstance(truth, WandTruth) else list(truth)
    pairs = list(zip(runs, truths, strict=True))
    report["lost_runs"] = sum(is_lost(run, true, radius) for run, true in pairs)
    firsts = [first for run, true in pairs if (first := found_from(run, true, radius)) is not None]
    report["found_from_frame"] = max(firsts) if len(firsts) == len(runs) and firsts else None
    return {**report, **errors(runs, truths)}


def errors(runs: Sequence[WandRun], truths: Sequence[WandTruth]) -> dict[str, Any]:
    """Return the errors of runs, each with its own truth, taken together, and two checks of their covariances.

    `anees` is the mean of e^T P^-1 e per degree of freedom: 1 if the covariances are right, above 1 if they are too
    small. A few frames with large errors dominate it. `within_95` is the fraction of frames with e^T P^-1 e below the
    95 % quantile of chi² with 6 degrees of freedom. It is 0.95 if the covariances are right.
    """
    position, turned, covariance = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros((0, 6, 6))]
    for run, truth in zip(runs, truths, strict=True):
        k = run.found
        position.append(position_error(run, truth)[k])
        turned.append(rotation_error(run, truth)[k])
        covariance.append(run.covariance[k])
    p, r, P = np.concatenate(position), np.concatenate(turned), np.concatenate(covariance)
    angle = np.linalg.norm(r, axis=1)
    return {
        "position_rmse_mm": _axes(1e3 * p, lambda e: np.sqrt(np.mean(e**2))),
        "position_p95_mm": _axes(1e3 * p, lambda e: np.quantile(np.abs(e), 0.95)),
        "position_max_mm": _axes(1e3 * p, lambda e: np.max(np.abs(e))),
        "rotation_rmse_deg": number(np.degrees(np.sqrt(np.mean(angle**2)))) if len(angle) else None,
        "rotation_p95_deg": number(np.degrees(np.quantile(angle, 0.95))) if len(angle) else None,
        "rotation_max_deg": number(np.degrees(np.max(angle))) if len(angle) else None,
        "anees": {
            "position": _per_freedom(p, P[:, :3, :3]),
            "rotation": _per_freedom(r, P[:, 3:, 3:]),
            "pose": _per_freedom(np.hstack([p, r]), P),
        },
        "within_95": number(np.mean(nees(np.hstack([p, r]), P) < gate(0.95, 6))) if len(p) else None,
    }


def _axes(error: Array, of: Callable[[Array], Any]) -> dict[str, float | None]:
    return {axis: number(of(error[:, k])) if len(error) else None for k, axis in enumerate("xyz")}


def _per_freedom(error: Array, covariance: Array) -> float | None:
    mean = mean_nees(error, covariance)
    return None if mean is None else mean / error.shape[1]


def _fps(runs: Sequence[WandRun]) -> float | None:
    seconds = sum(float(run.seconds.sum()) for run in runs)
    return number(sum(len(run.seconds) for run in runs) / seconds) if seconds > 0.0 else None


@dataclass(slots=True)
class WandHistory:
    """Results of a run, frame by frame, without the pictures."""

    stamps: list[float] = field(default_factory=list)  # s, of the frames
    poses: list[tuple[WandPose, ...]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)  # s, wall time of each step

    def add(self, epoch: WandEpoch) -> None:
        """Add the results of a frame."""
        self.stamps.append(epoch.frame.stamp)
        self.poses.append(epoch.poses)
        self.seconds.append(epoch.seconds)

    def run(self, ball: int = 0) -> WandRun:
        """Collect the results of ball number `ball`; nan in frames without its pose."""
        n = len(self.stamps)
        position, rotation = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
        covariance = np.full((n, 6, 6), np.nan)
        for i, poses in enumerate(self.poses):
            pose = poses[ball]
            if pose.position is not None and pose.rotation is not None and pose.covariance is not None:
                position[i], rotation[i], covariance[i] = pose.position, pose.rotation, pose.covariance
        return WandRun(np.array(self.stamps), position, rotation, covariance, np.array(self.seconds))

    def events(self) -> list[tuple[int, Event]]:
        """Return (frame index, event) for each event in the frame where it begins, for any ball."""
        found: list[tuple[int, Event]] = []
        for i, poses in enumerate(self.poses):
            before = {p.event for p in self.poses[i - 1]} if i else set()
            found += [(i, p.event) for p in poses if p.event and p.event not in before]
        return found
