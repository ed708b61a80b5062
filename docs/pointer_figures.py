"""The figure and the table of docs/pointer.md: python docs/pointer_figures.py [--write] [--figure].

The figure shows a ball with exact counts and rates, the table simulated films that the tracker tracked. Print the
table. `--write` replaces the figure and the rows of the page. It takes about two minutes, and the extra `plot`.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from experiments.kit.render import save

from spheremouse.ball.build import build
from spheremouse.ball.settings import Settings
from spheremouse.files.safe_files import write_atomically
from spheremouse.geometry.rotation import Array
from spheremouse.output.counts import Counter, MotionSettings
from spheremouse.output.pointer import PointerSettings, Resampler, due, take
from spheremouse.session.offline import initialise, track
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.tracker import Status

PAGE = Path(__file__).with_name("pointer.md")
IMAGES = Path(__file__).parent / "images"
MARKS = ("<!-- made by docs/pointer_figures.py --write -->", "<!-- end -->")
LATENCY = {30.0: 0.05, 60.0: 0.03}  # s, from stamp to arrival: exposure, the wire, decoding, a step
WAYS = {  # settings, and whether the prediction uses an acceleration
    "horizon 0": (PointerSettings(horizon=0.0), True),
    "no acceleration": (PointerSettings(), False),
    "smooth 0": (PointerSettings(smooth=0.0), True),
    "default": (PointerSettings(), True),
}
ON_PAGE = ("horizon 0", "default")
FILMS = {
    "play, 30 Hz": SimulationOptions(motion="play", seconds=20.0, noise=3.0),
    "play, 60 Hz": SimulationOptions(motion="play", seconds=20.0, noise=3.0, fps=60.0),
    "flick (400 °/s, stop in 50 ms, reversal), 30 Hz": SimulationOptions(motion="flick", noise=3.0),
    "flick, 60 Hz": SimulationOptions(motion="flick", noise=3.0, fps=60.0),
}


@dataclass(frozen=True)
class Told:
    """Frames, and the ball itself."""

    stamp: Array  # (n,) s
    counts: Array  # (n, 3)
    rate: Array  # (n, 3) counts/s
    tracking: Array  # (n,) bool
    clock: Array  # (m,) s
    place: Array  # (m, 3) counts, of the ball


def pointer(told: Told, latency: float, settings: PointerSettings, accelerated: bool = True) -> tuple[Array, Array]:
    """Return times (k,) s of the reports at the steady rate, and the pointer's positions, (k, 3) counts."""
    times, places = [], []
    resampler, sent = Resampler(), (0, 0, 0)
    arrivals = [*(told.stamp + latency), told.stamp[-1] + 1.0]
    for k, stamp in enumerate(told.stamp):
        now, rate = arrivals[k], tuple(told.rate[k].tolist()) if told.tracking[k] else None
        x, y, z = (int(n) for n in told.counts[k])
        if not accelerated:
            resampler = replace(resampler, rate=None)
        resampler = take(resampler, sent, (x, y, z), rate, stamp, now, settings)
        for n in range(int((arrivals[k + 1] - now) * settings.rate + 1.0 - 1e-6)):
            times.append(now + n / settings.rate)
            sent = due(resampler, times[-1])
            places.append(sent)
    return np.array(times), np.array(places, dtype=float)


# ---- the table ----


def filmed(options: SimulationOptions) -> Told:
    """A simulated film, tracked."""
    simulation, settings = prepare(options), Settings()
    rig = simulation.scene.rig()
    start = initialise((made.frame for made in simulate(simulation)), rig, settings)
    tracker = build(rig, start.pose, settings)
    epochs = [(e.estimate, e.state.status is Status.TRACKING) for e in track(start.frames, tracker, None)]
    stamp = np.array([m.stamp for m, _ in epochs])
    clock = np.arange(stamp[0], stamp[-1], 1e-3)
    matrix = MotionSettings().matrix(rig.radius_m)
    speed = simulation.profile.rate(clock) @ matrix.T
    place = np.cumsum(np.vstack([np.zeros(3), speed[:-1]]), axis=0) * 1e-3
    counter = Counter(matrix)
    made = [counter.counts(m) for m, _ in epochs]
    counts, rate = np.array([c for c, _ in made], dtype=float), np.array([rate or (0.0, 0.0, 0.0) for _, rate in made])
    return Told(stamp, counts, rate, np.array([t for _, t in epochs]), clock, place)


def figures(told: Told, latency: float, settings: PointerSettings, accelerated: bool) -> list[str]:
    """Cells of a row: roughness, distance from the ball, and what is withheld at the end."""
    times, places = pointer(told, latency, settings, accelerated)
    clock = np.arange(times[0], told.clock[-1], 0.004)
    shown = places[np.searchsorted(times, clock + 1e-9) - 1]
    ball = np.stack([np.interp(clock, told.clock, told.place[:, k]) for k in range(3)], axis=1)
    rough, off = np.sqrt(np.mean(np.diff(shown, 2, axis=0) ** 2)), np.sqrt(np.mean((shown - ball) ** 2))
    left = np.abs(places[-1] - told.counts.sum(axis=0)).max()
    return [f"{rough:.2f}", f"{off:.1f}", f"{np.abs(shown - ball).max():.0f}", f"{left:.0f}"]


def rows_of_films() -> list[list[str]]:
    """Return a row for each film and way."""
    rows = []
    for film, options in FILMS.items():
        told = filmed(options)
        for way, (settings, accelerated) in WAYS.items():
            rows.append([film, way, *figures(told, LATENCY[options.fps], settings, accelerated)])
    return rows


def table(rows: list[list[str]]) -> str:
    """Return rows as Markdown."""
    head = ["film", "", "roughness", "from the ball, RMS", "at most", "withheld at the end"]
    return "\n".join(f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *rows])


# ---- the figure ----


def exact(stretches: Sequence[tuple[float, float]], fps: float = 30.0) -> Told:
    """Frames of a ball whose rate (counts/s) runs straight from one (time, rate) to the next."""
    clock = np.arange(0.0, stretches[-1][0], 1e-4)
    speed = np.interp(clock, *np.array(stretches).T)
    place = np.concatenate([[0.0], np.cumsum(speed[:-1])]) * 1e-4
    stamp = np.arange(1.0 / fps, clock[-1], 1.0 / fps)
    total = np.round(np.interp(stamp, clock, place))
    three = np.array([[1.0, 0.0, 0.0]])
    return Told(
        stamp,
        np.diff(total, prepend=0.0)[:, None] * three,
        np.interp(stamp, clock, speed)[:, None] * three,
        np.ones(len(stamp), dtype=bool),
        clock,
        place[:, None] * three,
    )


STOP = (
    (0.0, 0),
    (0.1, 0),
    (0.25, 1500),
    (0.45, 1500),
    (0.55, 0),
    (0.8, 0),
    (0.9, 900),
    (1.2, 900),
    (1.35, 0),
    (1.5, 0),
)
REVERSAL = ((0.0, 0), (0.1, 0), (0.25, 1500), (0.5, 1500), (0.7, -1500), (1.0, -1500), (1.25, 0), (1.5, 0))
PANELS = {"a stop within 0.1 s, and on": STOP, "a reversal": REVERSAL}


def draw(canvas: Any) -> None:
    """The figure."""
    axes = canvas.subplots(1, 2)
    for axis, (title, stretches) in zip(axes, PANELS.items(), strict=True):
        told = exact(stretches)
        axis.plot(told.clock, told.place[:, 0], color="0.5", alpha=0.6, linewidth=4.0, linestyle="-", label="the ball")
        for label, colour, settings in (
            ("horizon 0", "C1", PointerSettings(horizon=0.0)),
            ("default", "C0", PointerSettings()),
        ):
            times, places = pointer(told, LATENCY[30.0], settings)
            shown = times < told.clock[-1]
            axis.step(times[shown], places[shown, 0], where="post", color=colour, linestyle="-", label=label)
        axis.set(title=title, xlabel="s", xlim=(0.0, 1.5))
    axes[0].set_ylabel("counts")
    canvas.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)


def main() -> None:
    """Draw, and print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="replace figure and table of the page")
    parser.add_argument("--figure", action="store_true", help="draw the figure alone")
    given = parser.parse_args()
    if given.write or given.figure:
        save("pointer", draw, IMAGES, (7.2, 3.5))
    if given.figure:
        return
    rows = rows_of_films()
    print(table(rows))
    if given.write:
        before, rest = PAGE.read_text(encoding="utf-8").split(MARKS[0])
        after = rest.split(MARKS[1])[1]
        made = table([row for row in rows if row[1] in ON_PAGE])
        write_atomically(PAGE, f"{before}{MARKS[0]}\n\n{made}\n\n{MARKS[1]}{after}")


if __name__ == "__main__":
    main()
