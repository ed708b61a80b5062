"""Compare `so3` on balls with few discs with the same filter given the true association, and with `ekf2`.

    python docs/few_discs.py [--discs 8 10 12] [--motions thesis play] [--seeds 10] [--first 500] [--file ROWS.jsonl]

Each film has 10 s at 30 Hz and noise of 4 grey values. It goes from the renderer straight to the trackers, with the
camera pose found from its first frames. Errors are over the frames that `so3` tracks, relative to the first of them.

`told` gets the candidates that `so3` has detected, so the two differ by the association alone. `told_apart` detects
discs in windows of its own, so a disc at the limb or behind a strut may appear to one of them only.
With `--file` the script appends each film's row, and skips films that the file already has.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.filters.so3 import Pairing
from spheremouse.ball.filters.so3_map import augment
from spheremouse.ball.filters.so3_state import So3State
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Events, Tracker, Tracking, TrackState
from spheremouse.ball.track import advance, step
from spheremouse.ball.truth import HIDDEN, VISIBLE, DiscTruth
from spheremouse.evaluation.bound import MATCH, semi_minor_axes
from spheremouse.evaluation.detection import MIN_AXIS
from spheremouse.evaluation.metrics import attitude_error, mean_nees
from spheremouse.geometry.matching import assign, distances
from spheremouse.geometry.rotation import Array
from spheremouse.session.offline import initialise
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.simulate.ball.render import SimulatedFrame
from spheremouse.tracker import Estimate, Frame, Status

SECONDS, NOISE = 10.0, 4.0  # s; grey values


class TrueAssociation:
    """The phase of tracking with `so3` in which the simulation gives the disc of each candidate."""

    def __init__(self) -> None:
        self.discs: DiscTruth | None = None  # of the frame to come
        self.names: list[int] = []  # of the landmarks

    def next_phase(
        self, state: TrackState, stamp: float, tracker: Tracker, predicted: So3State
    ) -> tuple[TrackState, Events]:
        """Correct the filter by the true pairs. Every other candidate that is a disc becomes a landmark."""
        assert self.discs is not None
        points, shown = state.points, self.discs.state != HIDDEN
        if not self.names:
            predicted = tracker.filter.initial(stamp, predicted.attitude)
        near = distances(self.discs.centre[shown], state.detections.centre[points.index])
        which, rows = assign(near, MATCH)
        names = self.discs.disc[shown][which].tolist()
        pairs = [(row, self.names.index(name)) for row, name in zip(rows, names, strict=True) if name in self.names]
        used, columns = np.array(pairs, dtype=np.intp).reshape(-1, 2).T.copy()
        corrected, _ = tracker.filter.correct(predicted, points, Pairing(used, columns))
        new = [(row, name) for row, name in zip(rows, names, strict=True) if name not in self.names]
        if self.names or len(points) >= 2:
            corrected = augment(
                corrected, points, np.array([row for row, _ in new], dtype=np.intp), tracker.filter.station.radius
            )
            self.names += [name for _, name in new]
        return state._replace(filter=corrected, confirmed=True, confirmed_at=stamp, phase=Tracking()), ()


class Track:
    """The estimates of one tracker, frame by frame."""

    def __init__(self, tracker: Tracker, stamp: float) -> None:
        self.tracker, self.state, self.estimates = tracker, begin(tracker, stamp), list[Estimate]()

    def step(self, frame: Frame) -> None:
        """Track one frame."""
        self.state, estimate, _ = step(self.state, frame, self.tracker)
        self.estimates.append(estimate)

    def advance(self, stamp: float, detections: Detections) -> None:
        """Track one frame with the discs that another tracker has detected."""
        self.state, estimate, _ = advance(self.state, stamp, detections, self.tracker)
        self.estimates.append(estimate)


def measure(options: SimulationOptions) -> dict[str, Any]:
    """Return the figures of one film."""
    simulation, made = prepare(options), list[SimulatedFrame]()

    def frames() -> Iterator[Frame]:
        for one in simulate(simulation):
            made.append(replace(one, frame=replace(one.frame, image=np.zeros((0, 0), np.uint8))))
            yield one.frame

    rig, settings = simulation.scene.rig(), Settings()
    start = initialise(frames(), rig, settings)
    tracker, truths = build(rig, start.pose, settings), (TrueAssociation(), TrueAssociation())
    so3, ekf2 = Track(tracker, 0.0), Track(build(rig, start.pose, replace(settings, tracker="ekf2")), 0.0)
    told, told_apart = (
        Track(replace(tracker, method=tracker.method._replace(next_phase=each.next_phase)), 0.0) for each in truths
    )
    for track in (told, told_apart):
        track.state = track.state._replace(phase=Tracking())
    for frame in start.frames:
        for each in truths:
            each.discs = made[frame.sequence].discs
        for track in (so3, told_apart, ekf2):
            track.step(frame)
        told.advance(frame.stamp, so3.state.detections)
    made = made[start.passed :]
    seen = [
        int(np.sum((one.discs.state == VISIBLE) & (semi_minor_axes(one.discs.centre, rig, one.pose) >= MIN_AXIS)))
        for one in made
    ]
    return figures(made, np.array(seen), {"so3": so3, "told": told, "told_apart": told_apart, "ekf2": ekf2})


def figures(made: list[SimulatedFrame], seen: Array, tracks: dict[str, Track]) -> dict[str, Any]:
    """Return the RMS errors of the attitude in degrees, NEES, and the tracked part of the frames with two discs.

    `seen` (n,) is the number of discs that the detector is expected to find in each frame.
    """
    tracked = np.array([e.status is Status.TRACKING for e in tracks["so3"].estimates])
    two = seen >= 2
    kept = np.flatnonzero(tracked)
    true = np.array([made[k].attitude for k in kept])
    row: dict[str, Any] = {
        "tracked": int(tracked.sum()), "frames": len(made), "tracked_of_two": float(np.mean(tracked[two])),
        "least_in_view": int(seen.min()),
    }  # fmt: skip
    for name, track in tracks.items():
        estimates = [track.estimates[k] for k in kept]
        error = attitude_error(np.array([e.rotation for e in estimates]), true)
        P = np.array([e.covariance[:3, :3] for e in estimates])
        row[name] = float(np.degrees(np.sqrt(np.mean(np.sum(error**2, axis=1)))))
        row[f"{name}_end"] = float(np.degrees(np.linalg.norm(error[-1])))
        if name != "ekf2":
            row[f"{name}_nees"] = mean_nees(error[1:], P[1:])
    return row


def main() -> None:
    """Measure each film that the file lacks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--discs", type=int, nargs="+", default=[8, 10, 12])
    parser.add_argument("--motions", nargs="+", default=["thesis", "play"])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=500)
    parser.add_argument("--file", type=Path)
    given = parser.parse_args()
    lines = given.file.read_text().splitlines() if given.file and given.file.exists() else []
    done = {(r["discs"], r["motion"], r["seed"]) for r in map(json.loads, lines)}
    for seed, discs, motion in product(range(given.first, given.first + given.seeds), given.discs, given.motions):
        if (discs, motion, seed) in done:
            continue
        film: dict[str, Any] = {"discs": discs, "motion": motion, "seed": seed}
        row = film | measure(SimulationOptions(**film, seconds=SECONDS, noise=NOISE))
        print(json.dumps({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}), flush=True)
        if given.file:
            with given.file.open("a") as file:
                file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
