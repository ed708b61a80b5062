"""What the experiments on speed and blur are said to show: tables, figures and sentences."""

from typing import Any

import numpy as np

from spheremouse.experiments.kit.film import TRACKERS
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.kit.world import (
    DISCS,
    HOLD,
    NEW,
    NOISE,
    WHO,
    WRONG,
)
from spheremouse.experiments.limits import (
    ACCELERATIONS,
    FASTEST,
    FILMED_SECONDS,
    HARDEST,
    LADDER,
    PUSH,
    SLOWEST,
    WHOLE,
    in_degrees,
)
from spheremouse.experiments.report.cells import (
    BESIDE,
    LOOK,
    Grouped,
    label_lines,
    legend_below,
    plain,
    rate_axis,
    span,
    those,
    with_broken,
)
from spheremouse.experiments.report.covers import (
    again_about,
    again_figure,
    again_table,
    cover_about,
    cover_figure,
    cover_table,
    hidden,
    waits_of,
)
from spheremouse.experiments.report.page import failures
from spheremouse.experiments.report.plot import BOUND
from spheremouse.simulate.ball.film import default_scene

_SOFTEST = 1.0  # rad/s², the least that is tried
_FLICK = float(np.radians(400.0))  # rad/s, about the fastest that hands turn the ball
_STOP = 100.0  # rad/s², of a stop by hand (`so3.levels`)
_ALL = 0.99  # of what was tried


def section(request: Request, results: Results) -> Section:
    """Maps of what is followed, hidden, found again."""
    good = {k: r for k, r in results.items() if "error" not in r}
    fast, films, covers, again = (_grouped(good, name) for name in ("speed", "film", "cover", "again"))
    bad = {k: r for k, r in results.items() if "error" in r}
    parts: list[str | Table | Figure] = [_about()]
    if fast:
        parts += [_speed_figure(fast), _speed_table(fast, _grouped(bad, "speed")), _softest(fast), _map_figure(fast)]
    if films:
        parts += [
            _film_about(films),
            *([_film_figure(films)] if len({e for _, e in films}) > 1 else []),
            _film_table(films, _grouped(bad, "film")),
        ]
    if covers:
        parts += [cover_about(good), cover_figure(covers), cover_table(covers, good, _grouped(bad, "cover"))]
    if again:
        parts += [again_about(good), again_figure(again), again_table(again, _grouped(bad, "again"))]
    advice = _advice(fast, films, covers, again)
    parts += [advice] if advice else []
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), dict(results))


def _grouped(good: Results, name: str) -> dict[tuple[float, ...], list[Result]]:
    """Results of a kind by all numbers of their keys but the last; those of pictures that check others are left out."""
    found: dict[tuple[float, ...], list[Result]] = {}
    for key, result in good.items():
        kind, *numbers = key.split("-")
        if kind == name and numbers[-1] != "filmed":
            found.setdefault(tuple(float(n) for n in numbers[:-1]), []).append(result)
    return dict(sorted(found.items()))


def _about() -> str:
    return (
        f"A ball of {DISCS} discs before the far camera is sped up evenly from rest about an axis drawn at random. "
        "It is "
        f"followed as long as it is not lost and what it turned within the last {HOLD:g} s is right to {WRONG:g}°; "
        f"limits are found by bisection, up to {in_degrees(FASTEST):.0f} °/s and {HARDEST:g} rad/s²: a limit is the "
        "first that is met, and beyond it some rates may hold again. `so3` has seen the ball "
        "from all "
        "sides, or it is new to it; the published filters remember no disc that is out of view. Rates and "
        "accelerations "
        "are sought without pictures, with discs where a camera would see them and centres as noisy as the detector "
        "says: "
        "while pictures are sharp the detector, which then looks at all of them, is not what limits. Figures show "
        "medians "
        "and spans over balls and axes."
    )


def _speed_table(fast: Grouped, bad: Grouped) -> Table:
    rows = []
    for (fps,), results, made in with_broken(fast, bad):
        if not results:
            rows.append((f"{fps:g}", made, *["–"] * 4))
            continue
        for k, who in enumerate(WHO):
            rate, push = in_degrees(_middle(results, who, 0)), _middle(results, who, None)
            rows.append(
                (
                    *((f"{fps:g}", made) if k == 0 else ("", "")),
                    f"`{who}`",
                    _limit(rate, in_degrees(SLOWEST), in_degrees(FASTEST)),
                    _limit(push, _SOFTEST, HARDEST),
                    f"{PUSH * fps:.0f}" if k == 0 else "",
                )
            )
    head = (
        *("Hz", "balls", ""),
        f"rate, °/s, at {ACCELERATIONS[0]:g} rad/s²",
        f"acceleration, rad/s², to {in_degrees(PUSH):.0f} °/s",
        "which is between two frames from, rad/s²",
    )
    return Table(head, tuple(rows), "Highest rate and highest acceleration that are followed (medians)")


def _limit(value: float, least: float, most: float) -> str:
    if value <= 0.0:
        return f"lost at {least:.0f}, the least tried"
    return f"all, to {most:.0f}" if value > _ALL * most else f"{value:.0f}" if value >= 10.0 else f"{value:.1f}"


def _softest(fast: Grouped) -> str:
    """Where the gentlest push is lost and a harder one is not: nothing that bisection can show."""
    said = []
    for (fps,), results in fast.items():
        for who in WHO:
            rate = _middle(results, who, 0)
            if _middle(results, who, None) <= 0.0 and rate >= PUSH:
                said.append(f"`{who}` at {fps:g} Hz ({in_degrees(rate):.0f} °/s)")
    if not said:
        return ""
    turned = PUSH**2 / (2.0 * _SOFTEST)
    return (
        f"Lost at {_SOFTEST:g} rad/s² does not mean lost at all others: on that way to {in_degrees(PUSH):.0f} °/s the "
        f"ball turns by {turned:.1f} rad, and a gap between discs may end it. At {ACCELERATIONS[0]:g} rad/s² more than "
        f"these {in_degrees(PUSH):.0f} °/s are reached (medians) by {', '.join(said)}."
    )


def _of(results: list[Result], who: str, k: int | None) -> list[float]:
    """Rates at the k-th acceleration, or (None) accelerations."""
    return [r[who]["acceleration"] if k is None else r[who]["rate"][k] for r in results]


def _middle(results: list[Result], who: str, k: int | None) -> float:
    return float(np.median(_of(results, who, k)))


def _speed_figure(fast: dict[tuple[float, ...], list[Result]]) -> Figure:
    rates = [fps for (fps,) in fast]

    def draw(canvas: Any) -> None:
        for ax, (k, unit, label, least, most) in zip(
            canvas.subplots(1, 2),
            (
                (0, in_degrees(1.0), f"highest rate at {ACCELERATIONS[0]:g} rad/s², °/s", 20.0, in_degrees(FASTEST)),
                (None, 1.0, f"highest acceleration to {in_degrees(PUSH):.0f} °/s, rad/s²", 1.0, HARDEST),
            ),
            strict=True,
        ):
            ends = []
            for who, (colour, mark, dash) in LOOK.items():
                spans = [[max(unit * v, least) for v in _of(results, who, k)] for results in fast.values()]
                middle, x = [float(np.median(v)) for v in spans], [f * BESIDE[who] for f in rates]
                ax.plot(x, middle, color=colour, marker=mark, linestyle=dash)
                ax.fill_between(x, [min(v) for v in spans], [max(v) for v in spans], color=colour, alpha=0.15, lw=0)
                ends.append((middle[-1], who, colour))
            if k is None:
                between = [PUSH * fps for fps in rates]
                ax.plot(rates, between, color="0.5", **BOUND)
                ax.text(rates[0], 1.1 * between[0], "between two frames", color="0.5", fontsize=7.5, va="bottom")
            ax.axhline(most, color="0.5", **BOUND)
            ax.text(rates[0], 1.1 * most, "all that was tried", color="0.5", fontsize=7.5, va="bottom")
            ax.set(yscale="log", ylim=(least, 2.0 * most), title=label)
            plain(ax.yaxis)
            rate_axis(ax, rates)
            label_lines(ax, rates[-1], ends)

    caption = (
        "How fast and how suddenly a ball may turn and still be followed, against the frame rate, without motion "
        "blur: medians and spans. At the lower edge: lost at the least that was tried. Above the rising dotted line "
        "the whole acceleration is between two frames."
    )
    return Figure("limits-speed", caption, draw, (7.2, 3.2))


def _map_figure(fast: dict[tuple[float, ...], list[Result]]) -> Figure:
    def draw(canvas: Any) -> None:
        axes = np.atleast_1d(canvas.subplots(1, len(fast), sharey=True))
        for ax, ((fps,), results) in zip(axes, fast.items(), strict=True):
            for who, (colour, mark, dash) in LOOK.items():
                reached = [max(in_degrees(_middle(results, who, k)), 20.0) for k in range(len(ACCELERATIONS))]
                ax.plot(ACCELERATIONS, reached, color=colour, marker=mark, linestyle=dash)
                ax.fill_between(ACCELERATIONS, 20.0, reached, color=colour, alpha=0.06, lw=0)
            ax.plot(
                ACCELERATIONS, [in_degrees(a / fps) for a in ACCELERATIONS], color="0.5", linestyle="--", linewidth=0.7
            )
            ax.axvline(_STOP, color="0.5", **BOUND)
            ax.axhline(in_degrees(_FLICK), color="0.5", **BOUND)
            ax.set(xscale="log", yscale="log", ylim=(20.0, 1.5 * in_degrees(FASTEST)), title=f"{fps:g} Hz")
            ax.set_xticks(ACCELERATIONS, [f"{a:g}" for a in ACCELERATIONS])
            ax.minorticks_off()
            plain(ax.yaxis)
        axes[0].set_ylabel("rate reached, °/s")
        axes[len(axes) // 2].set_xlabel("acceleration, rad/s²")
        legend_below(canvas, WHO)

    caption = (
        "Below a line a ball is followed: what rate it may be sped up to at what acceleration, by frame rate "
        "(medians). "
        f"Dotted: a flick of {in_degrees(_FLICK):.0f} °/s, and the {_STOP:g} rad/s² of a stop by hand. Below "
        "the thin dashed line all of the way from rest is between two frames."
    )
    return Figure("limits-map", caption, draw, (7.2, 2.9))


def _film_about(films: dict[tuple[float, ...], list[Result]]) -> str:
    return (
        "With motion blur the detector limits, so that this is filmed: the ball is brought to a rate without "
        "pictures, about "
        "an axis across the view, where discs move fastest, and "
        f"then filmed at it for {FILMED_SECONDS:g} s, noise of {NOISE:g} grey values, at rates a factor of √2 apart. "
        "It is followed "
        "when it is right to the end and discs have held its attitude to the last."
        " A filter that loses the ball before that rate counts as lost." + _sharp(films)
    )


def _sharp(films: dict[tuple[float, ...], list[Result]]) -> str:
    """Sharp pictures against none."""
    pairs = [(who, *r["sharp"][who]) for results in films.values() for r in results if "sharp" in r for who in TRACKERS]
    if not pairs:
        return ""
    most = 0.99 * WHOLE
    kept = [who for who in TRACKERS if all(min(a, b) > most for w, a, b in pairs if w == who)]
    said = [
        f"`{who}` at {in_degrees(a):.0f} °/s (without pictures {in_degrees(b):.0f})"
        for who, a, b in pairs
        if who not in kept
    ]
    text = f" Where sharp pictures are taken all the way from rest, lost are {', '.join(said)}" if said else ""
    ends = f"up to {in_degrees(WHOLE):.0f} °/s, the end of it, not: {', '.join(f'`{who}`' for who in kept)}"
    return f"{text}; {ends}." if text and kept else f"{text}." if text else f" In sharp pictures lost are, {ends}."


def _film_table(films: Grouped, bad: Grouped) -> Table:
    rows = []
    for (fps, exposure), results, made in with_broken(films, bad):
        cells = [span([in_degrees(r[who]) for r in results]) if results else "–" for who in TRACKERS]
        rows.append((f"{fps:g}", f"{exposure:g}", made, _smear(1e-3 * exposure), *cells))
    head = ("Hz", "exposure, ms", "balls", "smeared over a disc's width at, °/s", *(f"`{t}`" for t in TRACKERS))
    most = f"{in_degrees(LADDER[-1]):.0f} is all that was filmed"
    return Table(head, tuple(rows), f"Highest rate followed in pictures, °/s ({most}; of several balls: from – to)")


def _smear(exposure: float) -> str:
    return "–" if exposure == 0.0 else f"{in_degrees(_width(exposure)):.0f}"


def _width(exposure: float) -> float:
    """rad/s, at which a disc in the middle of the ball moves by its own width while it is exposed."""
    scene = default_scene(1)
    return 2.0 * scene.disc_angle / exposure


def _film_figure(films: dict[tuple[float, ...], list[Result]]) -> Figure:
    exposures = sorted({e for f, e in films if f == 60.0})
    place = {e: k for k, e in enumerate(exposures)}

    def draw(canvas: Any) -> None:
        ax = canvas.subplots()
        ends = []
        for who in TRACKERS:
            colour, mark, dash = LOOK[who]
            spans = [[max(in_degrees(r[who]), 30.0) for r in films[60.0, e]] for e in exposures]
            middle = [float(np.median(v)) for v in spans]
            ax.plot(range(len(exposures)), middle, color=colour, marker=mark, linestyle=dash)
            low, high = ([f(v) for v in spans] for f in (min, max))
            ax.fill_between(range(len(exposures)), low, high, color=colour, alpha=0.15, lw=0)
            ends.append((middle[-1], who, colour))
            for (fps, e), results in films.items():
                if fps != 60.0 and e in place:
                    x = place[e] + (0.12 if fps > 60.0 else -0.12)
                    y = max(float(np.median([in_degrees(r[who]) for r in results])), 30.0)
                    ax.plot([x], [y], color=colour, marker=mark, markerfacecolor="none", linestyle="")
        smeared = [(place[e], in_degrees(_width(1e-3 * e))) for e in exposures if e]
        ax.plot([x for x, _ in smeared], [y for _, y in smeared], color="0.5", **BOUND)
        if smeared:
            ends.append((smeared[-1][1], "smear: a disc's width", "0.5"))
        ax.axhline(in_degrees(LADDER[-1]), color="0.5", linewidth=0.6)
        ax.set(yscale="log", xlabel="exposure, ms", ylabel="highest rate followed, °/s", ylim=(30.0, 4000.0))
        ax.set_xticks(range(len(exposures)), [f"{e:g}" for e in exposures])
        plain(ax.yaxis)
        label_lines(ax, len(exposures) - 1, ends)

    caption = (
        "How fast a ball may turn before a camera of 60 Hz by its exposure; hollow: of 30 Hz (left) and 120 Hz "
        "(right). "
        "Thin line: the fastest that was filmed. Dotted: a disc in the middle of the ball moves by its width."
    )
    return Figure("limits-exposure", caption, draw, (7.2, 3.0))


def _advice(
    fast: dict[tuple[float, ...], list[Result]],
    films: dict[tuple[float, ...], list[Result]],
    covers: dict[tuple[float, ...], list[Result]],
    again: dict[tuple[float, ...], list[Result]],
) -> str:
    """For who builds a device, from what was measured."""
    said = []
    if fast:
        k = int(np.argmin(np.abs(np.log(np.array(ACCELERATIONS) / _STOP))))
        for who in (*TRACKERS, NEW):
            enough = [fps for (fps,), r in fast.items() if min(_of(r, who, k)) >= _FLICK]
            said.append((who, those(enough, [fps for (fps,) in fast])))
        text = "; ".join(f"`{who}` {when}" for who, when in said)
        said = [
            f"A flick to {in_degrees(_FLICK):.0f} °/s at {ACCELERATIONS[k]:g} rad/s² is followed, on every ball: "
            f"{text}."
        ]
    if films:
        at = {e: in_degrees(min(x["so3"] for x in r)) for (fps, e), r in films.items() if fps == 60.0}
        at = at or {e: in_degrees(min(x["so3"] for x in r)) for (_, e), r in films.items()}
        each = ", ".join(f"{rate:.0f} °/s with {e:g} ms" for e, rate in at.items())
        said.append(f"In pictures `so3` follows, on every ball, {each} of exposure.")
        enough = [e for e, rate in at.items() if rate >= in_degrees(_FLICK)]
        with_all = f"every exposure tried, to {max(at):g} ms" if len(enough) == len(at) else ""
        some = f"exposures of {', '.join(f'{e:g}' for e in enough)} ms" if enough else "none of these"
        said.append(f"{in_degrees(_FLICK):.0f} °/s, at an even rate, are followed with {with_all or some}.")
    if covers:
        worst = {n: hidden(r, "so3", np.min) for (n,), r in covers.items()}
        shares = [f"{share:.0f} % of the visible ball with {n:g} discs" for n, share in worst.items() if share]
        if shares:
            said.append(f"Whatever side it came from, a cover hid {', '.join(shares)} before `so3` lost it.")
        said += [f"{n:g} discs are too few: it is lost without a cover." for n, s in worst.items() if not s]
    if again:
        waits = [w for results in again.values() for w in waits_of(results, "so3", "attitude")]
        if waits and np.isfinite(max(waits)):
            frames = max(r["so3"]["attitude"]["frames"] for rs in again.values() for r in rs if "error" not in r["so3"])
            said.append(
                f"A ball that `so3` knows is found again within {frames} frame{'s' if frames > 1 else ''}: "
                "show it "
                "all sides of the ball, or keep the map."
            )
        elif waits:
            said.append("Even a ball that `so3` knows was not always found again.")
    return " ".join(said)
