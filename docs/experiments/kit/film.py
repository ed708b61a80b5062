"""Parts of most jobs: a film in memory or from a dataset, the camera's pose, tracking, metrics."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.kit.job import Result
from spheremouse.ball.build import build
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.truth import DiscTruth, Truth
from spheremouse.errors import PoseError
from spheremouse.evaluation.bound import Bound
from spheremouse.evaluation.metrics import per_axis, report, run_bound
from spheremouse.evaluation.run import History, Reference, Run
from spheremouse.files import config
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.geometry.camera import Pose
from spheremouse.session.offline import initialise, track
from spheremouse.simulate.ball.film import SimulatedFrame, Simulation, SimulationOptions, prepare, simulate
from spheremouse.tracker import Frame

TRACKERS = ("ekf1", "ekf2", "so3")


def settings_of(assignments: Iterable[str] = ()) -> Settings:
    """The defaults with KEY=VALUE as `--set` takes them."""
    settings = Settings()
    for assignment in assignments:
        settings = config.override(settings, assignment)
    return settings


def options_of(film: dict[str, Any]) -> SimulationOptions:
    """Options of a film from plain data, in which tuples are lists."""
    return replace(SimulationOptions(), **{k: tuple(v) if isinstance(v, list) else v for k, v in film.items()})


@dataclass(frozen=True, slots=True)
class Film:
    """All frames of a film, to be tracked any number of times, with its truth."""

    name: str
    frames: tuple[Frame, ...]  # their sequence is their index
    rig: Rig  # as known beforehand, without the camera's pose
    truth: Reference


def film_of(simulation: Simulation, name: str = "film") -> Film:
    """A film simulated in memory: 1 MB a frame of 640x480."""
    shots = list(simulate(simulation))
    scene = simulation.scene
    motion = Truth(
        np.array([s.frame.stamp for s in shots]),
        np.array([s.attitude for s in shots]),
        np.array([s.rate for s in shots]),
    )
    truth = Reference(motion, _discs(shots), scene.pose, scene.disc_directions)
    return Film(name, tuple(s.frame for s in shots), scene.rig(), truth)


def film_from_dataset(path: Path | str, frames: int | None = None) -> Film:
    """A dataset, or its first `frames`."""
    recording = open_dataset(path)
    chosen = [
        replace(f, sequence=i) for i, f in zip(range(frames or recording.frames), read_frames(recording), strict=False)
    ]
    truth = Reference(recording.truth, recording.discs, recording.pose, recording.truth_directions)
    return Film(recording.name, tuple(chosen), recording.rig, truth)


def film_like_s1(path: str | None, frames: int) -> Film:
    """A film with the motion and camera of S1 of the thesis: simulated, or the reference recording at a path."""
    if path is not None:
        return film_from_dataset(path, frames)
    return film_of(prepare(options_of({"seconds": frames / 30.0})), "S1")


@dataclass(frozen=True, slots=True)
class Tracked:
    run: Run
    found: Pose | None  # where the pose was looked for
    report: Result  # as `evaluate --json` has it


def tracked(film: Film, settings: Settings, *, rig: Rig | None = None) -> Tracked:
    """Track a film from its first frame. `rig`: another one than the film's. PoseError if no targets are found."""
    rig = film.rig if rig is None else rig
    start = initialise(iter(film.frames), rig, settings)
    history = History()
    for epoch in track(start.frames, build(rig, start.pose, settings)):
        history.add(epoch)
    run, found = history.run(), None if start.resection is None else start.pose
    said = report(
        run, film.truth, rig, dataset=film.name, tracker=settings.tracker, frames=len(film.frames), found=found
    )
    return Tracked(run, found, said)


def bound(film: Film, tracked: Tracked, since: float = -np.inf) -> Result | None:
    """RMS of the posterior Cramer-Rao bound for what a run measured, {"attitude_deg", "rate_deg_s"} per axis.

    As `metrics.bound_ratio`, over all tracked frames but the first, from `since` on, s.
    """
    run = tracked.run
    before = int(np.count_nonzero(run.stamp[run.tracked] < since))
    return bound_rms(run_bound(run, film.truth, film.rig), max(1, before))


def bound_rms(limit: Bound | None, first: int = 1) -> Result | None:
    """Degrees and degrees per second, combined and per axis, over all frames from `first` on."""
    if limit is None:
        return None
    least = {"attitude_deg": limit.attitude, "rate_deg_s": limit.rate}
    return {k: per_axis(np.degrees(np.sqrt(np.diagonal(P[first:], axis1=1, axis2=2))), "xyz") for k, P in least.items()}


def track_all(film: Film, variants: dict[str, Settings], **how: Any) -> Result:
    """`tracked` of each variant, with its `bound`; a pose that is not found is a row that says so."""
    results: Result = {}
    for name, settings in variants.items():
        try:
            done = tracked(film, settings, **how)
            results[name] = {**done.report, "bound": bound(film, done)}
        except PoseError as e:
            results[name] = {"error": str(e)}
    return results


def _discs(shots: list[SimulatedFrame]) -> DiscTruth:
    parts = [s.discs for s in shots]
    numbers = np.repeat(np.arange(len(parts)), [len(p) for p in parts])
    joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in DiscTruth.__slots__}
    return DiscTruth(**{**joined, "frame": numbers})
