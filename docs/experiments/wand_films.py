"""The experiments of the wand: which films, which trackers, one job at a time, and the table of what came out.

A job is one film (options and seed) with several trackers that see the same frames, rendered once. Its result is plain
data, so that it can be kept in a file and taken up again. Compared with Grzonka 2005, chapter 4.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.kit.balls import contrast_ball, led_ball
from spheremouse.evaluation.wand import WandHistory, WandRun, assign_truths, found_from, is_lost
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.wand import open_wand
from spheremouse.geometry.rotation import Array
from spheremouse.session.offline import track_wand
from spheremouse.simulate.wand.film import WandFilm, WandOptions, prepare_wand, simulate_wand
from spheremouse.wand.ball import WandBall, WandTruth, grzonka_ball
from spheremouse.wand.build import build
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.track import begin, step

BALLS = {"grzonka": grzonka_ball, "contrast": contrast_ball, "led": led_ball}
RECORDING = "wand_drive"  # of the shared datasets
FOUND_WITHIN = 5  # frames, of a start without an initial pose


@dataclass(frozen=True, slots=True)
class Variant:
    name: str
    settings: WandSettings
    known: bool = False  # begins with the true pose, as the thesis did


@dataclass(frozen=True, slots=True)
class Film:
    """Films for every seed."""

    name: str
    words: str  # for a reader
    options: WandOptions
    seeds: tuple[int, ...]
    variants: tuple[Variant, ...]
    ball: str = "grzonka"


@dataclass(frozen=True, slots=True)
class Job:
    """One film with one seed: the unit of work, and of what is kept."""

    film: Film
    seed: int

    @property
    def key(self) -> str:
        return f"{self.film.name}-{self.seed:02d}"


def _particles(n: int, **more: Any) -> WandSettings:
    return WandSettings(particles=n, **more)


def thesis_motion(n: int, **more: Any) -> WandSettings:
    """A random walk with the thesis' standard deviations (Grzonka 2005, chapter 4), no memory of the speed."""
    small = 0.005 * np.pi
    return _particles(n, adaptive=False, sigma_y=0.005, sigma_pitch=small, sigma_roll=small, **more)


def thesis_settings(n: int) -> WandSettings:
    """All as in the thesis: its motion, its likelihood; no peaks, no outline."""
    return thesis_motion(n, method="product", outline=False)


_OWN = Variant("350, own start", _particles(350))
_KNOWN = tuple(Variant(f"{n}, known start", _particles(n), known=True) for n in (50, 350))


def films(quick: bool) -> tuple[Film, ...]:
    """Return the films; `quick`: fewer seeds and particles, some minutes."""
    seeds = tuple(range(1, 3 if quick else 21))
    few = tuple(range(1, 2 if quick else 7))
    ours = _OWN
    drive = (
        *_KNOWN, ours, Variant("350, without the outline", _particles(350, outline=False), known=True),
        Variant("350, the thesis' motion", thesis_motion(350), known=True),
        Variant("350, drawn by the thesis' motion alone", thesis_motion(350, method="rims"), known=True),
        *(Variant(f"{n}, all as in the thesis", thesis_settings(n), known=True) for n in (50, 350)),
    )  # fmt: skip
    many = (5000,) if quick else (5000, 50_000)
    crowd = (
        *(Variant(f"{n}, known start", _particles(n), known=True) for n in many),
        *(Variant(f"{n}, all as in the thesis", thesis_settings(n), known=True) for n in many),
    )
    hand = WandOptions(motion="hand", blur=0.008)
    chosen = [
        Film("drive", "the thesis' drive, 0.8 Hz", WandOptions(), seeds, drive),
        Film("drive-many", "the same, many particles", WandOptions(), few, crowd),
        Film("drive-hand", "a hand passes, 0.8 Hz", WandOptions(hand=80.0), few, (ours,)),
    ]
    if quick:
        return tuple(chosen)
    part = WandOptions(begin=58.0, seconds=24.0)
    return (
        *chosen,
        Film("hand-held", "0.4 m/s, 180 °/s, 15 Hz", hand, seeds, (ours,)),
        Film("drive-7.5", "part with turns, 7.5 Hz", replace(part, fps=7.5), few, (ours,)),
        Film("drive-30", "part with turns, 30 Hz", replace(part, fps=30.0, seconds=16.0), few, (ours,)),
        Film("drive-fast", "7 cm/s, 100 °/s, 0.8 Hz", WandOptions(speed=0.07), few, (ours,)),
        Film("drive-sun", "outdoors with glare, 0.8 Hz", WandOptions(light="outdoor"), few, (ours,)),
        Film("hand-card", "a card in both colours, 15 Hz", replace(hand, card=8.0), few, (ours,)),
        Film("hand-hand", "a hand passes, 15 Hz", replace(hand, hand=8.0), few, (ours,)),
        Film("hand-sun", "outdoors with glare, 15 Hz", replace(hand, light="outdoor"), few, (ours,)),
        Film("two", "two balls, hand-held, 15 Hz", replace(hand, balls=2, distance=1.4), few, (ours,)),
        Film("contrast", "one colour, dark on white, 15 Hz", hand, few, (ours,), "contrast"),
        Film("led", "lit discs on black, 15 Hz", replace(hand, clutter=False), few, (ours,), "led"),
    )


def jobs(quick: bool) -> list[Job]:
    """All of them, the longest first."""
    found = [Job(film, seed) for film in films(quick) for seed in film.seeds]
    return sorted(found, key=lambda job: -len(job.film.variants))


def work(job: Job) -> dict[str, Any]:
    """Film and track: per variant and ball the run and its truth, as lists of numbers."""
    film = prepare_wand(replace(job.film.options, seed=job.seed), BALLS[job.film.ball]())
    balls = tuple(carried.ball for carried in film.scene.balls)
    truths = [film.truth(k) for k in range(len(balls))]
    fed = {}
    for variant in job.film.variants:
        tracker = build(film.scene.camera, balls, variant.settings)
        known = {k: (t.position[0], t.rotation[0]) for k, t in enumerate(truths)} if variant.known else None
        fed[variant.name] = _Fed(lambda frames, t=tracker, p=known: track_wand(frames, t, job.seed, p))
    for shot in simulate_wand(film):
        for each in fed.values():
            each.feed(shot.frame)
    runs = {name: [each.history.run(k) for k in range(len(balls))] for name, each in fed.items()}
    return {"variants": {name: kept_of(of_balls, balls, truths) for name, of_balls in runs.items()}}


def kept_of(runs: Sequence[WandRun], balls: Sequence[WandBall], truths: Sequence[WandTruth]) -> list[dict[str, Any]]:
    """Return the stored part of a run with each ball. Equal balls have numbers in the order of detection."""
    return [
        _kept(run, truth, ball.radius)
        for run, ball, truth in zip(runs, balls, assign_truths(runs, balls, truths, balls), strict=True)
        if truth is not None
    ]


def recording_film(quick: bool) -> Film:
    """The shared recording, which Blender rendered: other seeds of the filter on the same pictures."""
    variants, seeds = ((_KNOWN[-1],), 1) if quick else ((*_KNOWN, _OWN), 20)
    return Film(RECORDING, "the shared recording, 0.8 Hz", WandOptions(), tuple(range(1, seeds + 1)), variants)


def work_recording(path: Path, variant: Variant, seeds: Sequence[int]) -> dict[str, Any]:
    """As `work`, of a recording with one ball: per seed the run and its truth."""
    recording = open_wand(path)
    truth, ball = recording.truths[0], recording.balls[0]
    tracker = build(recording.camera, (ball,), variant.settings)
    known = {0: (truth.position[0], truth.rotation[0])} if variant.known else None
    runs = [_Fed(lambda frames, s=seed: track_wand(frames, tracker, s, known)) for seed in seeds]
    for frame in read_frames(recording):
        for fed in runs:
            fed.feed(frame)
    return {"variants": {variant.name: [_kept(fed.history.run(0), truth, ball.radius) for fed in runs]}}


class _Fed:
    """A run that is given its frames one by one."""

    def __init__(self, start: Callable[[Iterator[Any]], Iterator[Any]]) -> None:
        self.history = WandHistory()
        self._next: Any = None
        self._epochs = start(iter(lambda: self._next, self))

    def feed(self, frame: Any) -> None:
        self._next = frame
        self.history.add(next(self._epochs))


def _kept(run: WandRun, truth: WandTruth, radius: float) -> dict[str, Any]:
    """Errors of one run, and what it takes to put them together with others: nothing else need be kept."""
    k = np.flatnonzero(run.found)
    return {
        "lost": bool(is_lost(run, truth, radius)), "found_from": found_from(run, truth, radius),
        "frames": len(run.stamp), "index": k.tolist(), "position": run.position[k].tolist(),
        "rotation": run.rotation[k].tolist(),
        "covariance": [np.asarray(c)[np.triu_indices(6)].tolist() for c in run.covariance[k]],
        "true_position": truth.position[k].tolist(), "true_rotation": truth.rotation[k].tolist()
    }  # fmt: skip


def restored(kept: Sequence[dict[str, Any]]) -> tuple[list[WandRun], list[WandTruth]]:
    """The tracked frames of results."""
    runs, truths = [], []
    for result in kept:
        n = len(result["index"])
        covariance = np.zeros((n, 6, 6))
        upper = np.triu_indices(6)
        covariance[:, upper[0], upper[1]] = np.array(result["covariance"]).reshape(n, 21)
        covariance[:, upper[1], upper[0]] = covariance[:, upper[0], upper[1]]
        stamp = np.array(result["index"], dtype=float)

        def of(name: str, *shape: int, result: dict[str, Any] = result, n: int = n) -> Array:
            return np.array(result[name], dtype=float).reshape(n, *shape)

        runs.append(WandRun(stamp, of("position", 3), of("rotation", 3, 3), covariance, np.zeros(n)))
        truths.append(WandTruth(stamp, of("true_position", 3), of("true_rotation", 3, 3)))
    return runs, truths


# ---- speeds ----


_REDUCED_FROM_PARTICLES = 5000  # particles: with more a third of the pictures is enough
SPEEDS = {
    "50 particles, whole frame": WandSettings(particles=50, region=False),
    "350 particles, whole frame": WandSettings(region=False),
    "350 particles, region of interest": WandSettings(),
    "5000 particles, region of interest": WandSettings(particles=5000),
    "5000 particles, whole frame": WandSettings(particles=5000, region=False),
    "50000 particles, whole frame": WandSettings(particles=50_000, region=False),
}


def speed_film(frames: int) -> WandFilm:
    """The thesis' scene at 30 Hz, while the robot drives."""
    return prepare_wand(WandOptions(fps=30.0, begin=40.0, seconds=frames / 30.0, seed=1))


def measure_speeds(frames: int = 60) -> dict[str, Any]:
    """Median frames per second of each of `SPEEDS`, pictures in memory; 90th percentile of the time per frame, ms.

    Measured alone, after everything else. Balls are tracked; the first frames, which search, are left out.
    """
    film = speed_film(frames)
    pictures = [shot.frame for shot in simulate_wand(film)]
    found = {}
    for name, settings in SPEEDS.items():
        tracker = build(film.scene.camera, (film.scene.balls[0].ball,), settings)
        times = []
        shown = pictures[: len(pictures) // 3] if settings.particles > _REDUCED_FROM_PARTICLES else pictures
        for _ in range(2):
            state = begin(tracker, 1, shown[0].stamp)
            for frame in shown:
                start = time.perf_counter()
                state = step(state, frame, tracker).state
                times.append(time.perf_counter() - start)
        settled = np.array(times[len(shown) + 3 :])
        found[name] = {
            "fps": float(1.0 / np.median(settled)),
            "mean_fps": float(1.0 / np.mean(settled)),
            "p90_ms": float(1e3 * np.quantile(settled, 0.9)),
        }
    return found


def recording_key(variant: Variant) -> str:
    return f"{RECORDING}-{variant.name.replace(', ', '-').replace(' ', '-')}"
