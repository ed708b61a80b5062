"""What the experiments on the ball in a hand are said to show: tables, figures and sentences."""

from typing import Any

import numpy as np

from spheremouse.evaluate.table import axes, shown
from spheremouse.evaluate.wand import OFF_ANGLE, RECOVERED
from spheremouse.experiments import wand_films as wand
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.report.page import failures
from spheremouse.experiments.report.plot import plain_numbers
from spheremouse.experiments.wand import SPEEDS
from spheremouse.geometry.rotation import log

_SHOWN = "drive-01"  # the film whose errors are drawn frame by frame
_METHODS = {"ours": "known start", "as in the thesis": "all as in the thesis"}
_THESIS_MAX = {"x": 3.0, "y": 15.0, "z": 40.0, "rotation": 7.0}  # cm, °: largest errors with 350 particles
_THESIS_RUNS = {  # by the number of particles: s per picture, runs that lost the ball, largest error in z
    50: ("0.6", "2 of 3", "–"),
    350: ("0.71", "none", f"{_THESIS_MAX['z']:g} cm"),
    5000: ("2.73", "–", "–"),
    50000: ("–", "–", "–"),
}
_TURNED = 50.0 / 0.8  # °, of the thesis' robot from one picture to the next
_ABSURD = 1000.0  # an ANEES of which the digits say nothing
_HEAD = (
    "film",
    "particles",
    "runs",
    "lost",
    "tracked, %",
    f"found in {wand.FOUND_WITHIN}",
    "p95 x  y  z, cm",
    "max x  y  z, cm",
    "rotation p95, max, °",
    "ANEES position, rotation",
    "within 95 %, %",
)


def section(request: Request, results: Results) -> Section:
    """What is to be reached, what each film gave, and how fast it was."""
    timed = results.get(SPEEDS, {})
    timed = {} if "error" in timed else timed
    table = wand.rows(request.quick, {key: r for key, r in results.items() if key != SPEEDS})
    reached = wand.verdicts(table, timed)
    failed = failures(results)
    parts = (
        _about(),
        Table(("asked", "thesis", "ours", "reached"), tuple((a, t, o, _word(good)) for a, t, o, good in reached)),
        *([why] if (why := _differs(table)) else []),
        _particles(table, timed),
        Table(_HEAD, tuple(_named_once([_cells(row) for row in table])), "Films and trackers"),
        Table(
            ("", "median fps", "mean fps", "90th percentile, ms"),
            tuple((n, f"{s['fps']:.0f}", f"{s['mean_fps']:.0f}", f"{s['p90_ms']:.1f}") for n, s in timed.items()),
            "Speed, one core",
        ),
        *_figures(table, results.get(_SHOWN, {})),
        *(["\n".join(failed)] if failed else []),
    )
    figures: dict[str, Any] = {
        "rows": [
            {
                "film": row.film.name,
                "variant": row.variant,
                "runs": row.runs,
                "lost_runs": row.lost,
                "found_within_5": row.found,
                "tracked": row.tracked,
                "failures": list(row.failures),
                **row.figures,
            }
            for row in table
        ],
        "speeds": timed,
        "reached": [{"asked": a, "thesis": t, "ours": o, "reached": good} for a, t, o, good in reached],
    }
    return Section(parts, figures)


def _about() -> str:
    return (
        "A 10 cm ball with discs in two colours on a robot that drives as in the thesis, and in a hand, all simulated, "
        "and the shared recording of such a drive; how we go about it is in [wand](wand.md). A run has *lost* the "
        f"ball where it never had it, is off for more than {RECOVERED:g} s (and two frames), or at the end; off is "
        "beside the ball by more than its radius across the line of sight, or turned wrongly by more than "
        f"{np.degrees(OFF_ANGLE):.0f}°. Along the line of sight it may be off by any distance and is not lost: that is "
        "what the errors in z are for. *Tracked* is the share of the frames with a pose, right or wrong: a filter that "
        f"has lost the ball may give one in each. *Found in {wand.FOUND_WITHIN}*: runs with a right pose within the "
        f"first {wand.FOUND_WITHIN} frames. With a *known start* a run begins with the true pose, as in the thesis, "
        "with its *own start* with the picture alone. *Without the outline*: the edge of the ball itself, the largest "
        "ring there is, is not looked at. ANEES: squared error over claimed variance, per degree of freedom; 1 is "
        "honest, more claims too much. *Within 95 %*: frames within the region that is to hold 95 of 100. Fewer than "
        f"{wand.ENOUGH} runs ({wand.SOME} with distractors) are not judged."
    )


def _differs(table: list[wand.Row]) -> str:
    """Where we differ from the thesis' filter on the same pictures, and what of it makes the difference."""
    drive = {row.variant: row for row in table if row.film.name in ("drive", "drive-many") and row.runs}
    ours = drive.get("350, known start")
    if ours is None:
        return ""
    said = []

    def z(row: wand.Row) -> str:
        largest = row.figures["position_p95_mm"]["z"]
        return shown(None if largest is None else 0.1 * largest, ".1f")

    for name, how in (
        ("350, without the outline", "without the outline of the ball"),
        ("350, the thesis' motion", "with the thesis' motion in place of ours"),
        (
            "350, drawn by the thesis' motion alone",
            "with particles drawn by that motion alone and not towards the peaks",
        ),
        ("350, all as in the thesis", "with its product of colour fields for a likelihood as well"),
        ("350, edges alone", "with Canny's edges alone for it"),
    ):
        row = drive.get(name)
        if row is not None:
            said.append(f"{how} {row.lost} of {row.runs} lose the ball, z {z(row)} cm")
    if not said:
        return ""
    text = (
        f"Where we differ from the thesis, by 350 particles on the drive: ours {ours.lost} of {ours.runs} lost, z "
        f"{z(ours)} cm (95th percentile); {'; '.join(said)}."
    )
    alone = drive.get("350, drawn by the thesis' motion alone")
    if alone is not None and alone.lost > ours.lost:
        text += (
            f" At 50 °/s and 0.8 pictures per second the robot turns by up to {_TURNED:.0f}° from one to the next, "
            "further than a random walk reaches with so few particles."
        )
    many = drive.get("5000, all as in the thesis")
    if many is not None:
        text += (
            f" With 5000, all as in the thesis, {many.lost} of {many.runs} are lost, and z is off by {z(many)} cm (the "
            f"thesis, with 350: up to {_THESIS_MAX['z']:g} cm)."
        )
    return text


def _particles(table: list[wand.Row], timed: Result) -> Table:
    rows = []
    for n, (seconds, lost, z) in _THESIS_RUNS.items():
        fps = timed.get(f"{n} particles, whole frame", {}).get("fps")
        cells = [f"{n:,}", seconds, "–" if fps is None else f"{1.0 / fps:.3f}", lost]
        for words in _METHODS.values():
            row = next((r for r in table if r.runs and r.variant == f"{n}, {words}" and r.film.name != "two"), None)
            cells.append("–" if row is None else f"{row.lost} of {row.runs}")
        ours = next((r for r in table if r.runs and r.variant == f"{n}, known start"), None)
        largest = None if ours is None else ours.figures["position_max_mm"]["z"]
        cells += [z, "–" if largest is None else f"{0.1 * largest:.1f} cm"]
        rows.append(tuple(cells))
    head = (
        *("particles", "thesis, s per picture", "ours, s"),
        *("lost: thesis", "lost: ours", "lost: ours, all as in the thesis"),
        *("largest error in z: thesis", "ours"),
    )
    return Table(head, tuple(rows), "By the number of particles; times of a 2.8 GHz computer of 2005 and of this one")


def _named_once(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Rows of the same film, which only the first of them names."""
    names = [row[0] for row in rows]
    return [row if k == 0 or names[k] != names[k - 1] else ("", *row[1:]) for k, row in enumerate(rows)]


def _honesty(value: float | None) -> str:
    return f"> {_ABSURD:.0f}" if value is not None and value > _ABSURD else shown(value)


def _cells(row: wand.Row) -> tuple[str, ...]:
    figures = row.figures
    if row.runs == 0:
        failed = "failed: see below" if row.failures else "not done"
        return f"{row.film.name}: {row.film.words}", row.variant, "0", failed, *["–"] * (len(_HEAD) - 4)
    name = f"{row.film.name}: {row.film.words}" + (f" ({len(row.failures)} failed)" if row.failures else "")
    return (
        name,
        row.variant,
        str(row.runs),
        str(row.lost),
        f"{100.0 * row.tracked:.1f}",
        str(row.found),
        axes(figures["position_p95_mm"], ".2f", 0.1),
        axes(figures["position_max_mm"], ".2f", 0.1),
        f"{shown(figures['rotation_p95_deg'], '.2f')}  {shown(figures['rotation_max_deg'], '.2f')}",
        f"{_honesty(figures['anees']['position'])}  {_honesty(figures['anees']['rotation'])}",
        "–" if figures["within_95"] is None else f"{100.0 * figures['within_95']:.1f}",
    )


def _word(good: bool | None) -> str:
    return "not judged" if good is None else "yes" if good else "no"


def _figures(table: list[wand.Row], shown_film: Result) -> list[Figure]:
    found = []
    counted = {
        method: [(int(r.variant.split(",")[0]), r) for r in table if r.runs and r.variant.endswith(words)]
        for method, words in _METHODS.items()
    }
    of_drive = {
        method: sorted([(n, r) for n, r in rows if r.film.name in ("drive", "drive-many")], key=lambda row: row[0])
        for method, rows in counted.items()
    }
    if any(len(rows) > 1 for rows in of_drive.values()):
        found.append(
            Figure(
                "wand-particles",
                "Errors over the drive against the number of particles; at each point, runs that lost the ball of all "
                "that were made. Dashed: what was asked of 350.",
                lambda canvas: _draw_particles(canvas, of_drive),
                (7.2, 3.4),
            )
        )
    variants = shown_film.get("variants", {})
    names = [name for name in ("350, known start", "350, all as in the thesis") if variants.get(name)]
    if names and variants[names[0]][0]["index"]:
        found.append(
            Figure(
                "wand-drive",
                "Errors of 350 particles along one drive: ours with two standard deviations either way as they were "
                "reported, and the thesis' own step on the same pictures, where it is not off the scale. Dashed: the "
                "largest errors in the thesis.",
                lambda canvas: _draw_drive(canvas, {name: variants[name][0] for name in names}),
                (7.2, 5.4),
            )
        )
    return found


def _draw_particles(canvas: Any, of_drive: dict[str, list[tuple[int, wand.Row]]]) -> None:
    axes_ = canvas.subplots(1, 2)
    panels = (
        ("distance (z), 95th percentile, cm", 10.0, lambda f: f["position_p95_mm"]["z"], 0.1),
        ("rotation, 95th percentile, °", 4.0, lambda f: f["rotation_p95_deg"], 1.0),
    )
    for ax, (label, limit, value, scale) in zip(axes_, panels, strict=True):
        for k, (method, rows) in enumerate(of_drive.items()):
            points = [(n, scale * value(r.figures), r) for n, r in rows if value(r.figures) is not None]
            ax.plot([p[0] for p in points], [p[1] for p in points], marker="o", color=f"C{k}", label=method)
            for n, y, row in points:
                said = f"{row.lost} of {row.runs} lost"
                ax.annotate(said, (n, y), (0, 6), textcoords="offset points", ha="center", fontsize=7.5)
        ax.axhline(limit, color="0.5", linestyle=(0, (4, 3)), linewidth=0.9)
        ax.set(xscale="log", yscale="log", xlabel="particles", ylabel=label)
        ax.margins(x=0.16, y=0.16)
        plain_numbers(ax.yaxis)
        counts = sorted({n for rows in of_drive.values() for n, _ in rows})
        ax.set_xticks(counts, [f"{n:,}" for n in counts])
        ax.xaxis.minorticks_off()
    canvas.legend(*axes_[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)


def _draw_drive(canvas: Any, runs: dict[str, Result]) -> None:
    axes_ = canvas.subplots(4, 1, sharex=True)
    for k, (name, kept) in enumerate(runs.items()):
        frame, errors, sigma = _along(kept)
        for ax, error, s in zip(axes_, errors.T, sigma.T, strict=True):
            if k == 0:
                ax.fill_between(frame, -2.0 * s, 2.0 * s, color=f"C{k}", alpha=0.2, linewidth=0.0)
                reach = 1.3 * max(float(np.max(2.0 * s)), float(np.max(np.abs(error))))
                ax.set_ylim(-reach, reach)
            ax.plot(frame, error, color=f"C{k}", linewidth=1.0, label=name.replace("known start", "ours"))
    for ax, (axis, most) in zip(axes_, _THESIS_MAX.items(), strict=True):
        reach = max(ax.get_ylim()[1], 1.15 * most)
        ax.set_ylim(-reach if axis != "rotation" else -0.05 * reach, reach)
        ax.axhline(most, color="0.5", linestyle=(0, (4, 3)), linewidth=0.9)
        if axis != "rotation":
            ax.axhline(-most, color="0.5", linestyle=(0, (4, 3)), linewidth=0.9)
        ax.set_ylabel(f"{axis}, °" if axis == "rotation" else f"{axis}, cm")
    axes_[-1].set_xlabel("frame")
    canvas.legend(*axes_[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)


def _along(kept: Result) -> tuple[Any, Any, Any]:
    """Frames (n,), errors (n, 4) of x, y, z in cm and of the rotation's angle in °, and what was said of them."""
    (run,), (truth,) = wand.restored([kept])
    shift = 100.0 * (run.position - truth.position)
    turn = np.rad2deg(np.linalg.norm(log(run.rotation @ truth.rotation.transpose(0, 2, 1)), axis=1))
    variance = np.diagonal(run.covariance, axis1=1, axis2=2)
    angle = np.rad2deg(np.sqrt(variance[:, 3:].sum(axis=1)))
    return run.stamp, np.c_[shift, turn], np.c_[100.0 * np.sqrt(variance[:, :3]), angle]
