"""A new layout, searched for and judged, and what layout.json says of it."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from spheremouse.calibrate.layout.guide import Accuracy, Design, on_the_tape, places
from spheremouse.calibrate.layout.search import (
    Step,
    default_steps,
    in_order,
    inaccurate,
    judge,
    recognised,
    search,
)
from spheremouse.commands.layout.words import MISSING, SIGMA, TRIALS, figures
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import ConfigurationError

_CARELESS = (0.2, 0.5, 1.0, 2.0, 4.0)  # of the distance at which places pass for alike


def designed(n: int, radius: float, disc_radius: float, angle: float, seed: int) -> Design:
    tries = int(np.clip(500 // n, 5, 20))
    steps = default_steps(n)
    with progress_bar() as bar:
        task = bar.add_task(f"placing {n} discs", total=steps + len(_CARELESS) * max(1, steps // 20))
        directions = np.zeros((0, 3))
        for step in searched(n, angle, 3.0 * disc_radius / radius, seed, steps):
            directions = step.directions
            bar.update(task, completed=step.done)
        directions = on_the_tape(in_order(directions), radius)
        judgement = judge(directions, angle)
        rng = np.random.default_rng(seed)
        trials = recognised(directions, angle, SIGMA, MISSING, TRIALS, rng)
        accuracy = []
        sds = judgement.alike * np.array(_CARELESS)
        for sd, (separability, in_view) in zip(sds, inaccurate(directions, angle, sds, tries, rng), strict=True):
            accuracy.append(Accuracy(1e3 * radius * sd, float(separability.min()), int(in_view.min())))
            bar.advance(task, max(1, steps // 20))
    return Design(
        directions, radius, disc_radius, angle, seed, judgement, trials, SIGMA, MISSING, tuple(accuracy), tries
    )


def searched(n: int, angle: float, apart: float, seed: int, steps: int | None = None) -> Iterator[Step]:
    try:
        yield from search(n, angle, apart, seed, steps)
    except ValueError as e:
        raise ConfigurationError(f"--discs {n}: {e}; take fewer or smaller discs") from None


def described(design: Design) -> dict[str, Any]:
    """Content of layout.json; `--check` reads it."""
    return {
        "made_by": "spheremouse layout",
        "ball": {"radius": design.radius},
        "disc_radius": design.disc_radius,
        "view_angle_deg": round(float(np.degrees(design.view_angle)), 6),
        "seed": design.seed,
        "directions": [[round(float(x), 6) for x in d] for d in design.directions],
        "places_mm": [
            {"disc": p.number, "band": p.band, "from_pole": p.from_pole, "checks": [list(c) for c in p.checks]}
            for p in places(design.directions, design.radius)
        ],
        **figures(design.judgement, design.trials, design.radius),
        "misplaced_tries": design.tries,
        "misplaced": [
            {"sd_mm": round(a.sd_mm, 2), "separability": round(a.separability, 2), "in_view": a.in_view}
            for a in design.accuracy
        ],
    }


def careless(design: Design) -> str:
    if design.bears_mm > 0.0:
        return f"put up by eye: stays clear with discs off by {design.bears_mm:.0f} mm (sd to either side)"
    return "put up by eye: some views look alike however exactly the discs are placed; more discs help"
