"""What the experiments on sizes and layouts of discs are said to show: tables, figures and sentences."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np

from spheremouse.evaluate.metrics import MIN_AREA
from spheremouse.experiments.discs import (
    DISCS,
    HANDS,
    LAYOUTS,
    LINES,
    MISSING,
    NEARLY,
    NOISE,
    QUANTITIES,
    SETTLE,
    SIZES,
    SURE,
)
from spheremouse.experiments.kit import film as kit
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.kit.tour import FAR_OFF, FOLLOWED, brief, is_lost
from spheremouse.experiments.report.cells import films_cell
from spheremouse.experiments.report.page import failures, value
from spheremouse.experiments.report.plot import BOUND, decades

_RECOGNISED = 0.99  # of the pictures: good enough


@dataclass(frozen=True, slots=True)
class Case:
    """Films that differ in the places of discs alone."""

    name: str
    x: float  # of the figure
    films: list[Result]

    def values(self, who: str, quantity: str, key: str) -> list[float]:
        """Combined errors, of the films that have one."""
        if who == "bound":
            parts = [None if f["bound"] is None else f["bound"][quantity]["combined"] for f in self.films]
        else:
            parts = [f["rows"][who][key]["combined"] if who in f["rows"] else None for f in self.films]
        return [p for p in parts if p is not None]

    def median(self, who: str, quantity: str, key: str) -> float | None:
        """None where no film has a value."""
        known = self.values(who, quantity, key)
        return float(np.median(known)) if known else None

    def lost(self, who: str) -> int:
        """Films in which the ball was lost, or the attitude got away, or nothing was tracked."""
        return sum(_lost(f["rows"].get(who)) for f in self.films)

    def mean(self, name: str) -> float:
        """Of what is the same for all filters."""
        return float(np.mean([f[name] for f in self.films]))


def _lost(row: Result | None) -> bool:
    return row is None or is_lost(brief(row))


def _cases(results: Results, kind: str, names: Any, x: Callable[[str, list[Result]], float]) -> list[Case]:
    found = []
    for name in names:
        start = f"{kind}-{name}-".replace(" ", "_")
        films = [r for k, r in results.items() if k.startswith(start) and "error" not in r]
        if films:
            found.append(Case(str(name), x(str(name), films), films))
    return found


def section(request: Request, results: Results) -> Section:
    """Sizes, layouts, hands: each with a figure, a table and what to do."""
    sizes = _cases(results, "size", SIZES, lambda name, _: float(name))
    layouts = _cases(results, "layout", LAYOUTS, lambda name, _: float(list(LAYOUTS).index(name)))
    hands = _cases(
        results, "hands", HANDS, lambda _, films: 100.0 * float(np.mean([f["in_view_share"] for f in films]))
    )
    seeds = max((len(c.films) for c in (*sizes, *layouts, *hands)), default=0)
    parts: list[str | Table | Figure] = [
        f"{DISCS} discs before the far camera (640x480), noise of {NOISE:g} grey values, the camera's pose found from "
        f"each film; medians over up to {seeds} films with other places of the discs. A film counts as lost where the "
        f"tracker lost the ball, the attitude was off by more than {FAR_OFF:g}° (RMS), or less than "
        f"{100.0 * FOLLOWED:.0f} % of the frames were tracked. *Wholly in view* are, of the discs on the side towards "
        "the camera, those that nothing cuts. "
        "The bound is that of what `so3` measured."
    ]
    broken = {kind: _broken(results, kind, names) for kind, names in _KINDS.items()}
    if sizes:
        parts += ["### Size", _said_of_sizes(sizes), _figure_sizes(sizes)]
        parts.append(_table("radius, mm", sizes, _size_columns(), broken["size"]))
    if layouts:
        parts += ["### Places", _said_of_layouts(layouts), _figure_layouts(layouts)]
        parts.append(_table("places", layouts, _layout_columns(), broken["layout"], _layout_name))
    if hands:
        parts += ["### Hands on the ball", _said_of_hands(hands)]
        if len(hands) > 1:
            parts.append(_figure_hands(hands))
        parts.append(_table("hands", hands, _hand_columns(), broken["hands"]))
    unfound = [f"- {k}: {r['unfound']}" for k, r in results.items() if "unfound" in r]
    failed = failures(results) + unfound
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), dict(results))


_KINDS: dict[str, tuple[Any, ...]] = {"size": SIZES, "layout": tuple(LAYOUTS), "hands": tuple(HANDS)}
Column = tuple[str, Callable[[Case], str]]


def _broken(results: Results, kind: str, names: tuple[Any, ...]) -> dict[str, int]:
    """How many films of each case failed."""
    starts = {str(name): f"{kind}-{name}-".replace(" ", "_") for name in names}
    return {n: sum(k.startswith(start) and "error" in r for k, r in results.items()) for n, start in starts.items()}


def _layout_name(name: str) -> str:
    return name if name == LAYOUTS[name] else f"{name}: {LAYOUTS[name]}"


def _size_columns() -> list[Column]:
    return [
        ("diameter, px", lambda c: f"{c.mean('diameter_px'):.1f}"),
        ("wholly in view", lambda c: f"{100.0 * c.mean('in_view_share'):.0f} %"),
        ("discs used", _used),
        (f"centre RMS, px, of discs from {MIN_AREA:g} px² on", lambda c: value({"x": _centre(c)}, "x", digits=3)),
    ]


def _layout_columns() -> list[Column]:
    return [
        ("discs in view, least", lambda c: f"{c.mean('in_view'):.1f}"),
        ("contradictions, worst view", lambda c: f"{c.mean('contradictions'):.1f}"),
        ("recognised", lambda c: f"{100.0 * c.mean('recognised'):.1f} %"),
        ("mistaken", lambda c: f"{100.0 * c.mean('mistaken'):.1f} %"),
        ("discs used", _used),
    ]


def _hand_columns() -> list[Column]:
    return [("wholly in view", lambda c: f"{100.0 * c.mean('in_view_share'):.0f} %"), ("discs used", _used)]


def _used(case: Case) -> str:
    used = [f["rows"]["so3"]["mean_discs"] for f in case.films if "so3" in f["rows"]]
    known = [u for u in used if u is not None]
    return f"{np.mean(known):.1f}" if known else "–"


def _centre(case: Case) -> float | None:
    """px per axis, of the centres that `so3` measured."""
    found = [(f["rows"]["so3"]["detection"] or {}).get("centre_rms_px") for f in case.films if "so3" in f["rows"]]
    known = [x for x in found if x is not None]
    return float(np.median(known)) if known else None


def _table(
    first: str, cases: list[Case], columns: list[Column], broken: dict[str, int], named: Callable[[str], str] = str
) -> Table:
    """A row per filter; where most films were lost there is no error to compare."""
    rows: list[tuple[str, ...]] = []
    by_name = {case.name: case for case in cases}
    for name, failed in broken.items():
        case = by_name.get(name)
        if case is None:
            rows += [(named(name), "failed", *["–"] * (len(columns) + 4))] if failed else []
            continue
        made = films_cell(len(case.films), failed)
        for k, who in enumerate(LINES):
            about = (named(name), made, *(write(case) for _, write in columns))
            gone = 0 if who == "bound" else case.lost(who)
            errors = [
                "lost"
                if 2 * gone >= len(case.films)
                else value({"x": case.median(who, quantity, key)}, "x", digits=digits)
                for quantity, key, _, _, digits in QUANTITIES
            ]
            rows.append(
                (
                    *(about if k == 0 else [""] * len(about)),
                    who if who == "bound" else f"`{who}`",
                    *errors,
                    "" if who == "bound" else f"{gone} of {len(case.films)}",
                )
            )
    quantities = [f"{word}, {unit}" for _, _, word, unit, _ in QUANTITIES]
    return Table((first, "films", *(name for name, _ in columns), "", *quantities, "lost"), tuple(rows))


def _held(cases: list[Case], who: str = "so3") -> dict[str, float]:
    """Attitude errors of the cases in which no film was lost."""
    held = {}
    for case in cases:
        off = case.median(who, *QUANTITIES[0][:2])
        if off is not None and case.lost(who) == 0:
            held[case.name] = off
    return held


def _said_of_sizes(cases: list[Case]) -> str:
    held = _held(cases)
    if not held:
        return "With no size the ball was held in all films."
    by_name = {c.name: c for c in cases}
    best = min(held, key=lambda name: held[name])
    near = [name for name, off in held.items() if off <= NEARLY * held[best]]
    smallest = min(held, key=float)
    said = [
        f"Of the radii tried `so3` holds the ball in all films with {', '.join(held)} mm ({smallest} mm are "
        f"{by_name[smallest].mean('diameter_px'):.1f} px across in the middle of the ball); its attitude is best with "
        f"{best} mm ({held[best]:.4f}°)."
    ]
    for who in kit.TRACKERS[:2]:
        theirs = _held(cases, who)
        said.append(f"`{who}`: {', '.join(theirs)} mm." if theirs else f"`{who}` loses some film with each.")
    largest = max(held, key=float)
    before, after = _centre(by_name[best]), _centre(by_name[largest])
    if held[largest] > NEARLY * held[best] and before and after:
        said.append(
            f"With {largest} mm it is worse again ({held[largest]:.4f}°): the centres that are measured are off by "
            f"{after:.3f} px in place of {before:.3f} px, and "
            f"{100.0 * by_name[largest].mean('in_view_share'):.0f} % of the near discs are wholly in view in place of "
            f"{100.0 * by_name[best].mean('in_view_share'):.0f} %."
        )
    advised = min(near, key=float)
    said.append(
        f"Advice: a radius of {advised} mm, {by_name[advised].mean('diameter_px'):.1f} px across, is within "
        f"{100.0 * (NEARLY - 1.0):.0f} % of the best; for another camera or distance, keep the pixels."
    )
    return " ".join(said)


def _said_of_layouts(cases: list[Case]) -> str:
    held = _held(cases)
    lost = [f"{c.name} ({c.lost('so3')} of {len(c.films)})" for c in cases if c.lost("so3")]
    unsure = [f"{c.name} ({100.0 * c.mean('recognised'):.1f} %)" for c in cases if c.mean("recognised") < _RECOGNISED]
    said = ["The ball is turned once about the horizontal axis, so that all its sides pass."]
    if len(held) > 1:
        best, worst = min(held, key=lambda n: held[n]), max(held, key=lambda n: held[n])
        said.append(
            f"Of the layouts with which `so3` never loses it, the attitude is best with *{best}* ({held[best]:.4f}°) "
            f"and worst with *{worst}* ({held[worst]:.4f}°)."
        )
    said.append(f"It is lost with: {', '.join(lost)}." if lost else "`so3` loses it with none.")
    if unsure:
        said.append(
            f"One picture does not tell the attitude every time ({100.0 * MISSING:.0f} % of the discs hidden, "
            f"directions good to {np.degrees(SURE):g}°) with: {', '.join(unsure)}."
        )
    advised = [c.name for c in cases if c.name in held and c.mean("recognised") >= _RECOGNISED]
    if advised:
        said.append(
            f"Advice: of those tried, *{'*, *'.join(advised)}* {'are' if len(advised) > 1 else 'is'} never lost and "
            f"recognised from one picture ({100.0 * _RECOGNISED:.0f} % of the time or more)."
        )
    return " ".join(said)


def _said_of_hands(cases: list[Case]) -> str:
    held = _held(cases)
    plain = held.get("none")
    said = []
    for case in cases:
        if case.name == "none":
            continue
        share = f"{case.name} ({100.0 * case.mean('in_view_share'):.0f} % wholly in view)"
        if case.name not in held:
            said.append(f"{share}: lost in {case.lost('so3')} of {len(case.films)} films")
        elif plain:
            said.append(f"{share}: {held[case.name] / plain:.1f} times the error without")
        else:
            said.append(f"{share}: {held[case.name]:.4f}°")
    text = (
        f"Hands come after {SETTLE:g} s and stay, and all is judged from half a second later on. Attitude of `so3`: "
        f"{'; '.join(said)}."
        if said
        else ""
    )
    ordered = sorted(cases, key=lambda c: -c.mean("in_view_share"))
    borne = list(takewhile(lambda c: c.name in held, ordered))
    if not borne:
        return text
    least = borne[-1]
    tried = "down to there no film is lost" if len(borne) > 1 else "with that no film is lost"
    return (
        f"{text} Advice: put camera and controls so that, while somebody plays, "
        f"{100.0 * least.mean('in_view_share'):.0f} % of the discs on its side or more stay wholly in view "
        f"({_used(least)} used in a frame): {tried}."
    )


_MARKS = "sDo"  # of the filters


def _figure_sizes(cases: list[Case]) -> Figure:
    def draw(canvas: Any) -> None:
        for ax in _panels(canvas, cases, "radius of a disc, mm", log=True):
            ax.set_xticks([c.x for c in cases], [c.name for c in cases])
            ax.minorticks_off()

    return Figure(
        "discs-size",
        "Errors against the size of the discs (medians; bars: span over films). Hollow: lost in some of the films. "
        "Crosses at the top: nothing tracked. Dotted: the Cramér-Rao bound.",
        draw,
        (7.2, 3.5),
    )


def _figure_layouts(cases: list[Case]) -> Figure:
    def draw(canvas: Any) -> None:
        axes = canvas.subplots(1, 2, sharey=True)
        for ax, (quantity, key, word, unit, _) in zip(axes, QUANTITIES, strict=True):
            for row, case in enumerate(reversed(cases)):
                for k, who in enumerate(kit.TRACKERS):
                    y, x = row + 0.18 * (1 - k), case.median(who, quantity, key)
                    if x is not None:
                        face = {"markerfacecolor": "none"} if case.lost(who) else {}
                        ax.plot([x], [y], color=f"C{k}", marker=_MARKS[k], linestyle="", markersize=5, **face)
                least = case.median("bound", quantity, key)
                if least is not None:
                    ax.plot([least, least], [row - 0.35, row + 0.35], color="0.5", **BOUND)
            ax.set(xscale="log", xlabel=f"{word} RMSE, {unit}", ylim=(-0.6, len(cases) - 0.4))
            decades(ax.xaxis, (1.0,))
            ax.grid(visible=False, axis="y")
        axes[0].set_yticks(range(len(cases)), [c.name for c in reversed(cases)])
        canvas.legend(handles=_handles(), loc="outside upper center", ncols=4)

    return Figure(
        "discs-layout",
        "Errors by the places of the discs while the ball is turned once (medians). Hollow: lost in some of the films. "
        "Dotted: the Cramér-Rao bound, which knows how steady this turn is.",
        draw,
        (7.2, 3.4),
    )


def _figure_hands(cases: list[Case]) -> Figure:
    def draw(canvas: Any) -> None:
        for ax in _panels(canvas, cases, "discs wholly in view, %", log=False):
            ax.invert_xaxis()

    return Figure(
        "discs-hands",
        "Errors while hands are on the ball, from none (left) to two very large ones (medians; bars: span over films). "
        "Hollow: lost in some of the films. Dotted: the Cramér-Rao bound.",
        draw,
        (7.2, 3.5),
    )


def _panels(canvas: Any, cases: list[Case], label: str, log: bool) -> Any:
    """Attitude and rate over x, a line per filter, and the bound."""
    axes = canvas.subplots(1, 2)
    for ax, (quantity, key, word, unit, _) in zip(axes, QUANTITIES, strict=True):
        for k, who in enumerate(LINES):
            known = [(c, c.values(who, quantity, key)) for c in cases]
            known = [(c, v) for c, v in known if v]
            x, y = [c.x for c, _ in known], [float(np.median(v)) for _, v in known]
            if who == "bound":
                ax.plot(x, y, color="0.5", **BOUND)
                continue
            ax.plot(x, y, color=f"C{k}", linestyle="-")
            for (case, values), middle in zip(known, y, strict=True):
                ax.plot([case.x] * 2, [min(values), max(values)], color=f"C{k}", linestyle="-", linewidth=0.8)
                face = {"markerfacecolor": "none"} if case.lost(who) else {}
                ax.plot([case.x], [middle], color=f"C{k}", marker=_MARKS[k], linestyle="", **face)
            nothing = [c.x for c in cases if not c.values(who, quantity, key)]
            high = [0.98 - 0.05 * k] * len(nothing)
            ax.plot(nothing, high, color=f"C{k}", marker="x", linestyle="", transform=ax.get_xaxis_transform())
        ax.set(xscale="log" if log else "linear", yscale="log", xlabel=label, ylabel=f"{word} RMSE, {unit}")
        decades(ax.yaxis)
    canvas.legend(handles=_handles(), loc="outside upper center", ncols=4)
    return axes


def _handles() -> list[Any]:
    from matplotlib.lines import Line2D

    lines = [
        Line2D([], [], color=f"C{k}", linestyle="-", marker=_MARKS[k], label=who) for k, who in enumerate(kit.TRACKERS)
    ]
    return [*lines, Line2D([], [], color="0.5", label="Cramér-Rao bound", **BOUND)]
