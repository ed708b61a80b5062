"""Show the metrics of evaluations as a table for a terminal or a page."""

import math
from collections.abc import Callable
from typing import Any

from rich.table import Table

from spheremouse.evaluate.metrics import MIN_AREA, MIN_AXIS

_MAX_FACTOR = 1.4  # between standard deviations and errors; a film of some seconds scatters as much


def ball_table(results: list[dict[str, Any]], title: str) -> Table:
    """Return the reports of `metrics.report` as a table with one column for each recording."""
    table = Table(title=title, caption="in brackets: about or along x, y, z of obj", title_justify="left")
    table.add_column("")
    for result in results:
        table.add_column(result["dataset"], justify="right")
    for label, value in _ROWS:
        table.add_row(label, *[value(result) for result in results])
    return table


def wand_table(results: list[dict[str, Any]]) -> Table:
    """Return the reports of `wand.wand_report` as a table with one column for each ball."""
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


def consistency(result: dict[str, Any]) -> list[str]:
    """Return a line if standard deviations are over 1.4 times the errors, and one if errors are as much larger.

    `result` is a report of either tracker. Parts without a figure do not count.
    """
    if "anees" in result:
        values = {part: result["anees"][part] for part in ("position", "rotation", "pose")}
    else:
        nees = result["nees"] or {}
        values = {part: nees[part] and nees[part] / 3.0 for part in nees} | {"disc centres": result["nis"]}
    factors = {part: math.sqrt(value) for part, value in values.items() if value}
    large = [f"of {part} {1.0 / f:.1f} times" for part, f in factors.items() if f < 1.0 / _MAX_FACTOR]
    small = [f"of {part} {f:.1f} times" for part, f in factors.items() if f > _MAX_FACTOR]
    name, lines = result["dataset"], []
    if large:
        lines.append(
            f"{name}: standard deviations {', '.join(large)} larger than the errors: they are on the safe side"
        )
    if small:
        lines.append(f"{name}: standard deviations {', '.join(small)} smaller than the errors: do not rely on them")
    return lines


def path_notes(result: dict[str, Any]) -> list[str]:
    """Return a line that gives the reason if scales or drifts are missing although the recording has a truth."""
    scale, drift, name = result["rotation_scale"], result["drift_deg_min"], result["dataset"]
    missing = [axis for axis, value in scale.items() if value is None]
    if result["attitude_rmse_deg"]["combined"] is None:
        return []
    if len(missing) == 3 and drift["x"] is None:
        return [f"{name}: no rotation scale and drift: they need ten seconds of tracking"]
    lines = [
        f"{name}: no rotation scale about {axis}: the ball did not turn about it, or only together with another axis"
        for axis in missing
    ]
    if drift["x"] is None:
        lines.append(f"{name}: no drift: the ball turned steadily, so that the scale contains it")
    return lines


def shown(value: float | None, form: str = ".3g") -> str:
    """Return a number formatted by `form`, or a dash for None."""
    return "–" if value is None else format(value, form)


def axes(part: dict[str, float | None], form: str = ".3g", scale: float = 1.0) -> str:
    """Return the values "x", "y", "z" of `part` times `scale`, each formatted by `form`, or a dash for None."""
    values = [part[a] for a in "xyz"]
    return "  ".join("–" if v is None else format(scale * v, form) for v in values)


def _combined(part: dict[str, float | None], form: str = ".3g") -> str:
    """Return the value "combined" of `part`, then those of its axes in brackets; a dash if it is None."""
    if part["combined"] is None:
        return "–"
    return f"{shown(part['combined'], form)} ({' '.join(shown(part[a], form) for a in 'xyz' if a in part)})"


def _each(result: dict[str, Any], part: str, *names: str, form: str = ".3g") -> str:
    values = result[part]
    return "–" if values is None else "  ".join(shown(values[name], form) for name in names)


def _list(result: dict[str, Any], part: str, name: str) -> str:
    values = result[part]
    return "–" if values is None else f"({' '.join(shown(v, '.2g') for v in values[name])})"


def _percent(result: dict[str, Any], name: str) -> str:
    detection = result["detection"]
    return "–" if detection is None or detection[name] is None else f"{100.0 * detection[name]:.1f}"


_ROWS: tuple[tuple[str, Callable[[dict[str, Any]], str]], ...] = (
    ("frames tracked / all", lambda r: f"{r['tracked']} / {r['frames']}"),
    ("times lost", lambda r: str(r["lost_episodes"])),
    ("attitude RMSE, °", lambda r: _combined(r["attitude_rmse_deg"])),
    ("rate RMSE, °/s", lambda r: _combined(r["rate_rmse_deg_s"])),
    ("surface speed RMSE, mm/s", lambda r: _combined(r["surface_speed_rmse_mm_s"])),
    ("surface speed, Pearson's r", lambda r: _combined(r["surface_speed_r"], ".4f")),
    ("rotation scale about x y z", lambda r: axes(r["rotation_scale"], ".5f")),
    ("  half its 95 % interval", lambda r: axes(r["rotation_scale_ci95"], ".5f")),
    ("drift about x y z, °/min", lambda r: axes(r["drift_deg_min"], ".2f")),
    ("  half its 95 % interval, °/min", lambda r: axes(r["drift_deg_min_ci95"], ".2f")),
    ("discs used per frame", lambda r: shown(r["mean_discs"])),
    ("recognised in the map from frame", lambda r: shown(r["identified_from_frame"], "d")),
    (f"recall of whole discs ≥ {MIN_AREA:g} px², %", lambda r: _percent(r, "recall")),
    (f"  of semi-minor axis ≥ {MIN_AXIS:g} px, %", lambda r: _percent(r, "recall_axis")),
    ("points used that are no disc, %", lambda r: _percent(r, "false_share")),
    ("disc centre RMS per axis, px", lambda r: _each(r, "detection", "centre_rms_px")),
    ("camera position error, mm", lambda r: _list(r, "pose_error", "position_mm")),
    ("  its standard deviation, mm", lambda r: _list(r, "pose_error", "sigma_position_mm")),
    ("camera rotation error, °", lambda r: _list(r, "pose_error", "angle_deg")),
    ("  its standard deviation, °", lambda r: _list(r, "pose_error", "sigma_angle_deg")),
    ("NEES of attitude, rate (3 is right)", lambda r: _each(r, "nees", "attitude", "rate")),
    ("NIS per degree of freedom (1 is right)", lambda r: shown(r["nis"])),
    ("RMSE / bound: attitude, rate", lambda r: _each(r, "bound_ratio", "attitude", "rate")),
    ("time per frame: median, p99, max, µs", lambda r: _each(r, "frame_us", "median", "p99", "max", form=".0f")),
    (
        "median per stage, µs",
        lambda r: "  ".join(f"{stage} {shown(us, '.0f')}" for stage, us in r["stages_us"].items()) or "–",
    ),
)
