"""What the experiments on how the camera films are said to show: tables, figures and sentences."""

from collections.abc import Callable
from typing import Any

import numpy as np

from spheremouse.ball.rig import UNKNOWN_READOUT
from spheremouse.experiments.kit import film as kit
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.kit.tour import (
    AXES,
    ESTIMATED,
    FAR_OFF,
    FOLLOWED,
    IGNORED,
    KNOWN,
    NEAR,
    NOISE,
    SHARE,
    USUAL,
    is_lost,
)
from spheremouse.experiments.report.cells import CLEARLY, COLOURS, DASHES, MARKS, films_cell
from spheremouse.experiments.report.page import failures
from spheremouse.experiments.report.plot import BOUND, label_ends, plain_numbers
from spheremouse.experiments.viewing import FASTEST, KINDS, Kind


def section(request: Request, results: Results) -> Section:
    """Four figures with their tables, and what to buy."""
    by_kind = {name: points(results, kind) for name, kind in KINDS.items()}
    films = [p for found in by_kind.values() for ps in found.values() for p in ps]
    parts: list[str | Table | Figure] = [_intro(films)]
    for name, kind in KINDS.items():
        found = by_kind[name]
        parts.append(f"### {kind.title}")
        if not found:
            parts.append("No result.")
            continue
        parts += [_SAID[name](found), _figure(kind, found), _table(kind, found, results), _advice(kind, found)]
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(parts), dict(results))


def points(results: Results, kind: Kind) -> dict[str, list[Result]]:
    """By value, in order: what each film gave; values without any are left out."""
    found: dict[str, list[Result]] = {}
    for word in kind.whole:
        here = []
        for key, result in results.items():
            if "error" in result:
                continue
            what, _, rest = key.partition("-")
            if what == "rate" == kind.name and word in result["points"]:
                here.append(result["points"][word])
            elif (what == kind.name and rest.rpartition("-")[0] == word) or (what == "plain" and word == kind.plain):
                here.append(result)
        if here:
            found[word] = here
    return found


def _broken(results: Results, kind: Kind, word: str) -> int:
    """How many films of a value failed."""
    starts = [f"{kind.name}-" if kind.name == "rate" else f"{kind.name}-{word}-"]
    starts += ["plain-"] if word == kind.plain else []
    return sum("error" in r and key.startswith(tuple(starts)) for key, r in results.items())


def _intro(films: list[Result]) -> str:
    if not films:
        return "The far camera, 26 discs."
    peak = max(f["moved"]["peak"] for f in films)
    speeds = [f["moved"]["rms"] for f in films]
    return (
        f"The far camera, 26 discs, noise of {NOISE:g} grey values; the ball turns from rest to rest about "
        f"{len(AXES)} axes one after the other, with {np.median(speeds):.0f} °/s (RMS) and {peak:.0f} °/s at most. "
        f"Unless a film is about that: {USUAL} frames per second, 640x480, a short exposure, all rows at once. Each "
        "point is the median over films with other places of the discs and another order of the axes, and the shade is "
        "from the best to the worst of them. `ekf1` and `ekf2` are told the true acceleration as σ_w, "
        f"{np.median([f['moved']['acceleration'] for f in films]):.1f} rad/s² (RMS per axis); the thesis' is "
        f"{kit.settings_of().euler.acceleration_sigma:g} rad/s². A film "
        f"counts as lost where the tracker said so, tracked less than {100.0 * FOLLOWED:.0f} % of the frames, or is "
        f"off by more than {FAR_OFF:g}° (RMS): a cross. "
        "The dotted line is the Cramér-Rao bound of a smooth motion for centres as good as those that `so3` had; "
        "`ekf1` and `ekf2` look at whole pictures and have centres of their own."
    )


def _median(found: list[Result], who: str, what: str) -> float | None:
    """Over the films; None where one of them has none."""
    values = _all(found, who, what)
    return float(np.median(values)) if values and len(values) == len(found) else None


def _all(found: list[Result], who: str, what: str) -> list[float]:
    rows = [_row(f, who) for f in found]
    return [r[what] for r in rows if r is not None and r[what] is not None]


def _row(point: Result, who: str) -> Result | None:
    """Of a tracker, or of the bound; without a rolling shutter its readout is as good as known."""
    if who == "bound":
        return point["bound"]
    return point["rows"].get(who, point["rows"][KNOWN] if who in (ESTIMATED, IGNORED) else None)


def lost(found: list[Result], who: str) -> int:
    """In how many films."""
    rows = [_row(f, who) for f in found]
    return sum(r is not None and is_lost(r) for r in rows)


def good(found: list[Result], who: str) -> bool:
    """Nothing lost, and attitude and rate as good as a pointer needs; the bound loses nothing."""
    attitude, rate = (_median(found, who, what) for what in ("attitude", "rate"))
    speed = float(np.median([f["moved"]["rms"] for f in found]))
    return (
        (who == "bound" or not lost(found, who))
        and attitude is not None
        and rate is not None
        and attitude < NEAR
        and rate < SHARE * speed
    )


def good_range(found: dict[str, list[Result]], who: str) -> tuple[str, str] | None:
    """First and last of the most values in a row at which all is good; None where it is at none."""
    rows: list[list[str]] = [[]]
    for word, here in found.items():
        if good(here, who):
            rows[-1].append(word)
        else:
            rows.append([])
    longest = max(rows, key=len)
    return (longest[0], longest[-1]) if longest else None


def _table(kind: Kind, found: dict[str, list[Result]], results: Results) -> Table:
    rows = []
    for word in kind.whole:
        here, broken = found.get(word, []), _broken(results, kind, word)
        shown, films = word.replace("x", "×"), films_cell(len(here), broken)
        if not here:
            rows += [(shown, films, *["–"] * 4)] if broken else []
            continue
        for name in (*kind.shown, "bound"):
            cells = [f"`{name}`" if name != "bound" else name]
            gone = 0 if name == "bound" else lost(here, name)
            for what, digits in (("attitude", 3), ("rate", 2)):
                x = _median(here, name, what)
                cells.append("lost" if 2 * gone >= len(here) else "–" if x is None else f"{x:.{digits}f}")
            cells.append("" if name == "bound" else f"{gone} of {len(here)}")
            rows.append((*((shown, films) if name == kind.shown[0] else ("", "")), *cells))
    head = (kind.label if kind.name != "size" else "picture, px", "films", "", "attitude, °", "rate, °/s", "lost")
    return Table(head, tuple(rows), f"{kind.title}: median of the combined RMSE")


def _ratio(found: dict[str, list[Result]], who: str, what: str, a: str, b: str) -> str:
    """How much larger at `b` than at `a`, in words for a text."""
    x, y = _median(found[a], who, what), _median(found[b], who, what)
    return "–" if not x or y is None else f"{y / x:.2g}"


def _by_all(found: dict[str, list[Result]], kind: Kind, what: str, a: str, b: str) -> str:
    who = (*(w for w in kind.shown if w not in (ESTIMATED, IGNORED)), "bound")
    return ", ".join(f"{_ratio(found, w, what, a, b)} ({'the bound' if w == 'bound' else f'`{w}`'})" for w in who)


def _said_of_rate(found: dict[str, list[Result]]) -> str:
    slow, fast = next(iter(found)), next(reversed(found))
    said, worse = [], []
    for who in (*KINDS["rate"].shown, "bound"):
        rates = {word: x for word, here in found.items() if (x := _median(here, who, "rate")) is not None}
        if slow in rates and fast in rates:
            best = min(rates, key=lambda word: rates[word])
            name = "the bound" if who == "bound" else f"`{who}`"
            ends = f"{rates[slow]:.2f} at {slow}, {rates[fast]:.2f} at {fast}"
            said.append(f"{name} {rates[best]:.2f} at {best} ({ends})")
            if rates[fast] > CLEARLY * rates[best]:
                worse.append(f"{name} ({rates[fast] / rates[best]:.1f} times)")
    there = f"Worse at {fast} than at their best: {', '.join(worse)}." if worse else f"None is worse at {fast}."
    return (
        f"All are the same film at {FASTEST} frames per second, of which each second, third, ... is taken. The error "
        f"of the rate, °/s, is least: {'; '.join(said)}. The thesis expected better results of a higher frame rate, at "
        f"the price of time. {there} The light that a fast camera lacks is not in these films: the noise is the same."
    )


def _said_of_size(found: dict[str, list[Result]]) -> str:
    small, large = next(iter(found)), next(reversed(found))
    if small == large:
        return f"Only {small.replace('x', '×')} was filmed."
    blind = [(w, [f["pose"] for f in here if f.get("pose")]) for w, here in found.items()]
    said = [
        f"At {w.replace('x', '×')} the camera's pose was not found in {len(p)} of {len(found[w])} films: "
        f"{_why_unfound(p)}; these were tracked with the true pose, as found beforehand in a larger picture."
        for w, p in blind
        if p
    ]
    kind = KINDS["size"]
    return " ".join([
        "The field of view stays, the focal length in pixels grows with the picture. Error at "
        f"{large.replace('x', '×')} over that at {small.replace('x', '×')}: rate "
        f"{_by_all(found, kind, 'rate', small, large)}; attitude {_by_all(found, kind, 'attitude', small, large)}.",
        *said,
    ])  # fmt: skip


def _why_unfound(said: list[str]) -> str:
    return "no target was found" if all(s.startswith("0 of") for s in said) else "too few targets were found"


def _said_of_blur(found: dict[str, list[Result]]) -> str:
    sharp, open_ = next(iter(found)), next(reversed(found))
    if sharp == open_:
        return f"Only {sharp} ms were filmed."
    kind = KINDS["blur"]
    return (
        f"At {USUAL} frames per second a frame lasts {1e3 / USUAL:.0f} ms. Error with an exposure of {open_} ms over "
        f"that with {sharp} ms: rate {_by_all(found, kind, 'rate', sharp, open_)}; attitude "
        f"{_by_all(found, kind, 'attitude', sharp, open_)}. A stamp is mid-exposure, so that a smear has its centre "
        "where the disc was then."
    )


def _said_of_readout(found: dict[str, list[Result]]) -> str:
    none, slow = next(iter(found)), next(reversed(found))
    if none == slow:
        return f"Only {none} ms were filmed."
    rows = []
    for who, how in (
        (KNOWN, "`so3` is told the readout"),
        (ESTIMATED, f"it is told that it is unknown (0 ± {1e3 * UNKNOWN_READOUT:.0f} ms) and estimates it"),
        (IGNORED, "it is told that there is none"),
        ("ekf1", "`ekf1`, which takes all rows for simultaneous"),
        ("ekf2", "`ekf2`, the same"),
    ):
        factors = [_ratio(found, who, what, none, slow) for what in ("attitude", "rate")]
        rows.append(f"{how}: {factors[0]} and {factors[1]}")
    return (
        f"Rows are read one after the other, over the readout. Error at {slow} ms over that at {none} ms, of attitude "
        f"and rate, where {'; '.join(rows)}.{_worse_for_telling(found[slow], slow)}"
    )


def _worse_for_telling(here: list[Result], slow: str) -> str:
    """Where `so3` does worse with the readout than without; empty where it does not."""
    said = []
    for what, unit, digits in (("attitude", "°", 3), ("rate", "°/s", 2)):
        told, *others = (_median(here, who, what) for who in (KNOWN, ESTIMATED, IGNORED))
        known = [x for x in others if x is not None]
        if told is not None and known and told > CLEARLY * min(known):
            words = [
                f"{x:.{digits}f}{'' if unit == '°' else ' '}{unit} {how}"
                for x, how in zip((told, *others), ("told", "estimated", "ignored"), strict=True)
                if x is not None
            ]
            said.append(f"{what} {', '.join(words)}")
    return f" Telling it makes it worse with {slow} ms: {'; '.join(said)}." if said else ""


_SAID: dict[str, Callable[[dict[str, list[Result]]], str]] = {
    "rate": _said_of_rate,
    "size": _said_of_size,
    "blur": _said_of_blur,
    "readout": _said_of_readout,
}
_UNIT = {"rate": " frames per second", "size": "", "blur": " ms of exposure", "readout": " ms of readout"}


def _advice(kind: Kind, found: dict[str, list[Result]]) -> str:
    """What to look for in a camera."""
    unit, said, never = _UNIT[kind.name], [], []
    for who in kind.shown:
        ends = good_range(found, who)
        if ends is None:
            never.append(f"`{who}`")
            continue
        first, last = (word.replace("x", "×") for word in ends)
        if ends == (next(iter(found)), next(reversed(found))):
            said.append(f"`{who}` reaches that with all, {first} to {last}{unit}")
        else:
            values = f"{first} to {last}" if first != last else first
            said.append(f"`{who}` reaches that with {values}{unit}")
    if never:
        bound = "" if any(good(here, "bound") for here in found.values()) else ", nor does the bound"
        asks = ": this motion asks too much" if bound else ""
        said.append(f"{', '.join(never)} {'reach' if len(never) > 1 else 'reaches'} that with none{bound}{asks}")
    return (
        f"For a device: if no film may be lost, the attitude must be good to {NEAR:g}° (a millimetre of the ball's "
        f"surface) and the rate to {SHARE:.0%} of the ball's own, of the values tried {'; '.join(said)}."
    )


def _figure(kind: Kind, found: dict[str, list[Result]]) -> Figure:
    def draw(canvas: Any) -> None:
        for ax, (what, unit) in zip(canvas.subplots(1, 2), (("attitude", "°"), ("rate", "°/s")), strict=True):
            ends = [_line(ax, kind, found, who, what) for who in (*kind.shown, "bound")]
            ax.set(yscale="log", xscale="log" if kind.log else "linear", ylabel=f"{what} RMSE, {unit}")
            ax.set_xlabel(kind.label)
            plain_numbers(ax.yaxis)
            _ticks(ax, kind, found)
            label_ends(ax, [end for end in ends if end is not None])
            if kind.name == "blur":
                top = ax.secondary_xaxis("top", functions=(_to_share, _from_share))
                top.set_xlabel("share of the frame's time, %")

    return Figure(
        f"viewing-{kind.name}",
        f"{kind.title}: combined errors of attitude and rate, median of the films (of `so3` their span, too), and the "
        "Cramér-Rao bound. "
        "Crosses: at least one film lost." + (" Hollow: the camera's pose was given." if kind.name == "size" else ""),
        draw,
        (7.2, 3.2 if kind.name != "blur" else 3.5),
    )


def _to_share(ms: Any) -> Any:
    return ms * USUAL / 10.0


def _from_share(percent: Any) -> Any:
    return percent * 10.0 / USUAL


def _x(kind: Kind, word: str) -> float:
    """Rows of a picture; frames per second; ms."""
    return float(word.split("x")[1] if kind.name == "size" else word)


def _ticks(ax: Any, kind: Kind, found: dict[str, list[Result]]) -> None:
    at = [_x(kind, word) for word in found]
    if kind.log:
        shown = [x for x in at if x != 80.0]  # no room beside 60 and 120
        ax.set_xticks(shown, [f"{x:g}" for x in shown])
        ax.xaxis.minorticks_off()
    else:
        ax.set_xticks(at)


def _line(
    ax: Any, kind: Kind, found: dict[str, list[Result]], who: str, what: str
) -> tuple[str, float, str | float] | None:
    """Draw one; its name, where it ends and its colour."""
    curve = [(_x(kind, word), _median(here, who, what), here) for word, here in found.items()]
    known = [(x, y, here) for x, y, here in curve if y is not None and y > 0.0]
    if not known:
        return None
    x, y = [k[0] for k in known], [k[1] for k in known]
    colour = COLOURS[who]
    if who == "bound":
        ax.plot(x, y, color=colour, **BOUND)
        return "bound", y[-1], colour
    if who == KNOWN:
        spans = [_all(here, who, what) for _, _, here in known]
        ax.fill_between(x, [min(s) for s in spans], [max(s) for s in spans], color=colour, alpha=0.15, linewidth=0)
    ax.plot(x, y, color=colour, linestyle=DASHES[who])
    for at, level, here in known:
        given = any(f.get("pose") for f in here)
        mark = "x" if lost(here, who) else MARKS[who]
        size = 7 if mark == "x" else None
        face = "none" if given else colour
        ax.plot([at], [level], color=colour, marker=mark, markersize=size, markerfacecolor=face, linestyle="")
    return who, y[-1], colour
