"""The figures of docs/identification.md: python docs/identification_figures.py [FAR26_DIR] [--trials N] [--only TITLE].

Print all tables, and write the first one to the end of that page. The page quotes the others. With 30,000 attitudes it
takes about ten minutes. The trial's number is the seed, so the same command gives the same tables except for the times.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spheremouse.ball.associate import Identification, identify
from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import advance
from spheremouse.geometry.camera import InteriorOrientation, Pose, project
from spheremouse.geometry.rotation import exp, log
from spheremouse.simulate.ball.scene import spread_directions

CAMERA = np.array([0.0, 0.0, 1.0])
HORIZON = 0.25
LIMB = HORIZON + 0.1
MARK = "<!-- from here on written by identification_figures.py -->"
RISKS = (0.1, 0.05, 0.02, 0.01, 0.001)
Draw = tuple[np.ndarray, np.ndarray, np.ndarray, dict]  # seen, map, true rotation, arguments of identify


@dataclass
class Tally:
    """Results of a series of trials."""

    right: int = 0
    wrong: int = 0
    trials: int = 0
    time: float = 0.0  # s, median
    slow: float = 0.0  # s, 99 %

    def row(self) -> list[str]:
        """Cells of a table."""
        right, silent = (100.0 * k / self.trials for k in (self.right, self.trials - self.right - self.wrong))
        return [f"{right:.2f}", f"{silent:.2f}", f"{self.wrong}", f"{1e3 * self.time:.2f}, {1e3 * self.slow:.2f}"]


def unit(v: np.ndarray) -> np.ndarray:
    """Vectors at unit length."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def scattered(n: int, least: float, rng: np.random.Generator) -> np.ndarray:
    """Random directions, (n, 3), no two nearer than `least` rad."""
    found = np.zeros((0, 3))
    while len(found) < n:
        d = unit(rng.normal(size=3))
        if np.all(found @ d < np.cos(least)):
            found = np.vstack([found, d])
    return found


def spread(n: int, jitter: float, rng: np.random.Generator) -> np.ndarray:
    """Directions, (n, 3), that repel each other and are then put down by hand, `jitter` rad off."""
    p = unit(rng.normal(size=(n, 3)))
    for _ in range(60):
        apart = p[:, None] - p[None]
        p = unit(p + 0.02 * np.sum(apart / (np.linalg.norm(apart, axis=2) + np.eye(n))[..., None] ** 3, axis=1))
    return unit(p + jitter * rng.normal(size=p.shape))


def attitude(rng: np.random.Generator) -> np.ndarray:
    """A random rotation, (3, 3), all equally likely."""
    w, *v = unit(rng.normal(size=4))
    return exp(2.0 * np.arctan2(np.linalg.norm(v), w) * unit(np.array(v)))


def anywhere(n: int, least: float, rng: np.random.Generator) -> np.ndarray:
    """Random directions, (n, 3), whose cosine with the camera's is above `least`."""
    z, a = rng.uniform(least, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=1)


def with_noise(p: np.ndarray, sigma: float, rng: np.random.Generator, at_limb: float = 0.0) -> np.ndarray:
    """Directions with noise of `sigma` rad per axis, times cosine ** -at_limb along the line to the limb."""
    along = unit(p * p[:, 2:] - CAMERA + 1e-12)
    more = np.clip(p[:, 2:], 0.25, 1.0) ** -at_limb
    e = rng.normal(size=(2, len(p), 1)) * sigma
    return unit(p + e[0] * more * along + e[1] * np.cross(p, along))


def ball(sigma: float, keep: int | float, false: int, known: Callable[[int], np.ndarray]) -> Callable[[int], Draw]:
    """Trials of a ball whose whole discs are seen: so many of them, or each with that probability."""

    def draw(trial: int) -> Draw:
        rng = np.random.default_rng(trial)
        discs, R = known(trial), attitude(rng)
        p = discs @ R.T
        p = rng.permutation(p[p[:, 2] > LIMB])
        p = p[:keep] if isinstance(keep, int) else p[rng.random(len(p)) < keep]
        p = np.vstack([with_noise(p, sigma, rng), anywhere(false, LIMB, rng)])
        return rng.permutation(p), discs, R, {"sigma": sigma, "view_axis": CAMERA, "horizon": HORIZON}

    return draw


def photograph(hand: bool, degrees: tuple[float, float], claimed: float, at_limb: float) -> Callable[[int], Draw]:
    """Trials of a small picture of a ball with 20 dots: few pixels, dots missing, false ones, an axis that is off."""

    def draw(trial: int) -> Draw:
        rng = np.random.default_rng(trial)
        discs, R = spread(20, 0.12, rng) if hand else scattered(20, 0.35, rng), attitude(rng)
        sigma = np.deg2rad(rng.uniform(*degrees))
        p = discs @ R.T
        faint = 1.0 / (1.0 + np.exp((rng.uniform(0.05, 0.3) - p[:, 2]) / 0.03))
        p = p[rng.random(20) < 0.9 * faint]
        p = np.vstack([with_noise(p, sigma, rng, at_limb), anywhere(int(rng.integers(0, 3)), 0.1, rng)])
        axis = unit(CAMERA + np.deg2rad(3.0) * rng.normal(size=3))
        return rng.permutation(p), discs, R, {"sigma": claimed * sigma, "view_axis": axis}

    return draw


def tally(trials: int, draw: Callable[[int], Draw], **more: float) -> tuple[Tally, np.ndarray]:
    """Run trials; and for each answer its false alarm, and whether it was wrong, (k, 2).

    Right is within ten standard deviations of one direction (three discs close together hold the attitude that loosely)
    or 20 degrees, whichever is less: half of the way to another disc.
    """
    result, times, answers = Tally(trials=trials), [], []
    for trial in range(trials):
        seen, known, R, arguments = draw(trial)
        start = time.perf_counter()
        found: Identification | None = identify(seen, known, **(arguments | more))
        times.append(time.perf_counter() - start)
        if found is None:
            continue
        right = float(np.linalg.norm(log(found.rotation @ R.T))) < min(10.0 * arguments["sigma"], 0.35)
        result.right += right
        result.wrong += not right
        answers.append((found.false_alarm, not right))
    result.time, result.slow = float(np.median(times)), float(np.quantile(times, 0.99))
    return result, np.array(answers).reshape(-1, 2)


def table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows])


def pool(m: int, least: float) -> Callable[[int], np.ndarray]:
    """A hundred random maps in turn."""
    maps = [scattered(m, least, np.random.default_rng(k)) for k in range(100)]
    return lambda trial: maps[trial % 100]


HEAD = ["found, %", "refused, %", "wrong, number", "time, ms: median, 99 %"]


def fine(trials: int, maps: dict[str, Callable[[int], np.ndarray]]) -> str:
    """Fine directions: found."""
    cases: list[tuple[str, float, int | float, int]] = [
        ("5 discs", 0.1, 5, 0),
        ("5 discs, 1 false", 0.1, 5, 1),
        ("5 discs, 3 false", 0.1, 5, 3),
        ("4 discs, 1 false", 0.1, 4, 1),
        ("20 % missing, 1 false", 0.1, 0.8, 1),
        ("50 % missing, 5 false", 0.1, 0.5, 5),
        ("all, 10 false", np.rad2deg(0.003), 1.0, 10),
    ]
    rows = []
    for name, known in maps.items():
        for case, degrees, keep, false in cases:
            result, _ = tally(trials, ball(np.deg2rad(degrees), keep, false, known))
            rows.append([name, case, f"{degrees:.2f}°", *result.row()])
    return table(["map", "seen", "sigma", *HEAD], rows)


def coarse(trials: int, known: Callable[[int], np.ndarray]) -> str:
    """Coarser and coarser directions: refused, not guessed."""
    rows = []
    for degrees in (0.1, 0.3, 1.0, 2.0, 3.0, 5.0, 10.0):
        for case, keep, false in (("5 discs, 1 false", 5, 1), ("20 % missing, 1 false", 0.8, 1)):
            result, _ = tally(trials, ball(np.deg2rad(degrees), keep, false, known))
            rows.append([f"{degrees}°", case, *result.row()])
    return table(["sigma", "seen", *HEAD], rows)


def nothing(trials: int, known: Callable[[int], np.ndarray]) -> str:
    """No such ball in sight: random directions, and another ball."""
    rows = []
    for degrees in (0.1, 0.3, 1.0, 3.0):
        sigma = np.deg2rad(degrees)
        fixed = {"sigma": sigma, "view_axis": CAMERA, "horizon": HORIZON}
        for n in (4, 8, 16):

            def clutter(t: int, n: int = n, fixed: dict = fixed) -> Draw:
                return anywhere(n, LIMB, np.random.default_rng(t)), known(t), np.eye(3), fixed

            result, _ = tally(trials, clutter)
            rows.append([f"{degrees}°", f"{n} random directions", f"{result.right + result.wrong} of {trials}"])

        def other(t: int, sigma: float = sigma) -> Draw:
            seen, _, _, arguments = ball(sigma, 1.0, 0, known)(t)
            return seen, known(t + 1), np.eye(3), arguments

        swapped, _ = tally(trials, other)
        rows.append([f"{degrees}°", "another ball of 26 discs", f"{swapped.right + swapped.wrong} of {trials}"])
    return table(["sigma", "in sight", "identified"], rows)


def half_turned(rng: np.random.Generator, moved: float = 0.0) -> np.ndarray:
    """A map, (26, 3), that half a turn carries onto itself, but for one disc moved by so many rad."""
    while True:
        half = scattered(13, 0.3, rng)
        discs = np.vstack([half, half * [-1.0, -1.0, 1.0]])
        if np.max(discs @ discs.T - 2.0 * np.eye(26)) < np.cos(0.2):
            break
    discs[0] = exp(moved * unit(np.cross(discs[0], rng.normal(size=3)))) @ discs[0]
    return discs


def layouts() -> dict[str, np.ndarray]:
    """Layouts that look alike in several attitudes."""
    g = (1.0 + np.sqrt(5.0)) / 2.0
    signs = [np.array([a, b, c]) for a in (1, -1) for b in (1, -1) for c in (1, -1)]
    cube = np.array(signs, dtype=float)
    twelve = np.array([np.roll([0.0, a, b * g], k) for a in (1, -1) for b in (1, -1) for k in range(3)])
    rest = np.array([np.roll([0.0, a / g, b * g], k) for a in (1, -1) for b in (1, -1) for k in range(3)])
    turn = np.arange(12) * np.pi / 6.0
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(12)], axis=1)
    return {
        "octahedron": np.vstack([np.eye(3), -np.eye(3)]),
        "cube": unit(cube),
        "icosahedron": unit(twelve),
        "dodecahedron": unit(np.vstack([cube, rest])),
        "ring of 12": ring,
        "two-fold": half_turned(np.random.default_rng(1)),
        "two-fold, one disc moved by 3°": half_turned(np.random.default_rng(1), np.deg2rad(3.0)),
    }


def symmetric(trials: int) -> str:
    """Layouts that look alike: refused, or found where a disc in sight tells."""
    rows = []
    for name, discs in layouts().items():
        for degrees in (0.1, 1.0, 3.0):
            result, _ = tally(trials, ball(np.deg2rad(degrees), 0.9, 0, lambda _, discs=discs: discs))
            rows.append([name, f"{degrees}°", *result.row()])
    return table(["layout", "sigma", *HEAD], rows)


def photographs(trials: int) -> str:
    """The trade between answers and wrong answers at noise of degrees."""
    rows = []
    for name, hand, degrees, claimed, at_limb in (
        ("random dots, 2 to 3°", False, (2, 3), 1.0, 0.5),
        ("random dots, 3 to 4°", False, (3, 4), 1.0, 0.5),
        ("random dots, 4 to 5°", False, (4, 5), 1.0, 0.5),
        ("random dots, 2 to 5°", False, (2, 5), 1.0, 0.5),
        ("the same, sigma given / 1.5", False, (2, 5), 1 / 1.5, 0.5),
        ("the same, sigma given × 1.5", False, (2, 5), 1.5, 0.5),
        ("the same, noise alike everywhere", False, (2, 5), 1.0, 0.0),
        ("the same, noise with 1 / cosine", False, (2, 5), 1.0, 1.0),
        ("even dots, 2 to 5°", True, (2, 5), 1.0, 0.5),
    ):
        result, answers = tally(trials, photograph(hand, degrees, claimed, at_limb), risk=0.999999)
        cells = [name]
        for risk in (1.0, *RISKS):
            wrong = answers[answers[:, 0] <= risk, 1]
            cells.append(f"{100 * np.sum(wrong == 0) / trials:.1f} / {100 * np.sum(wrong) / trials:.2f}")
        rows.append([*cells, f"{1e3 * result.time:.2f}"])
    head = ["ball", "best guess", *(f"risk {risk:g}" for risk in RISKS), "time ms"]
    return table(head, rows)


def speed(trials: int) -> str:
    """Time by the number of discs."""
    rows = []
    for m, least in ((12, 0.35), (26, 0.2), (50, 0.15), (74, 0.1), (120, 0.08)):
        for degrees in (0.1, np.rad2deg(0.003), 1.0):
            result, _ = tally(trials, ball(np.deg2rad(degrees), 0.8, 1, pool(m, least)))
            rows.append([str(m), f"{degrees:.2f}°", *result.row()])
    return table(["discs", "sigma", *HEAD], rows)


RESTART_POSE = Pose(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0.0, 0.0, 2.35]))
RESTART_RIG = Rig(
    InteriorOrientation(640, 480, 640.0, 640.0, 320.0, 240.0),
    Ball(0.6),
    Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3)),
    0.02,
)
FPS, CENTRE_SIGMA, MAP_SIGMA = 30, 0.05, 3e-4  # 1/s, px, rad
WRONG = 0.01  # rad: ten standard deviations of the attitude by three discs


def restarted(discs: np.ndarray, seed: int, seconds: int) -> tuple[float, bool]:
    """Return s until a tracker uses the saved map of `discs`, (m, 3), among ten false points, and whether it is wrong.

    The ball starts from rest with 1 rad/s² about a random axis. The false points stay. inf: never within `seconds`.
    """
    rng, m = np.random.default_rng([seed, len(discs)]), len(discs)
    tracker = build(RESTART_RIG, RESTART_POSE, Settings())
    start, axis, false = attitude(rng), unit(rng.normal(size=3)), anywhere(10, LIMB, rng)
    state = begin(tracker, 0.0, known=DiscMap(discs, MAP_SIGMA**2 * np.eye(2 * m), np.full(m, 100)))
    for frame in range(seconds * FPS + 1):
        t = frame / FPS
        R = exp(0.5 * t * t * axis) @ start
        p = discs @ R.T
        points = np.vstack([p[p[:, 2] > LIMB], false])
        uv = project(RESTART_POSE.to_cam(RESTART_RIG.ball.radius * points), RESTART_RIG.camera)[0]
        uv += CENTRE_SIGMA * rng.normal(size=uv.shape)
        seen = Detections(uv, np.tile(CENTRE_SIGMA**2 * np.eye(2), (len(uv), 1, 1)), np.full(len(uv), 50.0))
        state = advance(state, t, seen, tracker).state
        if state.absolute:
            return t, bool(np.linalg.norm(log(state.filter.attitude @ R.T)) > WRONG)
    return np.inf, False


def restart(trials: int) -> str:
    """Return the table of starts with a saved map among ten false points."""
    rows = []
    for name, m in (("well spread", 8), ("well spread", 10), ("well spread", 12), ("random", 12), ("random", 26)):
        runs = []
        for k in range(trials):
            rng = np.random.default_rng([m, k])
            discs = spread_directions(m, 0.2, rng) if name == "well spread" else scattered(m, 0.2, rng)
            runs.append(restarted(discs, k, 3))
        used, wrong = np.array(runs).T
        shares = [f"{100.0 * np.mean(used <= limit):.1f}" for limit in (0.0, 1.0, 3.0)]
        rows.append([f"{m} {name}", *shares, f"{int(wrong.sum())} of {trials}"])
    return table(["discs", "used in the first frame, %", "within 1 s, %", "within 3 s, %", "wrong"], rows)


def main() -> None:
    """Print the tables and write the first one."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("far26", type=Path, nargs="?", help="folder of the reference recording, for its layout")
    parser.add_argument("--trials", type=int, default=30_000)
    parser.add_argument("--only", metavar="TITLE", help="print only the table with this title, and write nothing")
    options = parser.parse_args()
    maps = {"26 random": pool(26, 0.2)}
    if options.far26:
        discs = unit(np.array(json.loads((options.far26 / "scene.json").read_text())["truth_disc_directions"]))
        maps["far26"] = lambda _: discs
    n = options.trials
    identify(maps["26 random"](0), maps["26 random"](1), sigma=0.01, view_axis=CAMERA)
    parts = [
        ("Fine directions", f"{n} attitudes each.", lambda: fine(n, maps)),
        (
            "Coarser directions",
            f"{n // 10} attitudes each, 26 random discs.",
            lambda: coarse(n // 10, maps["26 random"]),
        ),
        ("Nothing to identify", f"{n // 10} trials each, 26 discs.", lambda: nothing(n // 10, maps["26 random"])),
        ("Layouts that look alike", f"{n // 30} attitudes each, 10 % missing.", lambda: symmetric(n // 30)),
        (
            "Small photographs",
            f"{n // 10} balls of 20 dots each. Percent right / percent wrong.",
            lambda: photographs(n // 10),
        ),
        ("Restart", f"{n // 125} starts each, ten false points.", lambda: restart(n // 125)),
        ("Time", f"{n // 30} attitudes each, 20 % missing, one false; one thread.", lambda: speed(n // 30)),
    ]
    chosen = [part for part in parts if options.only in (None, part[0])]
    text = [f"## {title}\n\n{note}\n\n{make()}\n" for title, note, make in chosen]
    print("\n".join(text))
    if options.only:
        return
    page = Path(__file__).with_name("identification.md")
    page.write_text(page.read_text().split(MARK)[0] + MARK + "\n\n" + text[0])


if __name__ == "__main__":
    main()
