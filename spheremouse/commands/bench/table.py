"""The figures of a measurement as a table, and notes below it."""

from collections.abc import Iterator
from typing import Any

from rich import box
from rich.table import Table

from spheremouse.commands.bench.figures import Target, targets
from spheremouse.commands.bench.series import (
    BLOBS,
    COMPARED,
    DETECT,
    FILTER,
    MEMORY_FROM,
    MEMORY_STEPS,
    SIMPLE,
    SIZES,
    STEP,
    STEPS,
    TRACKED,
    WARM_UP,
)

_NAMES = {
    STEP: "step: detect and filter",
    DETECT: "  its detect stage",
    FILTER: "  its filter stage",
    BLOBS: "multi-mask detector alone",
    SIMPLE: "cv2.SimpleBlobDetector alone",
}


def table(figures: dict[str, Any]) -> Table:
    """Figures beside what was asked for."""
    width, height = figures["size"]
    rows = Table(
        title=f"{figures['dataset']}, {width}x{height}, one thread; times in ms", title_justify="left", box=box.SIMPLE
    )
    rows.add_column("", no_wrap=True)
    for name in ("median", "p99", "worst", "ratio", "target", ""):
        rows.add_column(name, justify="left" if name == "" else "right", no_wrap=True)
    asked = {t.what: t for t in targets(figures)}
    rounds = f", {figures['repeat']} rounds" if figures["repeat"] > 1 else ""
    rows.add_row(f"[bold]same {figures['frames']} frames, in turn{rounds}[/]")
    for name in COMPARED:
        rows.add_row(_NAMES[name], *_ms(figures["us"][name]), *_judged(asked.get(name), "×"))
    row = figures["steady"]
    if row is not None:
        rows.add_section()
        rows.add_row(f"[bold]{row['steps'] + WARM_UP:,} steps in a row[/]")
        rows.add_row("step", *_ms(row["us"]))
        rows.add_row("  its processor time", *_ms(row["processor_us"]))
        rows.add_row("  p99 over median", "", "", "", *_judged(asked["p99"], "×"))
        rows.add_row("  worst over median", "", "", "", *_judged(asked["max"], "×"))
        if "memory" in asked:
            rows.add_row(f"  memory after {MEMORY_FROM:,} steps", "", "", "", *_judged(asked["memory"], "MB"))
    if figures["sizes"]:
        rows.add_section()
        rows.add_row("[bold]far scene, in turn[/]")
        for name, steps in figures["sizes"].items():
            rows.add_row(name, *_ms(steps["us"]), *_judged(asked.get(name), "×"))
    return rows


def _ms(us: dict[str, float]) -> Iterator[str]:
    return (f"{us[name] / 1000.0:.2f}" for name in ("median", "p99", "max"))


def _judged(target: Target | None, unit: str) -> tuple[str, str, str]:
    if target is None:
        return "", "", ""
    limit = f"≥ {target.at_least:g}×" if target.at_least is not None else f"≤ {target.at_most:g}×"
    figure = f"{target.figure:.1f}×" if target.figure >= 10.0 else f"{target.figure:.2f}×"
    if unit == "MB":
        figure, limit = f"{target.figure / 2**20:+.1f} MB", "≤ 1 MB"
    word = {True: "[green]met[/]", False: "[red]not met[/]", None: "[dim]not judged[/]"}[target.met]
    return figure, limit, word


def notes(figures: dict[str, Any]) -> Iterator[str]:
    """Notes below the table."""
    us, row = figures["us"], figures["steady"]
    ran = {"compared": (figures["frames"], figures["tracked"])}
    many = ({"in a row": row} if row is not None else {}) | figures["sizes"]
    ran |= {name: (s["steps"], s["tracked"]) for name, s in many.items()}
    lost = sum(s["lost_episodes"] for s in many.values())
    yield "tracked: " + ", ".join(f"{t:,} of {n:,} {name}" for name, (n, t) in ran.items())
    if many:
        yield f"lost: {lost} times" if lost else "lost: never"
    if row is not None and row["slowest_event"]:
        yield f"the slowest step in a row: {row['slowest_event']}"
    yield f"start: {figures['start_us'] / 1e6:.2f} s for the compiled functions, before the first frame"
    yield (
        f"faster than real time: {figures['times_faster_than_real_time']:.1f} times by the median, "
        f"{figures['interval_us'] / us[STEP]['p99']:.1f} by the 99th percentile, "
        f"{figures['interval_us'] / us[STEP]['max']:.1f} by the slowest frame"
    )
    threads = ", ".join(f"{name} {n}" for name, n in figures["threads"].items())
    yield f"not counted: the first {WARM_UP} frames of each; ratios: of medians; threads: {threads}"
    why = []
    if tuple(figures["size"]) != SIZES[0]:
        why.append(f"pictures of {SIZES[0][0]}x{SIZES[0][1]}")
    if row is not None and row["steps"] + WARM_UP < STEPS:
        why.append(f"--steps {STEPS} for p99 and worst")
    if row is not None and row["memory_bytes"] is not None and row["steps"] + WARM_UP < MEMORY_STEPS:
        why.append(f"--steps {MEMORY_STEPS} for memory")
    if any(t < TRACKED * n for n, t in ran.values()):
        why.append(f"a ball that is tracked in {100 * TRACKED:.0f} % of the frames")
    if why:
        yield f"to be judged it takes {', '.join(why)}"
