"""A layout of ours beside random ones that are merely well spread."""

import numpy as np
from rich.console import Console
from rich.table import Table

from spheremouse.calibrate.layout.search import default_steps, judge, recognised
from spheremouse.commands.layout.make import searched
from spheremouse.commands.layout.words import MISSING, TRIALS
from spheremouse.commands.terminal import progress_bar
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.scene import spread_directions

_COARSER = (0.1, 0.5, 1.0)  # deg
COMPARED = (
    ("discs in view, least", "{:.0f}"),
    ("nearest discs, degrees", "{:.1f}"),
    ("contradictions, worst view", "{:.1f}"),
    ("contradictions, 1 % of views", "{:.1f}"),
    ("contradictions, median view", "{:.1f}"),
    *((f"recognised at {sigma} degrees, %", "{:.1f}") for sigma in _COARSER),
    ("never mistaken, %", "{:.1f}"),
)


def compare_layout(n: int, angle: float, apart: float, seed: int, others: int) -> None:
    """A table: our layout beside random ones that are merely well spread."""
    steps = default_steps(n)
    with progress_bar() as bar:
        task = bar.add_task(f"comparing {n} discs", total=steps + others * max(1, steps // 50))
        ours = np.zeros((0, 3))
        for step in searched(n, angle, apart, seed, steps):
            ours = step.directions
            bar.update(task, completed=step.done)
        found = [_compared(ours, angle)]
        for k in range(others):
            found.append(_compared(spread_directions(n, apart, np.random.default_rng([seed, 1, k])), angle))
            bar.advance(task, max(1, steps // 50))
    random = np.array(found[1:])
    table = Table(title=f"{n} discs, in view within {np.degrees(angle):g} degrees", title_justify="left")
    table.add_column("")
    for name in ("this layout", f"median of {others}", "best", "worst"):
        table.add_column(name, justify="right")
    for row, (name, form) in enumerate(COMPARED):
        column = np.sort(random[:, row])
        values = (found[0][row], float(np.median(column)), column[-1], column[0])
        table.add_row(name, *(form.format(v) for v in values))
    Console(soft_wrap=True).print(table)


def _compared(directions: Array, angle: float) -> list[float]:
    j = judge(directions, angle)
    trials = [recognised(directions, angle, np.radians(s), MISSING, TRIALS, np.random.default_rng(0)) for s in _COARSER]
    return [
        float(j.in_view),
        float(np.degrees(j.apart)),
        j.separability,
        float(np.quantile(j.contradictions, 0.01)),
        float(np.median(j.contradictions)),
        *(100.0 * t.found for t in trials),
        100.0 * (1.0 - max(t.wrong for t in trials)),
    ]
