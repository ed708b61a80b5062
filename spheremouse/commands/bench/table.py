"""The figures of a measurement as a table, and notes below it."""

from collections.abc import Iterator
from typing import Any

from rich import box
from rich.table import Table

from spheremouse.commands.bench.series import (
    BLOBS,
    COMPARED,
    DETECT,
    FILTER,
    MEMORY_FROM,
    SIMPLE,
    STEP,
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
    """Times with their ratios."""
    width, height = figures["size"]
    rows = Table(
        title=f"{figures['dataset']}, {width}x{height}, one thread; times in ms", title_justify="left", box=box.SIMPLE
    )
    rows.add_column("", no_wrap=True)
    for name in ("median", "p99", "worst", "ratio"):
        rows.add_column(name, justify="right", no_wrap=True)
    ratios = figures["ratios"]
    rounds = f", {figures['repeat']} rounds" if figures["repeat"] > 1 else ""
    rows.add_row(f"[bold]same {figures['frames']} frames, in turn{rounds}[/]")
    for name in COMPARED:
        rows.add_row(_NAMES[name], *_ms(figures["us"][name]), _ratio(ratios.get(name)))
    row = figures["steady"]
    if row is not None:
        rows.add_section()
        rows.add_row(f"[bold]{row['steps'] + WARM_UP:,} steps in a row[/]")
        rows.add_row("step", *_ms(row["us"]))
        rows.add_row("  its processor time", *_ms(row["processor_us"]))
        rows.add_row("  p99 over median", "", "", "", _ratio(ratios["p99"]))
        rows.add_row("  worst over median", "", "", "", _ratio(ratios["max"]))
        if row["memory_bytes"] is not None:
            grown = row["memory_bytes"]["end"] - row["memory_bytes"]["early"]
            rows.add_row(f"  memory after {MEMORY_FROM:,} steps", "", "", "", f"{grown / 2**20:+.1f} MB")
    if figures["sizes"]:
        rows.add_section()
        rows.add_row("[bold]far scene, in turn[/]")
        for name, steps in figures["sizes"].items():
            rows.add_row(name, *_ms(steps["us"]), _ratio(ratios.get(name)))
    return rows


def _ms(us: dict[str, float]) -> Iterator[str]:
    return (f"{us[name] / 1000.0:.2f}" for name in ("median", "p99", "max"))


def _ratio(ratio: float | None) -> str:
    if ratio is None:
        return ""
    return f"{ratio:.1f}×" if ratio >= 10.0 else f"{ratio:.2f}×"


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
    if any(t < TRACKED * n for n, t in ran.values()):
        few = f"the ball is tracked in less than {100 * TRACKED:.0f} % of the frames"
        yield f"{few}: these times are not those of tracking"
