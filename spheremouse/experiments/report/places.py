"""What the experiments on where the ball is seen are said to show: tables, figures and sentences."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.places import (
    DISCS,
    FAR,
    FOCAL,
    LENSES,
    NEAR_BEST,
    NOISE,
    TOP,
    Place,
    Size,
    jobs,
    lens_of,
)
from spheremouse.experiments.report.page import failures, value
from spheremouse.experiments.report.plot import BOUND

_POSED = 3  # targets that make a pose
_SPAN = 1.5  # times the least error: the least that colours tell apart
_QUANTITIES = (
    ("attitude_deg", "attitude_rmse_deg", "attitude", "°", 4),
    ("rate_deg_s", "rate_rmse_deg_s", "rate", "°/s", 3),
)


def section(request: Request, results: Results) -> Section:
    """The maps, the films beside them, and where to put the camera."""
    around = [entry for key in ("directions-0", "directions-1") for entry in _of(results, key, "map")]
    along = _of(results, "distances", "map")
    rows = _films(results)
    first = next((r for k, r in results.items() if "noise" in r), None)
    frames = jobs(request)[0].parameters["frames"]
    parts: list[str | Table | Figure] = [
        f"{DISCS} discs, the device's frame, 640x480 pixels, the first {frames} frames of the thesis' motion, noise "
        f"of {NOISE:g} grey values. What is mapped is the Cramér-Rao bound, by geometry alone: the discs that are "
        "wholly in view, and how well centres of their size are measured. The camera looks at the middle of ball and "
        "frame. "
        "At some places films were rendered and tracked; their own bound has the noise of their own centres."
    ]
    if around:
        parts += [_said_of_directions(around), _figure_directions(around, rows)]
    if along:
        parts += [_said_of_distances(along), _figure_distances(along, rows)]
    if rows:
        parts += [_table(rows, results), _agreement(rows, results)]
    if first is not None:
        parts.append(_noise_table(first["noise"]))
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), dict(results))


def _of(results: Results, key: str, name: str) -> list[Result]:
    """What a map's job found; nothing where it failed."""
    return results.get(key, {}).get(name, [])


def _films(results: Results) -> list[tuple[Place, Result]]:
    return [(Place(*r["place"]), r) for k, r in results.items() if k.startswith("film-") and "error" not in r]


def _expected_at(results: Results, place: Place) -> Result | None:
    """The map's value with the film's own discs."""
    entries = [e for key in ("directions-0", "distances") for e in _of(results, key, "checked")]
    return next((e for e in entries if Place(*e["place"]).key == place.key), None)


def _said_of_directions(entries: list[Result]) -> str:
    """The best direction, how much it matters, and where the targets are seen."""
    seen = [e for e in entries if e["targets"] >= _POSED]
    best, worst = (pick(entries, key=lambda e: e["attitude_deg"]) for pick in (min, max))
    share = np.mean([e["attitude_deg"] <= NEAR_BEST * best["attitude_deg"] for e in entries])
    text = (
        f"Over all {len(entries)} directions at {FAR:g} m the bound of the attitude goes from "
        f"{best['attitude_deg']:.4f}° ({_direction(best)}; {best['discs']:.1f} discs in view) to "
        f"{worst['attitude_deg']:.4f}° ({_direction(worst)}; {worst['discs']:.1f}), that of the rate from "
        f"{min(e['rate_deg_s'] for e in entries):.3f} to {max(e['rate_deg_s'] for e in entries):.3f} °/s; "
        f"{100.0 * share:.0f} % of them are within {100.0 * (NEAR_BEST - 1.0):.0f} % of the best attitude. "
    )
    if not seen:
        return text + "From none of them three targets are seen."
    chosen = min(seen, key=lambda e: e["attitude_deg"])
    azimuth, elevation = ([e["place"][i] for e in seen] for i in (0, 1))
    limits = (
        f"What limits the choice is the targets: three or more are seen from {len(seen)} of the {len(entries)} "
        f"directions only, all {_within(azimuth)} of azimuth and {_within(elevation)} of elevation. "
        if len(seen) < len(entries)
        else "Three targets or more are seen from all of them. "
    )
    return text + (
        f"{limits}Advice: put the camera at {_direction(chosen)} "
        f"({chosen['attitude_deg']:.4f}°, {chosen['rate_deg_s']:.3f} °/s), or anywhere where it sees the targets "
        f"({max(e['attitude_deg'] for e in seen):.4f}° at worst); for another place move the targets along."
    )


def _within(degrees: list[float]) -> str:
    low, high = min(degrees), max(degrees)
    return f"at {low:g}°" if low == high else f"within {low:g}° to {high:g}°"


def _direction(entry: Result) -> str:
    place = Place(*entry["place"])
    return f"azimuth {place.azimuth:g}°, elevation {place.elevation:g}°"


def _said_of_distances(entries: list[Result]) -> str:
    """What distance does, with a lens that stays and with one that is chosen for it."""
    said = []
    for lens in LENSES:
        here = _with_lens(entries, lens)
        if here:
            best = min(here, key=lambda e: e["attitude_deg"])
            near = [e["place"][2] for e in here if e["attitude_deg"] <= NEAR_BEST * best["attitude_deg"]]
            said.append(
                f"{_lens_named(lens)} the attitude is best from {best['place'][2]:g} m ({best['attitude_deg']:.4f}°, "
                f"{best['discs']:.1f} discs in view) and within {100.0 * (NEAR_BEST - 1.0):.0f} % of that from "
                f"{', '.join(f'{d:g}' for d in sorted(near))} m"
            )
    ranges = [e["place"][2] for e in _with_lens(entries, LENSES[1]) if e["targets"] >= _POSED]
    from_ = ", ".join(f"{r:g}" for r in sorted(ranges))
    seen = f" With a lens that fits, three targets are in the picture from {from_} m." if ranges else ""
    return "; ".join(said) + "." + seen


def _lens_named(lens: str) -> str:
    return (
        f"With the same lens ({FOCAL:g} px)"
        if lens == LENSES[0]
        else "with a lens with which the ball fills the picture"
    )


def _with_lens(entries: list[Result], lens: str) -> list[Result]:
    return [e for e in entries if abs(e["place"][3] - lens_of(lens, e["place"][2])) < 0.5]


def _table(rows: list[tuple[Place, Result]], results: Results) -> Table:
    lines: list[tuple[str, ...]] = []
    for place, film in rows:
        expected_ = _expected_at(results, place)
        true, own = film["true pose"], film["own pose"]
        targets = "–" if expected_ is None else str(expected_["targets"])
        where = (_named(place), targets, value(true, "mean_discs", digits=1))
        errors = {
            "map": [value(expected_, quantity, digits=d) for quantity, _, _, _, d in _QUANTITIES],
            "film's bound": [
                value(film["bound"], quantity, "combined", digits=d) for quantity, _, _, _, d in _QUANTITIES
            ],
            "`so3`, true pose": [value(true, key, "combined", digits=d) for _, key, _, _, d in _QUANTITIES],
            "`so3`, own pose": ["no pose"] * 2
            if "error" in own
            else [value(own, key, "combined", digits=d) for _, key, _, _, d in _QUANTITIES],
        }
        gone = {"`so3`, true pose": str(true["frames"] - true["tracked"])}
        gone["`so3`, own pose"] = "no pose" if "error" in own else str(own["frames"] - own["tracked"])
        for k, (name, both) in enumerate(errors.items()):
            lines.append((*(where if k == 0 else ("", "", "")), name, *both, gone.get(name, "")))
    for key, result in results.items():
        if key.startswith("film-") and "error" in result:
            lines.append((f"{key.removeprefix('film-')}: failed", *["–"] * 6))
    head = (
        *("azimuth, elevation, distance, focal length", "targets in view", "discs used", ""),
        *(f"{word}, {unit}" for _, _, word, unit, _ in _QUANTITIES),
        "frames lost",
    )
    return Table(head, tuple(lines), "Films beside the map")


def _named(place: Place) -> str:
    return f"{place.azimuth:g}°, {place.elevation:g}°, {place.distance:g} m, {place.focal:.0f} px"


def _agreement(rows: list[tuple[Place, Result]], results: Results) -> str:
    """How far films are from the map."""
    said = []
    whole = [(p, film) for p, film in rows if film["true pose"]["tracked"] == film["true pose"]["frames"]]
    for quantity, key, word, _, _ in _QUANTITIES:
        ratios = []
        for place, film in whole:
            expected_, found = _expected_at(results, place), film["true pose"][key]["combined"]
            if expected_ is not None and found is not None:
                ratios.append(found / expected_[quantity])
        if ratios:
            said.append(f"{word} {np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})")
    if not said:
        return ""
    return (
        f"Error of `so3` over the map's, median and range over the {len(whole)} of {len(rows)} films that were tracked "
        f"from the first frame to the last: {'; '.join(said)}. A map takes one noise for "
        f"discs of a size, wherever the light comes from; films know better.{_without_pose(rows)}{_lost_by_pose(rows)}"
    )


def _without_pose(rows: list[tuple[Place, Result]]) -> str:
    """From how many places the targets gave no pose, and what became of the ball; empty where there is none."""
    blind = [film["true pose"] for _, film in rows if "error" in film["own pose"]]
    if not blind:
        return ""
    followed = sum(f["tracked"] == f["frames"] for f in blind)
    how = f"; with the true pose the ball is tracked to the end from {followed} of them" if followed else ""
    return f" From {len(blind)} of {len(rows)} places the targets gave no pose{how}."


def _lost_by_pose(rows: list[tuple[Place, Result]]) -> str:
    """Where the ball is lost for the pose that was found; empty where it is not."""
    said = []
    for place, film in rows:
        true, own = film["true pose"], film["own pose"]
        if "error" in own or own["tracked"] >= true["tracked"] or not own["pose_error"]:
            continue
        off, sigma = (np.linalg.norm(own["pose_error"][key]) for key in ("position_mm", "sigma_position_mm"))
        said.append(
            f"from {place.distance:g} m with {place.focal:.0f} px ({place.azimuth:g}°, {place.elevation:g}°), where it "
            f"is off by {off:.0f} mm (standard deviation {sigma:.0f} mm), {true['tracked'] - own['tracked']} frames"
        )
    return f" With the pose that was found the ball is lost: {'; '.join(said)}." if said else ""


def _noise_table(noise: list[list[float]]) -> Table:
    sizes = [Size(area, sigma, share, int(discs)) for area, sigma, share, discs in noise]
    rows = [
        (
            f"{s.area / np.sqrt(2.0):.0f} to {s.area * np.sqrt(2.0):.0f}",
            str(s.discs),
            f"{100.0 * s.share:.0f} %",
            f"{s.sigma:.3f}",
        )
        for s in sizes
    ]
    return Table(
        ("area, px²", "discs", "found", "centre RMS per axis, px"), tuple(rows), "Noise by size, as in the map"
    )


def _figure_directions(entries: list[Result], rows: list[tuple[Place, Result]]) -> Figure:
    def draw(canvas: Any) -> None:
        from matplotlib.colors import LogNorm
        from matplotlib.patheffects import Normal, Stroke
        from matplotlib.ticker import NullFormatter

        axes = canvas.subplots(1, 2, sharey=True)
        azimuth, elevation = (sorted({e["place"][i] for e in entries}) for i in (0, 1))
        by_place = {(e["place"][0], e["place"][1]): e for e in entries}
        grid = [[by_place.get((a, e)) for a in azimuth] for e in elevation]
        films = [(p, r["true pose"]) for p, r in rows if p.distance == FAR and p.focal == FOCAL]
        for ax, (quantity, key, word, unit, digits) in zip(axes, _QUANTITIES, strict=True):
            values = np.array([[np.nan if c is None else c[quantity] for c in line] for line in grid])
            found = [(p, r[key]["combined"]) for p, r in films if r[key]["combined"] is not None]
            low = float(np.nanmin(values))
            high = max(_SPAN * low, 1.0001 * float(np.nanmax(values)), *(x for _, x in found))
            norm = LogNorm(low, high)
            shown = ax.pcolormesh(azimuth, elevation, values, norm=norm, shading="nearest", rasterized=False)
            usable = np.array([[c is not None and c["targets"] >= _POSED for c in line] for line in grid])
            _outline(ax, azimuth, elevation, usable)
            for place, x in found:
                ax.scatter(place.azimuth, place.elevation, s=60, c=[x], norm=norm, edgecolors="white", linewidths=1.2)
                ax.annotate(
                    f"{x:.{digits}f}",
                    (place.azimuth, place.elevation),
                    (0.0, -13.0),
                    textcoords="offset points",
                    ha="center",
                    fontsize=7.5,
                    color="white",  # on the map, whatever the page is
                    path_effects=[Stroke(linewidth=2.0, foreground="#222222"), Normal()],
                )
            ax.set(title=f"{word}, {unit}", xlabel="azimuth, °")
            ax.grid(visible=False)
            bar = canvas.colorbar(shown, ax=ax, location="bottom", aspect=30)
            ticks = _ticks(low, high)
            bar.set_ticks(ticks, labels=[f"{t:g}" for t in ticks])
            bar.ax.xaxis.set_minor_formatter(NullFormatter())
            bar.ax.minorticks_off()
            bar.set_label("darker: better")
        axes[0].set_ylabel("elevation, °")

    return Figure(
        "places-directions",
        f"The bound of attitude and rate by the direction of the camera, {FAR:g} m from the ball's centre (azimuth "
        "0°, elevation 0°: straight before the frame). Outlined: three targets or more are seen: the pose can be "
        "found. Circles and numbers: the error of `so3` on films from there, the pose being known.",
        draw,
        (7.2, 4.2),
    )


def _outline(ax: Any, x: Sequence[float], y: Sequence[float], where: NDArray[np.bool_]) -> None:
    """A line around cells of a grid, seen on dark cells and on bright ones."""
    from matplotlib.collections import LineCollection

    dx, dy = (np.min(np.diff(v)) if len(v) > 1 else 10.0 for v in (x, y))
    padded, sides = np.pad(where, 1), []
    for i, j in np.argwhere(where):
        left, right, low, high = x[j] - dx / 2.0, x[j] + dx / 2.0, y[i] - dy / 2.0, y[i] + dy / 2.0
        around = {
            (1, 0): [(left, low), (left, high)],
            (1, 2): [(right, low), (right, high)],
            (0, 1): [(left, low), (right, low)],
            (2, 1): [(left, high), (right, high)],
        }
        sides += [line for (di, dj), line in around.items() if not padded[i + di, j + dj]]
    for colour, width in (("#222222", 3.4), ("white", 1.6)):  # on the map, whatever the page is
        ax.add_collection(LineCollection(sides, colors=colour, linewidths=width, capstyle="round"))


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers within bounds."""
    most = 0.5 * (high - low)
    step = 10.0 ** np.floor(np.log10(most))
    step *= max(k for k in (1.0, 2.0, 5.0) if k * step <= most)
    return (step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)).tolist()


def _figure_distances(entries: list[Result], rows: list[tuple[Place, Result]]) -> Figure:
    def draw(canvas: Any) -> None:
        from matplotlib.ticker import StrMethodFormatter

        axes = canvas.subplots(1, 2)
        for ax, (quantity, key, word, unit, _) in zip(axes, _QUANTITIES, strict=True):
            for k, lens in enumerate(LENSES):
                here = sorted(_with_lens(entries, lens), key=lambda e: e["place"][2])
                ax.plot([e["place"][2] for e in here], [e[quantity] for e in here], color=f"C{k}", **BOUND)
                films = [
                    (p, r)
                    for p, r in rows
                    if p.azimuth == p.elevation == 0 and abs(p.focal - lens_of(lens, p.distance)) < 0.5
                ]
                for name, mark in (("true pose", "o"), ("own pose", "x")):
                    points = [(p.distance, r[name][key]["combined"]) for p, r in films if key in r[name]]
                    points = [(d, x) for d, x in points if x is not None]
                    ax.plot(
                        *zip(*points, strict=True) if points else ([], []), color=f"C{k}", marker=mark, linestyle=""
                    )
            ax.set(
                xscale="log", yscale="log", xlabel="distance from the ball's centre, m", ylabel=f"{word} error, {unit}"
            )
            ax.set_ylim(top=TOP * min(e[quantity] for e in entries))
            ax.set_xticks([1, 1.5, 2, 3, 4], ["1", "1.5", "2", "3", "4"])
            ax.minorticks_off()
            ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        canvas.legend(handles=_handles(), loc="outside upper center", ncols=4)

    return Figure(
        "places-distances",
        f"Errors against the distance, straight before the frame, with a lens of {FOCAL:g} px and with one with which "
        f"the ball fills the picture. Lines: the bound by geometry; marks: `so3` on films. More than {TOP:g} times "
        "the least is not drawn: there hardly a disc is in view.",
        draw,
        (7.2, 3.4),
    )


def _handles() -> list[Any]:
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color=f"C{k}", label=f"bound, {lens}", **BOUND) for k, lens in enumerate(LENSES)]
    marks = (("o", "so3, true pose"), ("x", "so3, own pose"))
    return [*lines, *(Line2D([], [], color="0.5", marker=m, linestyle="", label=name) for m, name in marks)]
