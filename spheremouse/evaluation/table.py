"""Show the metrics of evaluations as a table for a terminal or a page."""

import math
from collections.abc import Callable
from typing import Any

from rich.table import Table

from spheremouse.evaluation.detection import MIN_AREA, MIN_AXIS

Rows = tuple[tuple[str, Callable[[dict[str, Any]], str]], ...]  # label, and cell of a report

_MAX_FACTOR = 1.4  # between standard deviations and errors; a film of some seconds scatters as much


def ball_table(results: list[dict[str, Any]], title: str) -> Table:
    """Return the reports of `metrics.report` as a table with one column for each recording."""
    return _table(results, _ROWS, title, "in brackets: about or along x, y, z of obj")


def wand_table(results: list[dict[str, Any]]) -> Table:
    """Return the reports of `wand.wand_report` as a table with one column for each ball."""
    balls = [r for result in results for r in (result, *result.get("more_balls", []))]
    return _table(balls, _WAND_ROWS, "wand", "x right, y down, z away from the camera")


def _table(results: list[dict[str, Any]], rows: Rows, title: str, caption: str) -> Table:
    table = Table("", title=title, caption=caption, title_justify="left")
    for result in results:
        table.add_column(result["dataset"], justify="right")
    for label, value in rows:
        table.add_row(label, *(value(result) for result in results))
    return table


def consistency(result: dict[str, Any]) -> list[str]:
    """Return a line if standard deviations are over 1.4 times the errors, and one if errors are as much larger.

    `result` is a report of either tracker. Parts without a figure do not count.
    """
    if "anees" in result:
        values = {part: result["anees"][part] for part in ("position", "rotation", "pose")}
    else:
        nees = result["nees"] or {}
        values = {part: nees[part] and nees[part] / 3.0 for part in nees} | {"points": result["nis"]}
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


def _format(value: float | None, form: str = ".3g") -> str:
    return "–" if value is None else format(value, form)


def _each(part: dict[str, float | None] | None, *names: str, form: str = ".3g") -> str:
    """Return the values of some `names`, or of x, y and z, each formatted by `form`, or a dash for None."""
    return "–" if part is None else "  ".join(_format(part[name], form) for name in names or "xyz")


def _format_part(part: dict[str, float | None], form: str = ".3g") -> str:
    """Return the value "combined" of `part`, then those of its axes in brackets; a dash if it is None."""
    if part["combined"] is None:
        return "–"
    return f"{_format(part['combined'], form)} ({' '.join(_format(part[a], form) for a in 'xyz' if a in part)})"


def _list(result: dict[str, Any], name: str) -> str:
    values = result["pose_error"]
    return "–" if values is None else f"({' '.join(_format(v, '.2g') for v in values[name])})"


def _percent(part: dict[str, float | None] | None, name: str) -> str:
    value = None if part is None else part[name]
    return "–" if value is None else f"{100.0 * value:.1f}"


_ROWS: Rows = (
    ("frames tracked / all", lambda r: f"{r['tracked']} / {r['frames']}"),
    ("times lost", lambda r: str(r["lost_episodes"])),
    ("attitude RMSE, °", lambda r: _format_part(r["attitude_rmse_deg"])),
    ("rate RMSE, °/s", lambda r: _format_part(r["rate_rmse_deg_s"])),
    ("surface speed RMSE, mm/s", lambda r: _format_part(r["surface_speed_rmse_mm_s"])),
    ("surface speed, Pearson's r", lambda r: _format_part(r["surface_speed_r"], ".4f")),
    ("rotation scale about x y z", lambda r: _each(r["rotation_scale"], form=".5f")),
    ("  half its 95 % interval", lambda r: _each(r["rotation_scale_ci95"], form=".5f")),
    ("drift about x y z, °/min", lambda r: _each(r["drift_deg_min"], form=".2f")),
    ("  half its 95 % interval, °/min", lambda r: _each(r["drift_deg_min_ci95"], form=".2f")),
    ("points used per frame", lambda r: _format(r["mean_discs"])),
    ("recognised in the map from frame", lambda r: _format(r["identified_from_frame"], "d")),
    (f"recall of whole discs ≥ {MIN_AREA:g} px², %", lambda r: _percent(r["detection"], "recall")),
    (f"  of semi-minor axis ≥ {MIN_AXIS:g} px, %", lambda r: _percent(r["detection"], "recall_axis")),
    ("points used that are no disc, %", lambda r: _percent(r["detection"], "false_share")),
    ("disc centre RMS per axis, px", lambda r: _each(r["detection"], "centre_rms_px")),
    ("camera position error, mm", lambda r: _list(r, "position_mm")),
    ("  its standard deviation, mm", lambda r: _list(r, "sigma_position_mm")),
    ("camera rotation error, °", lambda r: _list(r, "angle_deg")),
    ("  its standard deviation, °", lambda r: _list(r, "sigma_angle_deg")),
    ("NEES of attitude, rate (3 is right)", lambda r: _each(r["nees"], "attitude", "rate")),
    ("NIS per degree of freedom (1 is right)", lambda r: _format(r["nis"])),
    ("rate, RMS second difference, °/s", lambda r: _format(r["rate_roughness_deg_s"])),
    ("RMSE / bound: attitude, rate", lambda r: _each(r["bound_ratio"], "attitude", "rate")),
    ("time per frame: median, p99, max, µs", lambda r: _each(r["frame_us"], "median", "p99", "max", form=".0f")),
    (
        "median per stage, µs",
        lambda r: "  ".join(f"{stage} {_format(us, '.0f')}" for stage, us in r["stages_us"].items()) or "–",
    ),
)
_WAND_ROWS: Rows = (
    ("frames tracked / all", lambda r: f"{r['tracked']:g} / {r['frames']}"),
    ("runs that lost the ball / all", lambda r: f"{_format(r['lost_runs'], 'd')} / {r['runs']}"),
    ("right from frame, in all runs", lambda r: _format(r["found_from_frame"], "d")),
    ("position RMSE x y z, mm", lambda r: _each(r["position_rmse_mm"])),
    ("  95th percentile, mm", lambda r: _each(r["position_p95_mm"])),
    ("  largest, mm", lambda r: _each(r["position_max_mm"])),
    (
        "rotation RMSE, 95th percentile, largest, °",
        lambda r: _each(r, "rotation_rmse_deg", "rotation_p95_deg", "rotation_max_deg"),
    ),
    ("ANEES of position, rotation, pose (1 is right)", lambda r: _each(r["anees"], "position", "rotation", "pose")),
    ("poses within their 95 % region, %", lambda r: _format(r["within_95"] and 100.0 * r["within_95"])),
    ("frames per second", lambda r: _format(r["fps"], ".0f")),
    ("time per frame: median, p99, max, µs", lambda r: _each(r["frame_us"], "median", "p99", "max", form=".0f")),
)
