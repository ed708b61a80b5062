"""A film that is looked at once and filtered any number of times: what a detector saw, in; a run and its errors, out.

This serves the classic filters. Their detector searches whole pictures, so its results do not depend on the filter.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from experiments.kit.film import TRACKERS, Film, settings_of, tracked
from experiments.kit.job import Result
from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Epoch
from spheremouse.ball.track import advance
from spheremouse.evaluation.detection import detection_quality, mean_discs
from spheremouse.evaluation.metrics import (
    attitude_error,
    correlation,
    lost_episodes,
    mean_nees,
    per_axis,
    surface_speeds,
)
from spheremouse.evaluation.run import History, Reference, Run
from spheremouse.geometry.camera import Pose
from spheremouse.session.offline import initialise


@dataclass(frozen=True, slots=True)
class Sights:
    """Detections of a ball by a camera at rest."""

    stamps: tuple[float, ...]  # s
    detections: tuple[Detections, ...]  # by frame, of the whole picture
    rig: Rig
    pose: Pose


def look_at(film: Film, settings: Settings) -> Sights:
    """Every disc candidate of a film, and the camera's pose from its first frames. PoseError where there is none."""
    start = initialise(iter(film.frames), film.rig, settings)
    tracker = build(film.rig, start.pose, settings)
    frames = list(start.frames)
    seen = tuple(tracker.detector_data.detect(frame.image) for frame in frames)
    return Sights(tuple(frame.stamp for frame in frames), seen, film.rig, start.pose)


def with_sigma(detections: Sights, sigma: float) -> Sights:
    """With the same standard deviation for all centres: sigma_b of Wittich 2017, px per axis."""
    even = [
        replace(d, covariance=np.broadcast_to(sigma**2 * np.eye(2), (len(d), 2, 2)).copy())
        for d in detections.detections
    ]
    return replace(detections, detections=tuple(even))


def filtered(detections: Sights, settings: Settings, film: Film) -> Run:
    """The run of `ekf1` or `ekf2`, as `session.track` gives it."""
    assert settings.tracker != "so3", "so3 looks where it expects discs"
    tracker = build(detections.rig, detections.pose, settings)
    state, history = begin(tracker, detections.stamps[0]), History()
    last = len(film.frames) - len(detections.stamps)  # frames before the first view that showed the targets
    for frame, seen in zip(film.frames[last:], detections.detections, strict=True):
        state, motion, events = advance(state, frame.stamp, seen, tracker)
        history.add(Epoch(frame, state, motion, events, {}))
    return history.run()


def all_runs(film: Film) -> dict[str, Run]:
    """Return the runs of all filters: the classic ones on one look at the film, and `so3`."""
    seen = look_at(film, settings_of(["tracker=ekf2"]))
    runs = {name: filtered(seen, settings_of([f"tracker={name}"]), film) for name in TRACKERS if name != "so3"}
    return {**runs, "so3": tracked(film, settings_of()).run}


def errors(run: Run, truth: Reference, radius: float, since: float = -np.inf) -> Result:
    """The part of `metrics.report` that experiments compare; same keys, None where nothing was tracked.

    Of the frames from `since` on, s; attitudes all the same relative to the first of all. Lost is lost whenever.
    """
    motion = truth.motion
    assert motion is not None
    attitude = rate = speed = true = None
    whole, run = run, _late(run, since)
    kept = run.tracked
    if len(kept):
        every = whole.tracked
        attitude = attitude_error(whole.attitude[every], motion.attitude[whole.frame[every]])[-len(kept) :]
        rate = run.rate[kept] - motion.rate[run.frame[kept]]
        speed, true = surface_speeds(run, motion, radius)
    P = run.covariance[kept]
    detection = None if truth.discs is None else detection_quality(run, truth.discs)
    return {
        "frames": len(run.frame), "tracked": len(kept), "lost_episodes": lost_episodes(whole.status),
        "attitude_rmse_deg": per_axis(None if attitude is None else np.rad2deg(attitude), "xyz"),
        "rate_rmse_deg_s": per_axis(None if rate is None else np.rad2deg(rate), "xyz"),
        "surface_speed_rmse_mm_s": per_axis(None if speed is None or true is None else speed - true, "xy"),
        "surface_speed_r": correlation(speed, true), "mean_discs": mean_discs(run), "detection": detection,
        "nees": {
            "attitude": None if attitude is None else mean_nees(attitude[1:], P[1:, :3, :3]),
            "rate": None if rate is None else mean_nees(rate, P[:, 3:, 3:])
        }
    }  # fmt: skip


def _late(run: Run, since: float) -> Run:
    """The frames from `since` on, s."""
    if not np.isfinite(since):
        return run
    first = int(np.searchsorted(run.stamp, since))
    columns = {f.name: getattr(run, f.name) for f in fields(run)}
    cut = {
        k: {s: x[first:] for s, x in v.items()} if isinstance(v, dict) else v[first:]
        for k, v in columns.items()
        if v is not None
    }
    return replace(run, **cut)
