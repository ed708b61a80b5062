"""What the experiments on mistakes of a calibration are said to show: tables, figures and sentences."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.kit.tour import FOLLOWED, is_lost
from spheremouse.experiments.mistakes import (
    ALONE,
    EVENING,
    FREE,
    KINDS,
    LENS,
    PER_UNIT,
    STEADY,
    STRAIGHT,
    TOGETHER,
    TOLD,
    TRACKERS,
    Kind,
)
from spheremouse.experiments.report.cells import CLEARLY, COLOURS, films_cell
from spheremouse.experiments.report.page import failures
from spheremouse.experiments.report.plot import BOUND, label_ends, plain_numbers


def section(request: Request, results: Results) -> Section:
    """Each mistake alone, all together, and what may be off by how much."""
    found = {name: points(results, kind) for name, kind in KINDS.items()}
    films, free = _distinct(results), lift_matters(found)
    parts: list[str | Table | Figure] = [_intro(films)]
    alone = {name: found[name] for name in ALONE if found[name]}
    if alone:
        parts += [
            "### Each mistake alone",
            _said_of_alone(alone, _edges(results), free),
            _figure("mistakes-errors", alone, ("attitude", "rate"), films, free),
            _figure("mistakes-mouse", alone, ("scale", "direction", "wobble"), films, free),
            *[_table(KINDS[name], cells, results, free) for name, cells in alone.items()],
        ]
    if found["evening"]:
        parts += [
            "### A whole evening",
            _said_of_evening(found["evening"], free),
            _figure_evening(found["evening"], [f for k, f in _films(results) if k.startswith("lens")], free),
            _table(KINDS["evening"], found["evening"], results, free),
        ]
    if any(found.values()):
        parts.append(_advice(found, films, free))
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), dict(results))


def _films(results: Results) -> Iterable[tuple[str, Result]]:
    return ((key, r) for key, r in results.items() if "error" not in r)


def _distinct(results: Results) -> list[Result]:
    """Each film once: jobs of the same seed and lens have the same."""
    found: dict[tuple[str, ...], Result] = {}
    for key, result in _films(results):
        kind, *rest = key.split("-")
        found.setdefault(tuple(rest) if kind == "lens" else ("", rest[-1]), result)
    return list(found.values())


def lift_matters(found: dict[str, dict[float, list[Result]]]) -> bool:
    """Whether any rig makes a difference between `so3` and `so3, no lift`."""
    cells = [c for of_kind in found.values() for here in of_kind.values() for c in here if "error" not in c]
    return any(c["rows"].get("so3") != c["rows"].get(FREE) for c in cells)


def _broken(results: Results, kind: Kind) -> dict[float | None, int]:
    """How many films failed that had this mistake, by value; None: every value."""
    found: dict[float | None, int] = {}
    for key, result in results.items():
        group, *rest = key.split("-")
        if "error" not in result:
            continue
        value = float(rest[0]) if group == "lens" else None
        names = {"lens": ("lens", "evening"), "alone": ALONE[:-1], **TOGETHER}.get(group, ())
        if kind.name in names:
            value = value / LENS if kind.name == "evening" and value is not None else value
            found[value] = found.get(value, 0) + 1
    return found


def _edges(results: Results) -> dict[float, float]:
    """By k1: pixels at the edge of the ball."""
    return {float(key.split("-")[1]): r["edge"] for key, r in _films(results) if key.startswith("lens-")}


def points(results: Results, kind: Kind) -> dict[float, list[Result]]:
    """By value, ascending: what each wrong rig gave."""
    found: dict[float, list[Result]] = {}
    for _, result in _films(results):
        for word, cells in result["mistakes"].get(kind.name, {}).items():
            found.setdefault(float(word), []).extend(cells)
    return dict(sorted(found.items()))


def _intro(films: list[Result]) -> str:
    said = (
        "The far camera, 26 discs, 30 frames per second, turns about one axis after the other, `ekf1` and `ekf2` told "
        "the true acceleration, as in the section before. The film is right, the rig is wrong: the "
        "camera's pose is found with what it says, and everything after that. The pointer's motion that was sent is "
        "compared with the true one: how much faster it goes (scale), how far astray in the worst direction "
        "(direction), and the part that neither explains (wobble), which no setting puts right. Scale is a matter of "
        "taste, and `spheremouse match` sets it."
    )
    right = [f["right"]["rows"]["so3"] for f in films if "error" not in f["right"]]
    known = [r for r in right if "scale" in r]
    if known:
        middle = {q: float(np.median([abs(r[q]) for r in known])) for q in ("scale", "direction", "wobble")}
        said += (
            f" With the right rig `so3` has a scale off by {middle['scale']:.2f} %, goes astray by "
            f"{middle['direction']:.2f}° and wobbles by {middle['wobble']:.2f} % (medians of {len(known)} films with "
            "lenses or discs of their own)."
        )
    return said


def _rows(cells: list[Result], who: str) -> list[Result | None]:
    """Of each wrong rig; None where there is no pose."""
    return [None if "error" in c else c["rows"].get(who) for c in cells]


def values(cells: list[Result], who: str, what: str) -> list[float]:
    """Of the rigs that have one; a scale without its sign."""
    return [abs(r[what]) for r in _rows(cells, who) if r is not None and r.get(what) is not None]


def median(cells: list[Result], who: str, what: str) -> float | None:
    """Over the rigs that have one."""
    found = values(cells, who, what)
    return float(np.median(found)) if found else None


def lost(cells: list[Result], who: str) -> int:
    """With how many rigs: no pose, or the tracker said so, or an attitude that is far off."""
    return sum(r is None or is_lost(r) for r in _rows(cells, who))


def held(cells: list[Result], who: str) -> float | None:
    """Share of the frames that were tracked, over the rigs with a pose."""
    rows = [r for r in _rows(cells, who) if r is not None]
    return sum(r["tracked"] for r in rows) / sum(r["frames"] for r in rows) if rows else None


def bears(cells: list[Result], who: str) -> bool:
    """The ball is followed with each of these rigs, and the pointer goes where it is pushed, and steadily."""
    for row in _rows(cells, who):
        if row is None or row["lost"] or row.get("direction") is None or row["tracked"] < FOLLOWED * row["frames"]:
            return False
        if row["direction"] > STRAIGHT or row["wobble"] > STEADY:
            return False
    return True


def limit_of(found: dict[float, list[Result]], who: str) -> float | None:
    """The largest size, either way, up to which all rigs do; None where the least does not."""
    last = None
    for size in sorted({abs(v) for v in found}):
        cells = [c for v, here in found.items() if abs(v) == size for c in here]
        if not bears(cells, who):
            break
        last = size
    return last


def _shown(kind: Kind, value: float) -> str:
    return f"{PER_UNIT[kind.name] * value:g}"


def _who(kind: Kind, free: bool) -> tuple[str, ...]:
    return (*TRACKERS, *((FREE,) if free else ()), *((TOLD,) if kind.name == "evening" else ()))


def _table(kind: Kind, found: dict[float, list[Result]], results: Results, free: bool) -> Table:
    films = [r for _, r in _films(results) if kind.name in r["mistakes"]]
    rows = [
        row
        for name, cells in (
            ("right rig", [f["right"] for f in films]),
            *((_shown(kind, v), c) for v, c in found.items()),
        )
        for row in _table_rows(name, cells, _who(kind, free))
    ]
    for value, broken in _broken(results, kind).items():
        made = len([f for f in films if value is None or f"{value:g}" in f["mistakes"][kind.name]])
        shown = "every value" if value is None else _shown(kind, value)
        rows.append((shown, f"films: {films_cell(made, broken)}", *["–"] * 8))
    head = (
        *(kind.label, "rigs", ""),
        *("attitude, °", "rate, °/s", "scale off by, %", "astray by, °", "wobble, %", "lost", "frames tracked, %"),
    )
    return Table(head, tuple(rows), f"{kind.title} (medians)")


def _table_rows(name: str, cells: list[Result], who: tuple[str, ...]) -> list[tuple[str, ...]]:
    """A row per filter; those that were not tried with these rigs have none."""
    rows: list[tuple[str, ...]] = []
    for k, w in enumerate(who):
        if not any(r is not None for r in _rows(cells, w)) and any("error" not in c for c in cells):
            continue
        row = [*((name, str(len(cells))) if k == 0 else ("", "")), f"`{w}`"]
        for what, digits in (("attitude", 2), ("rate", 1), ("scale", 1), ("direction", 1), ("wobble", 1)):
            x = median(cells, w, what)
            row.append("–" if x is None else f"{x:.{digits}f}")
        share = held(cells, w)
        rows.append((*row, str(lost(cells, w)), "–" if share is None else f"{100.0 * share:.0f}"))
    return rows


def _said_of_lift(every: list[Result], free: bool) -> str:
    """What asking whether the ball was lifted does to wrong rigs."""
    if not free:
        return (
            "`so3` asks whether the ball was lifted off its bearings; that test stops none of these "
            f"{len(every)} rigs: without it (`bearing.lifted=1`) every figure is the same."
        )
    times = {who: sum(r is not None and r["lost"] > 0 for r in _rows(every, who)) for who in ("ekf2", "so3", FREE)}
    return (
        "Where discs do not turn about the centre that a rig says, `so3` may take the ball for lifted off its "
        f"bearings. Of the {len(every)} wrong rigs it loses the ball with {times['so3']}; `{FREE}`, the same with "
        f"`bearing.lifted=1`, with {times[FREE]}; `ekf2`, which does not ask, with {times['ekf2']}."
    )


def _said_of_wobble(alone: dict[str, dict[float, list[Result]]]) -> str:
    """Which mistakes `so3` bears worse than `ekf2`, and which better: where they are furthest apart."""
    more, less = [], []
    for name, found in alone.items():
        both = {v: (median(c, "so3", "wobble"), median(c, "ekf2", "wobble")) for v, c in found.items()}
        known = {v: (a, b) for v, (a, b) in both.items() if a is not None and b is not None}
        worse = [v for v, (a, b) in known.items() if a > b]
        if not known:
            continue
        sign = 1.0 if 2 * len(worse) > len(known) else -1.0
        value = max(known, key=lambda v: sign * (known[v][0] - known[v][1]))
        ours, theirs = known[value]
        times = len(worse) if sign > 0.0 else len(known) - len(worse)
        words = KINDS[name].bears.format(_shown(KINDS[name], value))
        said = f"{words} ({ours:.1f} % against {theirs:.1f} %; at {times} of {len(known)} sizes)"
        (more if sign > 0.0 else less).append(said)
    parts = [f"{how} with {', '.join(said)}" for how, said in (("more", more), ("less", less)) if said]
    return f"`so3` wobbles {'; '.join(parts)}, each where they differ most from `ekf2`'s." if parts else ""


def _said_of_alone(alone: dict[str, dict[float, list[Result]]], edges: dict[float, float], free: bool) -> str:
    said = []
    for name, found in alone.items():
        kind = KINDS[name]
        value = kind.typical if kind.typical in found else max(found)
        cells = found[value]
        what = f"{kind.title.lower()} {_shown(kind, value)}{f' {kind.unit}' if kind.unit else ''}"
        if name == "lens":
            what = f"lens with k1 = −{value:g}" + (
                f" ({edges[value]:.1f} px at the ball's edge)" if value in edges else ""
            )
        elif not kind.log:
            what += " too large"
        rows = [r for r in _rows(cells, "so3") if r is not None and "scale" in r]
        if not rows:
            said.append(f"{what}: no pose, or too little was followed to tell")
            continue
        scale = float(np.median([r["scale"] for r in rows]))
        rest = {q: float(np.median([r[q] for r in rows])) for q in ("attitude", "direction", "wobble")}
        said.append(
            f"{what}: scale {scale:+.1f} %, direction {rest['direction']:.1f}°, wobble {rest['wobble']:.1f} %, "
            f"attitude {rest['attitude']:.2f}°"
        )
    every = [c for found in alone.values() for cells in found.values() for c in cells]
    return (
        f"{_said_of_lift(every, free)} Errors are those of the frames tracked: a filter that stops is not made worse "
        f"by it. What `so3` makes of mistakes that are easily made (medians): {'; '.join(said)}. "
        f"{_said_of_wobble(alone)}"
    ).strip()


def _said_of_evening(found: dict[float, list[Result]], free: bool) -> str:
    one = found.get(1.0)
    e = EVENING
    said = (
        f"Everything at once: the focal length from a data sheet ({e['focal']:.0%}), the principal point in the "
        f"picture's middle ({e['principal']:g} px), a tape around the ball (radius to {1e3 * e['radius']:g} mm), its "
        f"centre ({1e3 * e['centre']:g} mm) and the targets ({1e3 * e['targets']:g} mm in each coordinate) by tape "
        f"and eye, standard deviations all, and a lens with k1 = −{LENS:g} of which "
        "nothing is known. `so3, told` has a rig that says how uncertain the lengths are."
    )
    if one is None:
        return said
    n, each = len(one), []
    for who in _who(KINDS["evening"], free)[1:]:
        middle = {q: median(one, who, q) for q in ("scale", "direction", "wobble", "attitude")}
        if any(v is None for v in middle.values()):
            each.append(f"`{who}` {'follows too little to tell' if held(one, who) else 'tracks nothing'}")
            continue
        each.append(
            f"`{who}` has a scale off by {middle['scale']:.1f} %, goes astray by {middle['direction']:.1f}°, wobbles "
            f"by {middle['wobble']:.1f} %, has an attitude off by {middle['attitude']:.2f}°, and is lost in "
            f"{lost(one, who)}"
        )
    said += f" At the median of {n} such evening{'s' if n > 1 else ''}: {'; '.join(each)}.{_worse_for_telling(one)}"
    fine = ", ".join(f"{sum(bears([c], who) for c in one)} (`{who}`)" for who in _who(KINDS["evening"], free))
    return said + (
        f" The pointer is straight (to {STRAIGHT:g}°) and steady (to {STEADY:g} %), and the ball never lost, after so "
        f"many of the {n} evenings: {fine}. The "
        "thesis holds that markers placed by eye and distances taken by tape are accurate enough, and that the scale "
        "does not matter for the device; there a bundle adjustment of photos comes after the tape, here nothing does."
    )


def _worse_for_telling(cells: list[Result]) -> str:
    """Where `so3` does worse when it is told how uncertain its lengths are; empty where it does not."""
    said = []
    for what, unit, digits in (("attitude", "°", 2), ("direction", "°", 1), ("wobble", " %", 1)):
        told_, not_told = (median(cells, who, what) for who in (TOLD, "so3"))
        if told_ is not None and not_told is not None and told_ > CLEARLY * not_told:
            said.append(f"{what} {told_:.{digits}f}{unit} in place of {not_told:.{digits}f}{unit}")
    return f" Telling `so3` how uncertain the lengths are makes it worse: {', '.join(said)}." if said else ""


def _advice(found: dict[str, dict[float, list[Result]]], films: list[Result], free: bool) -> str:
    """By how much one may be off."""
    said = []
    for who in ("so3", *((FREE,) if free else ())):
        missed = [f["right"] for f in films if not bears([f["right"]], who)]
        if missed:
            seconds = [r["frames"] / 30.0 for r in _rows(missed, who) if r is not None]
            long = f" of {np.median(seconds):.1f} s" if seconds else ""
            said.append(
                f"`{who}` misses that with the right rig itself in {len(missed)} of {len(films)} films{long}, which "
                "tell nothing of wrong ones: they are too short"
            )
            continue
        may, not_even = [], []
        for name, cells in found.items():
            kind = KINDS[name]
            if cells:
                size = limit_of(cells, who)
                shown = _shown(kind, min(abs(v) for v in cells) if size is None else size)
                (not_even if size is None else may).append(kind.bears.format(shown))
        does = f"bears {', '.join(may)}" if may else ""
        does_not = f"does not bear even {', '.join(not_even)}" if not_even else ""
        said.append(f"`{who}` " + " and ".join(part for part in (does, does_not) if part))
    return (
        f"For a device: if the pointer is to go straight (to {STRAIGHT:g}°) and steadily (to {STEADY:g} %) and the "
        f"ball is never to be lost with any of the rigs tried, {'; '.join(said)}. What is beyond that is what "
        "`spheremouse calibrate` is for."
    )


_LABELS = {
    "attitude": "attitude, °",
    "rate": "rate, °/s",
    "scale": "scale off by, %",
    "direction": "astray by, °",
    "wobble": "wobble, %",
}
_COLOUR = {**COLOURS, FREE: "C5", TOLD: "C3"}
_MARK = {"ekf1": "s", "ekf2": "D", "so3": "o", FREE: "^", TOLD: "v"}
_DASH: dict[str, Any] = {"ekf1": "-", "ekf2": (0, (5, 1.5)), "so3": "-", FREE: (0, (1.5, 1)), TOLD: (0, (5, 1.5))}


def _bound(films: list[Result], what: str) -> float | None:
    known = [f["bound"][what] for f in films if f["bound"] is not None and what in f["bound"]]
    return float(np.median(known)) if known else None


def _figure(
    name: str, found: dict[str, dict[float, list[Result]]], quantities: tuple[str, ...], films: list[Result], free: bool
) -> Figure:
    def draw(canvas: Any) -> None:
        grid = canvas.subplots(len(quantities), len(found), sharey="row", squeeze=False)
        for i, (row, what) in enumerate(zip(grid, quantities, strict=True)):
            for ax, (mistake, cells) in zip(row, found.items(), strict=True):
                ends = _panel(ax, KINDS[mistake], cells, what, films, free)
                ax.set_yscale("log")
                if ax is row[-1]:
                    label_ends(ax, ends, gap=0.11)
                ax.set_xlabel(KINDS[mistake].label if i == len(quantities) - 1 else "")
                ax.tick_params(labelsize=7.5)
            row[0].set_ylabel(_LABELS[what])
            plain_numbers(row[0].yaxis)

    words = {"attitude": "attitude and rate", "scale": "the mouse: scale, direction, wobble"}[quantities[0]]
    dotted = "the Cramér-Rao bound with" if quantities[0] == "attitude" else "`so3` with"
    return Figure(
        name,
        f"One mistake at a time; errors of {words}, medians of the wrong rigs, crosses where at least one loses the "
        f"ball or finds no pose. Dotted: {dotted} the right rig.",
        draw,
        (7.2, 1.4 + 1.3 * len(quantities)),
    )


def _figure_evening(found: dict[float, list[Result]], films: list[Result], free: bool) -> Figure:
    def draw(canvas: Any) -> None:
        grid = canvas.subplots(2, 3)
        panels = ("attitude", "rate", "scale", "direction", "wobble")
        for ax, what in zip(grid.ravel(), panels, strict=False):
            ends = _panel(ax, KINDS["evening"], found, what, films, free, span=True)
            ax.set(yscale="log", ylabel=_LABELS[what])
            plain_numbers(ax.yaxis)
            label_ends(ax, ends, gap=0.11)
        grid[1, 2].set_axis_off()
        grid[1, 2].remove()
        for ax in (*grid[1, :2], grid[0, 2]):
            ax.set_xlabel("errors, evenings")

    return Figure(
        "mistakes-evening",
        "A whole evening's errors, scaled: medians, and the span of `so3`; crosses where at least one rig loses the "
        "ball or finds no pose. Dotted: the Cramér-Rao bound (above) and `so3` (below), with the right rig.",
        draw,
        (7.2, 4.2),
    )


def _panel(
    ax: Any,
    kind: Kind,
    found: dict[float, list[Result]],
    what: str,
    films: list[Result],
    free: bool,
    span: bool = False,
) -> list[tuple[str, float, Any]]:
    """Draw the lines of a quantity; names, ends and colours."""
    ends: list[tuple[str, float, Any]] = []
    scale = PER_UNIT[kind.name]
    for who in _who(kind, free):
        curve = [(scale * v, median(cells, who, what), cells) for v, cells in found.items()]
        known = [(x, y, cells) for x, y, cells in curve if y]
        if not known:
            continue
        x, y = [k[0] for k in known], [k[1] for k in known]
        colour = _COLOUR[who]
        ax.plot(x, y, color=colour, linestyle=_DASH[who])
        for at, level, cells in known:
            mark = "x" if lost(cells, who) else _MARK[who]
            ax.plot([at], [level], color=colour, marker=mark, markersize=6 if mark == "x" else 3, linestyle="")
        if span and who == "so3":
            spans = [values(cells, who, what) for _, _, cells in known]
            ax.fill_between(x, [min(s) for s in spans], [max(s) for s in spans], color=colour, alpha=0.13, linewidth=0)
        ends.append((who, y[-1], colour))
    limit = _bound(films, what) if what in ("attitude", "rate") else median([f["right"] for f in films], "so3", what)
    if limit:
        ax.axhline(limit, color="0.5", **BOUND)
        ends.append(("bound" if what in ("attitude", "rate") else "right rig", limit, "0.5"))
    if kind.log:
        ax.set_xscale("log")
        plain_numbers(ax.xaxis)
        ticks = _few(scale * v for v in found)
        ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
        ax.minorticks_off()
    return ends


def _few(values: Iterable[float]) -> list[float]:
    """At most three of them, from the first to the last."""
    known = list(values)
    return known if len(known) <= 3 else [known[0], known[len(known) // 2], known[-1]]
