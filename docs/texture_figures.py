"""The table of docs/texture.md: python docs/texture_figures.py [--seeds 3] [--file ROWS.jsonl] [--write].

Each film has 12 s at 30 Hz, noise of 4 grey values, a blur of 4 ms and a painted ball without discs. It goes from the
renderer straight to the tracker, which gets the camera's true pose. `--write` replaces the table of the page. With
`--file` the script appends each film's row, and skips films that the file already has. Two processes share the films.

The steps: in the second half of a film of play, the tracker gets as its next frame the picture of an earlier one, with
the ball 30 to 55 degrees away. It gets that picture again until an estimate is confirmed, 40 times at most. A step is
right if that estimate is at most 0.5 degrees off, relative to the last frame before the step.
"""

import argparse
import json
from dataclasses import replace
from itertools import product
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse.ball.settings import Settings
from spheremouse.ball.track import step
from spheremouse.ball.truth import Truth
from spheremouse.evaluation.metrics import report
from spheremouse.evaluation.run import Reference
from spheremouse.files.safe_files import write_atomically
from spheremouse.geometry.rotation import Array, log
from spheremouse.session.evaluate import BallRun, run_ball
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.tracker import Frame, Status

PAGE = Path(__file__).with_name("texture.md")
MARKS = ("<!-- made by docs/texture_figures.py --write -->", "<!-- end -->")
PATTERNS = ("patches", "marble", "speckle", "dirt")
FILMS: dict[str, dict[str, Any]] = {
    "play": {"motion": "play"},
    "disturbed": {"motion": "play", "hands": True, "dim": 0.2},
    "flick": {"motion": "flick"},
}
SECONDS, NOISE, BLUR, FIRST = 12.0, 4.0, 0.004, 300  # s; grey values; s; seed
STEP, RIGHT = (30.0, 55.0), 0.5  # degrees
STEPS, EVERY, REPEATS = 30, 10, 40  # of a film; frames between the states they start from; frames


def measure(given: tuple[str, str, int]) -> dict[str, Any]:
    """Return the figures of one film."""
    pattern, film, seed = given
    made_of: dict[str, Any] = {"pattern": pattern, "seed": seed, **FILMS[film]}
    simulation = prepare(SimulationOptions(seconds=SECONDS, noise=NOISE, blur=BLUR, **made_of))
    made = list(simulate(simulation))
    frames, attitude = [one.frame for one in made], np.array([one.attitude for one in made])
    truth = Truth(np.array([f.stamp for f in frames]), attitude, np.array([one.rate for one in made]))
    run = run_ball(iter(frames), replace(simulation.scene.rig(), pose=made[0].pose), Settings())
    r = report(
        run.history.run(), Reference(truth), run.tracker.rig, dataset=film, tracker="", frames=len(made), found=None
    )
    row = {"pattern": pattern, "film": film, "seed": seed, "right": 0, "wrong": 0, "steps": 0}
    if film == "play":
        row |= jumps(run, frames, attitude)
    return row | {
        "frames": r["frames"], "tracked": r["tracked"], "lost": r["lost_episodes"],
        "attitude": r["attitude_rmse_deg"]["combined"], "rate": r["rate_rmse_deg_s"]["combined"],
        "nees": r["nees"]["attitude"],
    }  # fmt: skip


def jumps(run: BallRun, frames: list[Frame], attitude: Array) -> dict[str, int]:
    """Return how many steps back to earlier frames end right, and how many wrong, from states of the second half."""
    epochs, count = run.history.epochs, {"right": 0, "wrong": 0, "steps": 0}
    pairs: list[tuple[int, int]] = []
    for i in range(len(epochs) // 2, len(epochs), EVERY):
        away = np.degrees(np.linalg.norm(log(attitude[i] @ attitude[:i].transpose(0, 2, 1)), axis=1))
        if epochs[i].state.status is Status.TRACKING:
            pairs += [(i, int(k)) for k in np.flatnonzero((away > STEP[0]) & (away < STEP[1]))]
    for i, k in pairs[:: max(len(pairs) // STEPS, 1)][:STEPS]:
        state, offset = epochs[i].state, epochs[i].estimate.rotation.T @ attitude[i]
        count["steps"] += 1
        for n in range(1, REPEATS + 1):
            frame = replace(frames[k], stamp=frames[i].stamp + n / 30.0, sequence=frames[i].sequence + n)
            state, estimate, _ = step(state, frame, run.tracker)
            if estimate.confirmed and state.status is Status.TRACKING:
                error = np.degrees(np.linalg.norm(log(estimate.rotation @ offset @ attitude[k].T)))
                count["right" if error <= RIGHT else "wrong"] += 1
                break
    return count


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table of all films."""
    lines = [
        "| film | tracked | lost | attitude RMSE, ° | rate RMSE, °/s | NEES | steps: right, wrong, all |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for pattern, film in product(PATTERNS, FILMS):
        some = [r for r in rows if (r["pattern"], r["film"]) == (pattern, film)]
        n = {key: sum(r[key] for r in some) for key in ("tracked", "frames", "lost", "right", "wrong", "steps")}
        cells = (mean(some, "attitude", ".3f", 2), mean(some, "rate", ".2f", 2), mean(some, "nees", ".2g", 1))
        jumped = f"{n['right']}, {n['wrong']}, {n['steps']}" if n["steps"] else "–"
        part = f"{100.0 * n['tracked'] / max(n['frames'], 1):.0f}%"
        lines.append(f"| {pattern}, {film} | {part} | {n['lost']} | {' | '.join(cells)} | {jumped} |")
    return "\n".join(lines)


def mean(rows: list[dict[str, Any]], key: str, form: str, power: int) -> str:
    """Return the mean over films, of squares for `power` 2, as text."""
    values = [r[key] for r in rows if r[key] is not None]
    return format(float(np.mean(np.power(values, power))) ** (1 / power), form) if values else "–"


def main() -> None:
    """Measure each film that the file lacks, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--file", type=Path)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    lines = given.file.read_text().splitlines() if given.file and given.file.exists() else []
    rows: list[dict[str, Any]] = [json.loads(line) for line in lines]
    done = {(r["pattern"], r["film"], r["seed"]) for r in rows}
    films = product(PATTERNS, FILMS, range(FIRST, FIRST + given.seeds))
    with Pool(2) as pool:
        for row in pool.imap_unordered(measure, [f for f in films if f not in done]):
            rows.append(row)
            print(json.dumps({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}), flush=True)
            if given.file:
                with given.file.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    print(table(rows))
    if given.write:
        before, rest = PAGE.read_text().split(MARKS[0])
        after = rest.split(MARKS[1])[1]
        write_atomically(PAGE, f"{before}{MARKS[0]}\n\n{table(rows)}\n\n{MARKS[1]}{after}")


if __name__ == "__main__":
    main()
