"""Figures of an evaluation as a table for a terminal or a page."""

from typing import Any

from rich.table import Table


def wand_table(results: list[dict[str, Any]]) -> Table:
    """The reports side by side."""
    every = [r for result in results for r in (result, *result.get("more_balls", []))]
    table = Table(title="wand", caption="x right, y down, z away from the camera", title_justify="left")
    table.add_column("")
    for result in every:
        table.add_column(result["dataset"], justify="right")
    rows = (
        ("frames tracked / all", lambda r: f"{r['tracked']:g} / {r['frames']}"),
        ("runs that lost the ball / all", lambda r: f"{shown(r['lost_runs'], 'd')} / {r['runs']}"),
        ("right from frame, in all runs", lambda r: shown(r["found_from_frame"], "d")),
        ("position RMSE x y z, mm", lambda r: axes(r["position_rmse_mm"])),
        ("  95th percentile, mm", lambda r: axes(r["position_p95_mm"])),
        ("  largest, mm", lambda r: axes(r["position_max_mm"])),
        (
            "rotation RMSE, 95th percentile, largest, °",
            lambda r: "  ".join(shown(r[f"rotation_{k}_deg"]) for k in ("rmse", "p95", "max")),
        ),
        (
            "ANEES of position, rotation, pose (1 is right)",
            lambda r: "  ".join(shown(r["anees"][k]) for k in ("position", "rotation", "pose")),
        ),
        ("poses within their 95 % region, %", lambda r: shown(r["within_95"] and 100.0 * r["within_95"])),
        ("frames per second", lambda r: shown(r["fps"], ".0f")),
        (
            "time per frame: median, p99, max, µs",
            lambda r: "  ".join(shown(r["frame_us"][k], ".0f") for k in ("median", "p99", "max")),
        ),
    )
    for label, value in rows:
        table.add_row(label, *(value(result) for result in every))
    return table


def shown(value: float | None, form: str = ".3g") -> str:
    """A number, or a dash."""
    return "–" if value is None else format(value, form)


def axes(part: dict[str, float | None], form: str = ".3g", scale: float = 1.0) -> str:
    """x, y and z, or a dash."""
    values = [part[a] for a in "xyz"]
    return "  ".join("–" if v is None else format(scale * v, form) for v in values)
