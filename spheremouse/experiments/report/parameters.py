"""What the experiments on the filters' parameters are said to show: tables, figures and sentences."""

import statistics
from typing import Any, TypeGuard

from spheremouse.experiments.kit import r1
from spheremouse.experiments.kit.film import settings_of
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.parameters import (
    ATTITUDE,
    BEYOND,
    EXACT,
    PATHS,
    R_R1,
    R_S1,
    RATE,
    SIGMA_B,
    SIGMA_W,
    SPEED,
    Grid,
    key_of,
)
from spheremouse.experiments.report.page import failures, value
from spheremouse.experiments.report.plot import BOUND, THESIS, plain_numbers
from spheremouse.simulate.ball.film import SimulationOptions

_COLOURS = ("C3", "C4", "C5")  # by sigma_b; C0 to C2 are the trackers'
_SO3: dict[str, Any] = {"linestyle": "-.", "linewidth": 1.2, "color": "C2"}


def section(request: Request, results: Results) -> Section:
    """Tables 14 to 18, and why they differ."""
    r1_, s1, far26 = results.get("r1"), results.get("s1"), results.get("far26")
    films = {"S1, ours": s1, "far26": far26} if request.datasets is not None else {"S1, ours": s1}
    parts: list[str | Table | Figure] = [
        "How much acceleration the filter reckons with (σ_w), and how much noise in the centre of a disc (σ_b). Every "
        "cell is `ekf2` with the centres of our detector and the camera's pose found from the film; σ_b is the same "
        "for all discs, as in the thesis. `so3` has no such parameters: it estimates the noise of every centre, and "
        "how lively the player is. The film like R1 is ours (R1 itself is not available): 32 discs, a player at "
        f"{r1.PACE:g} of the pace of our usual one, hands, noise of {r1.OPTIONS['noise']:g} grey values, 10 ms of "
        "exposure, the thesis' lens; its reference is the log of a simulated trackball with uneven reports, an unknown "
        f"lag and an unknown scale (eq. 175). {_films(films)}"
    ]
    if request.datasets is None:
        parts.append("The reference recording far26 was not at hand: its columns are left out.")
    parts.append(_table("Correlation with the trackball, R1 (table 14)", R_R1, {"R1-like": r1_}, ("trackball", "r"), 3))
    if _good(r1_):
        parts += [said for said in (_said_of_r1(r1_),) if said]
        parts.append(_figure_r1(r1_))
    titles = {
        "r": ("Correlation of mouse speeds, S1 (table 15)", R_S1, 4),
        "attitude": ("RMSE of the attitude, °, S1 (table 16)", ATTITUDE, 4),
        "rate": ("RMSE of the rates, °/s, S1 (table 17)", RATE, 2),
        "speed": ("RMSE of the mouse speed, thesis in its px/s, ours in mm/s, S1 (table 18)", SPEED, 2),
    }
    for name, (title, thesis, digits) in titles.items():
        parts.append(_table(title, thesis, films, PATHS[name], digits))
    if _good(s1):
        parts += [said for said in (_said_of_s1(s1),) if said]
        parts.append(_figure_s1(s1))
        both = {name: result for name, result in films.items() if _good(result)}
        for name, title, thesis in (("attitude", "attitude, °", ATTITUDE), ("rate", "rates, °/s", RATE)):
            parts.append(_exact_table(title, thesis, both, PATHS[name], 2))
        parts += [_said_of_exact(both), _figure_exact(*list(both.items())[-1])]
    known = {name: r for name, r in films.items() if _good(r) and r["published"]}
    if known:
        parts += [_published_table(known), _said_of_published(known)]
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(parts), dict(results))


def _films(films: dict[str, Result | None]) -> str:
    """How long they are, and that they have no noise."""
    frames = {name: r["so3"].get("frames") for name, r in films.items() if _good(r)}
    told = ", ".join(f"{name} {n} frames" for name, n in frames.items() if n)
    noise = SimulationOptions().noise
    return f"Without noise: {told}; the thesis' S1 has 300 frames." if told and not noise else ""


def _good(result: Result | None) -> TypeGuard[Result]:
    return result is not None and "error" not in result


def _table(title: str, thesis: Grid, films: dict[str, Result | None], path: tuple[str, ...], digits: int) -> Table:
    names = ("thesis", *films)
    head = ("σ_w, rad/s²", *(f"σ_b {b:g} px: {name}" for b in SIGMA_B for name in names))
    rows = []
    for i, w in enumerate((*SIGMA_W, BEYOND)):
        row = [f"{w:g}"]
        for j, b in enumerate(SIGMA_B):
            row.append(f"{thesis[i][j]:.{min(digits, _printed(thesis))}f}" if i < len(SIGMA_W) else "–")
            row += [value(_cell(result, w, b), *path, digits=digits) for result in films.values()]
        rows.append(tuple(row))
    line = ["`so3`"]
    for _ in SIGMA_B:
        line.append("")
        line += [value(_part(result, "so3"), *path, digits=digits) for result in films.values()]
    rows.append(tuple(line))
    return Table(head, tuple(rows), title)


def _printed(grid: Grid) -> int:
    """Decimals of a table of the thesis."""
    return max(len(f"{x:g}".partition(".")[2]) for row in grid for x in row)


def _cell(result: Result | None, w: float, b: float) -> Result | None:
    cells = _part(result, "cells")
    return cells if cells is None or "error" in cells else cells.get(key_of(w, b))


def _part(result: Result | None, name: str) -> Result | None:
    return result if result is None or "error" in result else result[name]


def _exact_table(title: str, thesis: Grid, films: dict[str, Result], path: tuple[str, ...], digits: int) -> Table:
    rows = []
    for i, w in enumerate(SIGMA_W):
        row = [f"{w:g}"]
        for j, b in enumerate(SIGMA_B):
            row.append(f"{thesis[i][j]:.{_printed(thesis)}f}")
            row += [value(result["exact"][key_of(w, b)], *path, digits=digits) for result in films.values()]
        rows.append(tuple(row))
    head = ("σ_w, rad/s²", *(f"σ_b {b:g} px: {name}" for b in SIGMA_B for name in ("thesis", *films)))
    return Table(
        head, tuple(rows), f"RMSE of the {title}, `ekf2` with an exact ball (euler.radial_sigma = {EXACT:g} m)"
    )


def _said_of_exact(films: dict[str, Result]) -> str:
    said, nearer, steadier = [], [], []
    for name, result in films.items():
        exact, ours = result["exact"], result["cells"]
        off = {what: (_off(exact, what), _off(ours, what)) for what in ("rate", "attitude")}
        by_pixels = [
            statistics.median(
                max(g) / min(g) for g in _grouped(_shared(_numbers(cells, *PATHS["rate"])), by_acceleration)
            )
            for cells in (exact, ours)
            if _numbers(cells, *PATHS["rate"])
        ]
        nearer += [statistics.median(a) < statistics.median(b) for a, b in off.values() if a and b]
        told = [
            f"{what}s {statistics.median(a):.2f} ({max(a):.{0 if max(a) > 10.0 else 1}f} at most; with our radius "
            f"{statistics.median(b):.2f})"
            for what, (a, b) in off.items()
            if a and b
        ]
        lost = sum(cell["lost_episodes"] > 0 for cell in exact.values())
        if len(by_pixels) == 2:
            steadier.append(by_pixels[0] < by_pixels[1])
            told.append(
                f"at the same σ_w, σ_b changes rates {by_pixels[0]:.1f}-fold (with ours {by_pixels[1]:.1f}-fold)"
            )
        said.append(f"{name}: {', '.join(told)}; the ball gets lost in {lost} of 12 cells")
    why = (
        " The least mismatch along the radius, which tells of the attitude in second order alone, then outweighs the "
        "pixels: σ_b matters less, and the filter follows at a small σ_w."
        if steadier and all(steadier)
        else ""
    )
    return (
        "In a scene that was modelled the ball is exact, and a point on it (eq. 120) then has no variance along the "
        f"radius. Our `ekf2` gives it {1e3 * _usual_radial():g} mm. With {1e3 * EXACT:g} mm (chosen beforehand, on "
        "our S1, among powers of ten) "
        f"{'we come nearer to the thesis' if nearer and all(nearer) else 'we are off the thesis'}. The factor between "
        f"ours and the thesis', median of the cells: {'; '.join(said)}.{why} What the thesis took is not written "
        "there. In R1 the ball has a covariance (table 11), and there σ_b does matter."
    )


def _off(cells: Result, what: str) -> list[float]:
    """Factors between our errors and the thesis', cell by cell."""
    ours, theirs = _numbers(cells, *PATHS[what]), _typed({"rate": RATE, "attitude": ATTITUDE}[what])
    return [max(ours[k] / x, x / ours[k]) for k, x in theirs.items() if ours.get(k)]


def _usual_radial() -> float:
    return settings_of().euler.radial_sigma


def _published_table(films: dict[str, Result]) -> Table:
    rows = []
    for i, w in enumerate((*SIGMA_W, BEYOND)):
        row = [f"{w:g}", f"{RATE[i][0]:.2f}" if i < len(SIGMA_W) else "–"]
        for result in films.values():
            row += [
                value(_cell(result, w, SIGMA_B[0]), *PATHS["rate"]),
                value(result["published"][f"{w:g}"], *PATHS["rate"]),
            ]
        rows.append(tuple(row))
    detectors = ("our detector", "published detector")
    head = ("σ_w, rad/s²", "thesis", *(f"{name}: {d}" for name in films for d in detectors))
    title = f"RMSE of the rates, °/s, with our detector and the published one, σ_b = {SIGMA_B[0]:g} px"
    return Table(head, tuple(rows), title)


def _said_of_published(films: dict[str, Result]) -> str:
    said, trust = [], []
    for name, result in films.items():
        cells = {w: result["published"][f"{w:g}"] for w in (*SIGMA_W, BEYOND)}
        theirs, ours = _best(cells), _best({w: _cell(result, w, SIGMA_B[0]) or {} for w in cells})
        if theirs is None or ours is None:
            said.append(f"{name}: {'the published detector' if theirs is None else 'ours'} tracks nothing")
            continue
        with_theirs, with_ours = cells[theirs], _cell(result, ours, SIGMA_B[0])
        trust.append(ours > theirs)
        said.append(
            f"{name}: best at σ_w = {theirs:g}, with centres good to {value(with_theirs, 'detection', 'centre_rms_px')}"
            f" px and {value(with_theirs, 'mean_discs', digits=1)} discs per frame used (ours: at {ours:g}, "
            f"{value(with_ours, 'detection', 'centre_rms_px')} px, {value(with_ours, 'mean_discs', digits=1)} discs)"
        )
    return (
        f"With the published detector, {'; '.join(said)}. The thesis, with that detector: best at σ_w = 0.1, 4.9 discs "
        "stored."
        + (" The better the centres, the more a filter gains by trusting them." if trust and all(trust) else "")
    )


def _best(cells: dict[float, Result]) -> float | None:
    """The sigma_w with the smallest rate error."""
    rates = {w: cell.get("rate_rmse_deg_s", {}).get("combined") for w, cell in cells.items()}
    known = {w: x for w, x in rates.items() if x is not None}
    return min(known, key=lambda w: known[w]) if known else None


def _numbers(cells: Result, *path: str) -> dict[tuple[float, float], float]:
    """A quantity by (sigma_w, sigma_b), of the cells that have it."""
    found = {}
    for key, cell in cells.items():
        x: Any = cell
        for name in path:
            x = x.get(name) if isinstance(x, dict) else None
        if x is not None:
            w, b = map(float, key.split("/"))
            found[w, b] = float(x)
    return found


def _typed(grid: Grid) -> dict[tuple[float, float], float]:
    return {(w, b): grid[i][j] for i, w in enumerate(SIGMA_W) for j, b in enumerate(SIGMA_B)}


def spread(values: dict[tuple[float, float], float], group: Any) -> float:
    """Largest over smallest value within a group of cells, at worst."""
    return max((max(g) / min(g) for g in _grouped(values, group) if min(g) > 0.0), default=1.0)


def apart(values: dict[tuple[float, float], float], group: Any) -> float:
    """Largest less smallest value within a group of cells, at worst."""
    return max((max(g) - min(g) for g in _grouped(values, group)), default=0.0)


def _grouped(values: dict[tuple[float, float], float], group: Any) -> list[list[float]]:
    groups: dict[Any, list[float]] = {}
    for (w, b), x in values.items():
        groups.setdefault(group(w, b), []).append(x)
    return list(groups.values())


def by_ratio(w: float, b: float) -> str:
    """Cells in which the filter weighs alike what it expects and what it sees."""
    return f"{w / b:.3g}"


def by_acceleration(w: float, b: float) -> str:
    """Cells with the same sigma_w."""
    return f"{w:g}"


def _shared(values: dict[tuple[float, float], float]) -> dict[tuple[float, float], float]:
    """The cells that the thesis has as well."""
    return {k: v for k, v in values.items() if k[0] in SIGMA_W}


def _said_of_r1(result: Result) -> str:
    r = _numbers(result["cells"], "trackball", "r")
    lost = _numbers(result["cells"], "lost_episodes")
    weak = sum(n >= 5 for n in _shared(lost).values())
    true, so3 = result["truth"]["trackball"].get("r"), result["so3"]["trackball"].get("r")
    said = []
    if r:
        w, b = max(r, key=lambda k: r[k])
        said.append(f"Best of ours: {r[w, b]:.3f} at σ_w = {w:g} rad/s², σ_b = {b:g} px (thesis: 0.962 at 0.1, 0.1).")
    if true is not None:
        said.append(f"The true motion agrees with the log by {true:.3f}: a tracker can hardly agree better.")
    if so3 is not None:
        said.append(f"`so3` reaches {so3:.3f}.")
    if weak:
        said.append(
            f"In {weak} of the 12 cells `ekf2` loses the ball five times or more: it follows so slowly that discs "
            "leave the gate of 30 mm."
        )
    said.append(
        "The thesis' correlations on R1 go by σ_w/σ_b: cells that have it in common differ by at most "
        f"{apart(_typed(R_R1), by_ratio):.2f}, cells with the same σ_w by up to "
        f"{apart(_typed(R_R1), by_acceleration):.2f}."
    )
    return " ".join(said)


def _said_of_s1(result: Result) -> str:
    rate, attitude = (_shared(_numbers(result["cells"], *PATHS[name])) for name in ("rate", "attitude"))
    if not rate or not attitude:
        return ""
    scaled = _numbers(result["scaled"], *PATHS["rate"])
    lost = sum(n > 0 for n in _shared(_numbers(result["cells"], "lost_episodes")).values())
    theirs = _typed(RATE)
    ratio, same = (
        {k: spread(v, by) for k, v in (("rate", rate), ("attitude", attitude))} for by in (by_ratio, by_acceleration)
    )
    what = "Our rates go by σ_w/σ_b" if ratio["rate"] < same["rate"] else "Our rates do not go by σ_w/σ_b alone"
    best_rate, best_attitude = min(rate, key=lambda k: rate[k]), min(attitude, key=lambda k: attitude[k])
    return (
        f"{what}, how the filter weighs what it expects against what it sees: in cells with the same σ_w/σ_b they "
        f"differ by a factor of {ratio['rate']:.1f} at most, in cells with the same σ_w by up to {same['rate']:.0f}; "
        f"attitudes by {ratio['attitude']:.1f} and {same['attitude']:.0f}. (If all that the filter assumes grows with "
        f"σ_b, equal ratios agree within {spread(scaled, by_ratio):.2f}.) A small ratio makes a filter that follows "
        f"late; in {lost} of the 12 cells the ball gets lost. The thesis' rates on S1 do the reverse, "
        f"{spread(theirs, by_ratio):.1f} and {spread(theirs, by_acceleration):.1f}: σ_b has little effect. What may be "
        "the reason is tried below. Among the 12 cells our rates are best at "
        f"σ_w = {best_rate[0]:g}, σ_b = {best_rate[1]:g} ({rate[best_rate]:.2f} °/s; thesis: 1.09 at 0.1, 0.1), the "
        f"attitude at {best_attitude[0]:g}, {best_attitude[1]:g} ({attitude[best_attitude]:.3f}°; thesis: 0.11 at 1, "
        f"0.1). `so3`: {value(result['so3'], *PATHS['rate'])} °/s and "
        f"{value(result['so3'], *PATHS['attitude'], digits=3)}°."
    )


_PANELS = {
    "attitude": ("attitude_deg", "attitude RMSE, °", ATTITUDE),
    "rate": ("rate_deg_s", "rate RMSE, °/s", RATE),
}


def _draw_errors(canvas: Any, result: Result, cells: str, ratio: bool = True) -> Any:
    """Errors of attitude and rate side by side, ours and the thesis', with the bound; their axes."""
    axes = canvas.subplots(1, 2)
    for ax, (name, (limit, label, thesis)) in zip(axes, _PANELS.items(), strict=True):
        _draw_cells(ax, _numbers(result[cells], *PATHS[name]), _typed(thesis), ratio=ratio)
        ax.set(yscale="log", ylabel=label)
        plain_numbers(ax.yaxis)
        if result["bound"] is not None:
            least, so3 = result["bound"][limit]["combined"], result["so3"][PATHS[name][0]]["combined"]
            lower = cells == "cells" and so3 is not None and least < so3
            _level(ax, least, "Cramér-Rao bound", BOUND, side="right", below=lower)
    _legend(canvas, axes[0])
    return axes


def _figure_s1(result: Result) -> Figure:
    def draw(canvas: Any) -> None:
        for ax, name in zip(_draw_errors(canvas, result, "cells"), _PANELS, strict=True):
            so3, least = result["so3"][PATHS[name][0]]["combined"], result["bound"]
            higher = least is not None and so3 is not None and so3 <= least[_PANELS[name][0]]["combined"]
            _level(ax, so3, "so3", _SO3, below=higher)

    caption = (
        "`ekf2` on our S1 (dots) and in the thesis (squares): errors against σ_w/σ_b. The bound is for the "
        "centres that `so3` measured."
    )
    return Figure("parameters-s1", caption, draw, (7.2, 3.7))


def _figure_exact(film: str, result: Result) -> Figure:
    def draw(canvas: Any) -> None:
        _draw_errors(canvas, result, "exact", ratio=False)

    return Figure(
        "parameters-exact",
        f"`ekf2` with a ball taken as exact, on {film} (dots), and the thesis (squares): errors against σ_w.",
        draw,
        (7.2, 3.7),
    )


def _figure_r1(result: Result) -> Figure:
    def draw(canvas: Any) -> None:
        ax = canvas.subplots()
        _draw_cells(ax, _lacking(_numbers(result["cells"], "trackball", "r")), _lacking(_typed(R_R1)))
        ax.set(ylabel="1 - correlation with the trackball", yscale="log")
        plain_numbers(ax.yaxis)
        true, so3 = result["truth"]["trackball"].get("r"), result["so3"]["trackball"].get("r")
        same = true is not None and so3 is not None and abs(true - so3) < 0.05 * (1.0 - true)
        _level(ax, None if true is None else 1.0 - true, "true motion, and so3" if same else "true motion", BOUND)
        if not same:
            _level(ax, None if so3 is None else 1.0 - so3, "so3", _SO3, side="right")
        _legend(canvas, ax)

    return Figure(
        "parameters-r1",
        "`ekf2` on the film like R1 (dots) and on R1 in the thesis (squares): what correlation with the trackball's "
        "log lacks to 1, against σ_w/σ_b. The dotted line is how well the true motion agrees with the log.",
        draw,
        (7.2, 3.4),
    )


def _lacking(values: dict[tuple[float, float], float]) -> dict[tuple[float, float], float]:
    """What correlations lack to 1."""
    return {k: 1.0 - r for k, r in values.items()}


def _draw_cells(
    ax: Any, ours: dict[tuple[float, float], float], thesis: dict[tuple[float, float], float], ratio: bool = True
) -> None:
    for k, b in enumerate(SIGMA_B):
        x, y = _line(ours, b, b if ratio else 1.0)
        ax.plot(x, y, color=_COLOURS[k], linestyle="-", marker="o")
        x, y = _line(thesis, b, b if ratio else 1.0)
        ax.plot(x, y, color=_COLOURS[k], marker="s", markerfacecolor="none", **THESIS)
    label = r"$\sigma_w/\sigma_b$, rad/s² per px" if ratio else r"$\sigma_w$, rad/s²"
    ax.set(xscale="log", xlabel=label)


def _line(values: dict[tuple[float, float], float], b: float, unit: float) -> tuple[list[float], list[float]]:
    chosen = sorted((w / unit, x) for (w, c), x in values.items() if c == b)
    return [x for x, _ in chosen], [y for _, y in chosen]


def _level(ax: Any, y: float | None, name: str, how: dict[str, Any], side: str = "left", below: bool = False) -> None:
    """A line all across, with its name."""
    if y is not None:
        ax.axhline(y, **{"color": "0.5", **how})
        place = (0.99 if side == "right" else 0.01, y)
        va = "top" if below else "bottom"
        ax.annotate(name, place, xycoords=("axes fraction", "data"), va=va, ha=side, fontsize=8)
        if below:
            ax.set_ylim(bottom=min(ax.get_ylim()[0], 0.6 * y))


def _legend(canvas: Any, ax: Any) -> None:
    handles = [
        ax.plot([], [], color=_COLOURS[k], marker="o", linestyle="-", label=rf"$\sigma_b$ = {b:g} px")[0]
        for k, b in enumerate(SIGMA_B)
    ]
    handles.append(ax.plot([], [], color="0.5", marker="o", linestyle="-", label="ekf2")[0])
    handles.append(ax.plot([], [], color="0.5", marker="s", markerfacecolor="none", label="thesis", **THESIS)[0])
    canvas.legend(handles=handles, loc="outside upper center", ncols=5)
