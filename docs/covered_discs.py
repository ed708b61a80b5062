"""Compare the centres of whole and of partly hidden discs with the simulation.

    python docs/covered_discs.py [--seeds 4] [--first 820] [--view far] [--size 640x480]

Each film has 10 s of play at 30 Hz, 26 discs and noise of 4 grey values; every fourth frame counts. The detector looks
for each disc near its true place, 0.2 degrees off. The table has the part that it finds, the RMS error for each axis,
the median of the stated standard deviation, and the squared error over the stated one, of discs with a semi-minor axis
of 3 px and more. Hidden discs must not be found.
"""

import argparse

import numpy as np

from spheremouse.ball.detect.discs import disc_detector
from spheremouse.ball.detect.search import SearchState
from spheremouse.ball.detect.windows import ANYWHERE, Motion
from spheremouse.ball.settings import Settings
from spheremouse.ball.truth import HIDDEN, PARTLY_HIDDEN, VISIBLE
from spheremouse.evaluation.bound import semi_minor_axes
from spheremouse.geometry.matching import assign, distances
from spheremouse.geometry.rotation import exp
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate

FRAMES, LEAST_AXIS, OFF, NEAR = 4, 3.0, np.radians(0.2), 8.0  # every so many; px; rad; px


def measure(options: SimulationOptions) -> np.ndarray:
    """Return state, error (2,) px and covariance (4,) px² of each disc of a film; nan where it is not found."""
    simulation, rng, rows = prepare(options), np.random.default_rng(options.seed), list[np.ndarray]()
    rig, detector, search = simulation.scene.rig(), None, SearchState()
    for number, made in enumerate(simulate(simulation)):
        if number % FRAMES:
            continue
        detector = detector or disc_detector(Settings().discs, rig, made.pose)
        place = simulation.scene.disc_directions[made.discs.disc] @ (made.attitude @ exp(OFF * rng.normal(size=3))).T
        motion = Motion(made.rate, rig.readout_s)
        found, search = detector.follow(made.frame.image, search, place, motion, ANYWHERE, len(place) + 1)
        row = np.full((len(place), 7), np.nan)
        row[:, 0] = made.discs.state
        at, which = assign(distances(made.discs.centre, found.centre), NEAR)
        row[at, 1:3] = found.centre[which] - made.discs.centre[at]
        row[at, 3:] = found.covariance[which].reshape(-1, 4)
        rows.append(row[semi_minor_axes(made.discs.centre, rig, made.pose) >= LEAST_AXIS])
    return np.concatenate(rows)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=820)
    parser.add_argument("--view", default="far")
    parser.add_argument("--size", default="640x480")
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    films = [
        measure(SimulationOptions(view=given.view, motion="play", seed=seed, seconds=10, noise=4, size=(width, height)))
        for seed in range(given.first, given.first + given.seeds)
    ]
    rows = np.concatenate(films)
    print("| discs | number | found | RMS error | standard deviation | squared error over stated |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, state in (("whole", VISIBLE), ("partly hidden", PARTLY_HIDDEN), ("hidden", HIDDEN)):
        of = rows[rows[:, 0] == state]
        found = of[np.isfinite(of[:, 1])]
        e, C = found[:, 1:3], found[:, 3:].reshape(-1, 2, 2)
        print(f"| {name} | {len(of)} | {100 * len(found) / max(len(of), 1):.1f} % |", end=" ")
        if len(found) == 0:
            print("- | - | - |")
            continue
        ratio = np.einsum("ni,nij,nj->n", e, np.linalg.inv(C), e) / 2.0
        sigma = np.sqrt(np.median(np.trace(C, axis1=1, axis2=2)) / 2.0)
        print(f"{np.sqrt(np.mean(e**2)):.3f} px | {sigma:.3f} px | {np.mean(ratio):.2f} |")


if __name__ == "__main__":
    main()
