"""What the experiments on a ball that is covered are said to show: tables, figures and sentences."""

from collections.abc import Callable
from typing import Any

import numpy as np

from spheremouse.experiments.covers import (
    AFTER,
    ATTITUDE,
    COVERED,
    FPS,
    GROWS,
    RATE,
    STAYS,
    TURNING,
)
from spheremouse.experiments.kit.film import TRACKERS
from spheremouse.experiments.kit.job import Figure, Result, Results, Table
from spheremouse.experiments.kit.world import (
    DISCS,
    WHO,
)
from spheremouse.experiments.limits import in_degrees
from spheremouse.experiments.report.cells import (
    BESIDE,
    LOOK,
    Grouped,
    label_lines,
    legend_below,
    plain,
    rate_axis,
    span,
    with_broken,
)
from spheremouse.experiments.report.plot import BOUND


def cover_about(good: Results) -> str:
    return (
        f"An opaque cover grows over the ball, under the frame, from nothing to all within {GROWS:g} s, while the "
        "ball turns "
        f"as in the thesis (up to 28 °/s), {FPS:g} Hz. Shown is the share of the visible ball that was hidden when "
        "discs "
        "last held the attitude, without pictures; in the table pictures beside it, in which covers cut discs."
        + _cover_check(good)
    )


def _cover_check(good: Results) -> str:
    apart = [
        100.0 * (film[kind][who] - good[key.removesuffix("-filmed")][kind][who])
        for key, film in good.items()
        if key.startswith("cover-") and key.endswith("-filmed") and key.removesuffix("-filmed") in good
        for kind in film
        for who in TRACKERS
    ]
    if not apart:
        return ""
    off = np.abs(apart)
    return f" Pictures differ from none by {np.median(off):.1f} % of the ball (median; at most {off.max():.0f} %)."


def cover_table(covers: Grouped, good: Results, bad: Grouped) -> Table:
    rows = []
    for (discs,), results, made in with_broken(covers, bad):
        if not results:
            rows.append((f"{discs:g}", made, *["–"] * 7))
            continue
        film = good.get(f"cover-{discs:g}-0-filmed")
        for kind in results[0]:
            cells = [span([100.0 * r[kind][who] for r in results], nothing="lost before") for who in TRACKERS]
            filmed_ = [f"{100.0 * film[kind][who]:.0f}" if film and kind in film else "" for who in TRACKERS]
            rows.append((f"{discs:g}", made, kind, *cells, *filmed_))
    head = ("discs", "balls", "cover comes", *(f"`{t}`" for t in TRACKERS), *(f"`{t}`, filmed" for t in TRACKERS))
    return Table(head, tuple(rows), "Share of the visible ball hidden when it is lost, % (of several balls: from – to)")


def cover_figure(covers: dict[tuple[float, ...], list[Result]]) -> Figure:
    counts = [n for (n,) in covers]
    chosen = covers.get((float(DISCS),)) or next(iter(covers.values()))
    discs, kinds = float(DISCS) if (float(DISCS),) in covers else counts[0], list(chosen[0])

    def draw(canvas: Any) -> None:
        several = len(counts) > 1
        left, *rest = canvas.subplots(1, 2, width_ratios=(1.35, 1.0), sharey=True) if several else [canvas.subplots()]
        for k, who in enumerate(TRACKERS):
            colour, mark, _ = LOOK[who]
            for j, kind in enumerate(kinds):
                values = [100.0 * r[kind][who] for r in chosen]
                x = j + 0.2 * (k - 1)
                left.plot([x, x], [min(values), max(values)], color=colour, linestyle="-", linewidth=3.0, alpha=0.3)
                left.plot([x], [np.median(values)], color=colour, marker=mark, linestyle="")
        left.set_xticks(range(len(kinds)), ["\n".join(kind.rsplit(" ", 1)) for kind in kinds])
        left.tick_params(axis="x", labelsize=7.5)
        left.set(ylabel="hidden when it is lost, %", ylim=(0.0, 102.0), title=f"{discs:g} discs")
        left.grid(visible=False, axis="x")
        if not rest:
            legend_below(canvas, TRACKERS)
            return
        (right,), ends = rest, []
        for who in TRACKERS:
            colour, mark, dash = LOOK[who]
            middle, worst = ([hidden(results, who, f) for results in covers.values()] for f in (np.median, np.min))
            right.plot(counts, middle, color=colour, marker=mark, linestyle=dash)
            right.plot(counts, worst, color=colour, linestyle=dash, linewidth=0.7)
            ends.append((middle[-1], who, colour))
        right.set(xscale="log", xlabel="discs on the ball", title="median and worst cover", ylim=(0.0, 102.0))
        right.set_xticks(counts, [f"{n:g}" for n in counts])
        right.minorticks_off()
        label_lines(right, counts[-1], ends)

    caption = (
        "How much of the visible ball may be hidden before it is lost, by where the cover comes from (bars: span over "
        "balls), and by the number of discs (thin lines: the worst cover of all)."
    )
    return Figure("limits-cover", caption, draw, (7.2, 3.2))


def hidden(results: list[Result], who: str, by: Callable[[list[float]], Any]) -> float:
    """% hidden, over covers and balls."""
    return float(by([100.0 * r[kind][who] for r in results for kind in r]))


def again_about(good: Results) -> str:
    turned = np.degrees(TURNING * COVERED)
    check = ""
    for key, film in good.items():
        if key.endswith("-filmed") and key.startswith("again-"):
            twin = good.get(key.removesuffix("-filmed"))
            fps = float(key.split("-")[1])
            said, bare = (
                [f"`{who}` {_wait(r[who], 'attitude', fps)} and {_wait(r[who], 'rate', fps)}" for who in WHO]
                if r
                else []
                for r in (film, twin)
            )
            check = f" In pictures, at {key.split('-')[1]} Hz, attitude and rate take: {'; '.join(said)}."
            check += (
                " Without pictures it is the same." if said == bare else f" Without: {'; '.join(bare)}." if bare else ""
            )
    return (
        f"The ball turns on at {in_degrees(TURNING):.0f} °/s while nothing of it is seen for {COVERED:g} s, by "
        f"{turned:.0f}°. "
        f"From when the cover goes, as a whole: how long until the attitude is right again (to {ATTITUDE:g}°, and "
        "stays so "
        f"for {STAYS:g} s), and the rate (to {in_degrees(RATE):.0f} °/s). A cover goes when it likes: half a frame is "
        "added everywhere." + _gone_before(good) + check
    )


def _gone_before(good: Results) -> str:
    """Trials without a wait, by filter: the ball was lost before the cover came."""
    trials = [r for key, r in good.items() if key.startswith("again-") and not key.endswith("-filmed")]
    gone = {who: sum("error" in r[who] for r in trials) for who in WHO}
    said = ", ".join(f"{n} of `{who}`" for who, n in gone.items() if n)
    return (
        f" Trials in which it was lost before a cover came have no wait: {said} of {len(trials)} each." if said else ""
    )


def _half(fps: float) -> float:
    """ms that pass on average until the first frame after the cover went; in a trial it is taken at once."""
    return 500.0 / fps


def _wait(result: Result, what: str, fps: float) -> str:
    if "error" in result:
        return result["error"]
    waited = result[what]
    return (
        "never"
        if waited is None
        else f"{waited['ms'] + _half(fps):.0f} ms ({waited['frames']} frame{'s' if waited['frames'] > 1 else ''})"
    )


def waits_of(results: list[Result], who: str, what: str) -> list[float]:
    """ms, inf: never; those lost before are left out."""
    kept = [r[who] for r in results if "error" not in r[who]]
    return [np.inf if r[what] is None else r[what]["ms"] for r in kept]


def again_table(again: Grouped, bad: Grouped) -> Table:
    rows = []
    for (fps,), results, made in with_broken(again, bad):
        if not results:
            rows.append((f"{fps:g}", made, *["–"] * 3))
            continue
        for k, who in enumerate(WHO):
            cells = []
            for what in ("attitude", "rate"):
                waits = [_wait(r[who], what, fps) for r in results]
                order = sorted(waits, key=lambda w: float(w.split()[0]) if w[0].isdigit() else np.inf)
                cells.append(order[0] if len(set(order)) == 1 else f"{order[0]} to {order[-1]}")
            rows.append((*((f"{fps:g}", made) if k == 0 else ("", "")), f"`{who}`", *cells))
    head = ("Hz", "balls", "", "attitude", "rate")
    return Table(
        head, tuple(rows), f"Until it is right again after {COVERED:g} s of full cover (least and most over balls)"
    )


def again_figure(again: dict[tuple[float, ...], list[Result]]) -> Figure:
    rates = [fps for (fps,) in again]
    never = 1e3 * AFTER

    def draw(canvas: Any) -> None:
        for ax, what in zip(canvas.subplots(1, 2, sharey=True), ("attitude", "rate"), strict=True):
            ends = []
            for who, (colour, mark, dash) in LOOK.items():
                known = [(f, waits_of(r, who, what)) for (f,), r in again.items()]
                known = [(f, [min(w + _half(f), never) for w in v]) for f, v in known if v]
                if not known:
                    continue
                x, spans = [f * BESIDE[who] for f, _ in known], [v for _, v in known]
                middle = [float(np.median(v)) for v in spans]
                ax.plot(x, middle, color=colour, marker=mark, linestyle=dash)
                ax.fill_between(x, [min(v) for v in spans], [max(v) for v in spans], color=colour, alpha=0.15, lw=0)
                ends.append((middle[-1], who, colour))
            ax.axhline(never, color="0.5", **BOUND)
            ax.text(rates[0], 1.06 * never, f"never (in {AFTER:g} s)", color="0.5", fontsize=7.5, va="bottom")
            ax.set(yscale="log", ylim=(1.0, 2.2 * never), title=f"{what} right again")
            plain(ax.yaxis)
            rate_axis(ax, rates)
            label_lines(ax, rates[-1], ends)
            if what == "attitude":
                ax.set_ylabel("ms after the cover went")

    caption = (
        f"How long after {COVERED:g} s of full cover attitude and rate are right again, by frame rate: median and "
        "span over "
        "balls and axes; half a frame is added, since a cover goes when it likes."
    )
    return Figure("limits-again", caption, draw, (7.2, 3.2))
