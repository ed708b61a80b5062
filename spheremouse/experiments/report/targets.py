"""What the experiments on the frame's targets are said to show: tables, figures and sentences."""

from typing import Any

import numpy as np

from spheremouse.ball.pose import PoseSettings
from spheremouse.ball.rig import CODES
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.report.page import failures
from spheremouse.experiments.report.plot import BOUND, THESIS, decades
from spheremouse.experiments.targets import (
    ABOUT,
    CONDITIONS,
    FAMILIES,
    KINDS,
    MATCH,
    NEARLY,
    NUMBER,
    REFINED,
    REFINEMENTS,
    STRAY,
    SURE,
    USUAL,
    key,
)


def section(request: Request, results: Results) -> Section:
    """Number, size and kind: figures, tables, and what to put up."""
    cameras = [r for r in results.values() if "error" not in r]
    some = f"{len(cameras)} camera{'s' if len(cameras) != 1 else ''}"
    some += f" ({len(results) - len(cameras)} more failed)" if len(results) > len(cameras) else ""
    parts: list[str | Table | Figure] = [
        f"{some} near the thesis' far one (640x480), turned about their axes by up to "
        f"{np.degrees(STRAY[2]):.0f}°; targets known exactly; {CONDITIONS['plain'].views} views each, noise of "
        f"{CONDITIONS['plain'].noise:g} grey values unless it says otherwise. A tag is as large as a ring target: its "
        "side is the outer diameter. Tags are found by OpenCV, their corners refined by it "
        f"({' or '.join(REFINED)}: whichever finds more of them). Errors are lengths of error vectors, RMS over "
        "the cameras that had a pose (*poses*); of centres and corners those within "
        f"{MATCH:g} px of a true one."
    ]
    if cameras:
        numbers, sizes = _tried_of(cameras, "numbers"), _tried_of(cameras, "sizes")
        scale = float(np.mean([c["px_per_mm"] for c in cameras]))
        parts += ["### Number", _said_of_numbers(cameras, numbers)]
        if len(numbers) > 1:
            parts.append(_figure_numbers(cameras, numbers))
        parts += [
            _table_of_poses("targets", cameras, "numbers", {str(n): (n, USUAL, "plain") for n in numbers}),
            "### Size and kind",
            _said_of_sizes(cameras, sizes, scale),
        ]
        if len(sizes) > 1:
            parts.append(_figure_sizes(cameras, sizes, scale))
        parts += [
            _table_of_sizes(cameras, sizes, scale),
            _table_of_poses("condition", cameras, "sizes", _conditions(cameras)),
            _table_of_refinements(cameras),
        ]
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(p for p in parts if p), dict(results))


def _tried_of(cameras: list[Result], group: str) -> list[int]:
    """Numbers or sizes that were tried, rising."""
    place = 1 if group == "numbers" else 2
    return sorted({int(float(k.split("/")[place])) for c in cameras for k in c[group]})


def _conditions(cameras: list[Result]) -> dict[str, tuple[int, float, str]]:
    tried = {k.split("/")[3] for c in cameras for k in c["sizes"]}
    return {ABOUT[c]: (NUMBER, USUAL, c) for c in CONDITIONS if c in tried}


def _entries(cameras: list[Result], group: str, kind: str, case: tuple[int, float, str]) -> list[Result]:
    name = key(kind, *case)
    return [c[group][name] for c in cameras if name in c[group]]


def _rms(entries: list[Result], name: str) -> float | None:
    """Of the lengths of vectors, over the cameras with a pose."""
    known = [np.linalg.norm(e[name]) for e in entries if name in e]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _bound(entries: list[Result]) -> float | None:
    """mm, RMS: what the best adjustment reaches with centres or corners as noisy as these were.

    The claimed standard deviation, which follows the residuals where these are larger than what is allowed for, scaled
    to the measured error where that is smaller.
    """
    allowed = PoseSettings().target_sigma
    known = [e for e in entries if "sigma_position_mm" in e and e["point_px"] is not None]
    least = [min(1.0, e["point_px"] / allowed) * np.linalg.norm(e["sigma_position_mm"]) for e in known]
    return float(np.sqrt(np.mean(np.square(least)))) if least else None


def _share(entries: list[Result]) -> float | None:
    """Of the targets found."""
    return float(np.mean([e["found"] for e in entries])) if entries else None


def _text(number: float | None, digits: int) -> str:
    return "–" if number is None else f"{number:.{digits}f}"


def _table_of_poses(first: str, cameras: list[Result], group: str, cases: dict[str, tuple[int, float, str]]) -> Table:
    rows = []
    for name, case in cases.items():
        for kind, word in KINDS.items():
            entries = _entries(cameras, group, kind, case)
            if not entries:
                rows.append((name, word, f"no: there are {len(CODES)} orders of three colours", *[""] * 7))
                continue
            share = _share(entries)
            points = [e["point_px"] for e in entries if e["point_px"] is not None]
            rows.append(
                (
                    name,
                    word,
                    _text(None if share is None else 100.0 * share, 0) + " %",
                    f"{sum('error' not in e for e in entries)} of {len(entries)}",
                    _text(float(np.sqrt(np.mean(np.square(points)))) if points else None, 3),
                    _text(_rms(entries, "position_mm"), 2),
                    _text(_rms(entries, "sigma_position_mm"), 2),
                    _text(_bound(entries), 2),
                    _text(_rms(entries, "angle_deg"), 3),
                    _text(_rms(entries, "sigma_angle_deg"), 3),
                )
            )
    head = (
        *(first, "kind", "found", "poses", "centres or corners, px"),
        *("position, mm", "claimed, mm", "bound, mm", "angle, °", "claimed, °"),
    )
    return Table(head, tuple(rows))


def _least(cameras: list[Result], kind: str, condition: str, sizes: list[int]) -> int | None:
    """mm, the smallest size from which on all targets are found."""
    least = None
    for size in reversed(sizes):
        share = _share(_entries(cameras, "sizes", kind, (NUMBER, size, condition)))
        if share is None or share < SURE:
            break
        least = size
    return least


def _table_of_sizes(cameras: list[Result], sizes: list[int], scale: float) -> Table:
    rows = []
    for condition in CONDITIONS:
        if not _entries(cameras, "sizes", "rings", (NUMBER, sizes[-1], condition)):
            continue
        cells = []
        for kind in ("rings", *FAMILIES):
            least = _least(cameras, kind, condition, sizes)
            cells.append("none of these" if least is None else f"{scale * least:.0f} px ({least} mm)")
        rows.append((ABOUT[condition], *cells))
    head = ("", *(KINDS[k] for k in ("rings", *FAMILIES)))
    title = f"Least size across at which {100.0 * SURE:.0f} % are found (outer radius in brackets)"
    return Table(head, tuple(rows), title)


def _table_of_refinements(cameras: list[Result]) -> Table:
    rows = []
    for name in REFINEMENTS:
        found = [c["refinements"][name] for c in cameras]
        errors = np.concatenate([np.array(f["errors"]).reshape(-1, 2) for f in found])
        cells = ["–"] * 3
        if len(errors):
            cells = [f"{np.sqrt(np.mean(errors**2)):.3f}", *(f"{x:+.3f}" for x in errors.mean(axis=0))]
        rows.append((name, f"{100.0 * np.mean([f['found'] for f in found]):.0f} %", *cells))
    head = ("refinement", "found", "corner RMS per axis, px", "mean error u, px", "mean error v, px")
    title = (
        f"Corners of ArUco tags of {USUAL} mm by OpenCV's refinements; half a pixel was taken off AprilTag's, which "
        "count from the corner of a pixel"
    )
    return Table(head, tuple(rows), title)


def _said_of_numbers(cameras: list[Result], numbers: list[int]) -> str:
    said = []
    for kind in ("rings", *FAMILIES):
        errors = {n: _rms(_entries(cameras, "numbers", kind, (n, USUAL, "plain")), "position_mm") for n in numbers}
        known = {n: e for n, e in errors.items() if e is not None}
        if len(known) > 1:
            low, high = min(known), max(known)
            said.append(f"{KINDS[kind]} {known[low]:.2f} mm with {low}, {known[high]:.2f} mm with {high}")
    text = f"Error of the camera's position: {'; '.join(said)}." if said else ""
    three = _entries(cameras, "numbers", "rings", (3, USUAL, "plain"))
    if three:
        posed = sum("error" not in e for e in three)
        text += f" Three rings give a pose from {posed} of {len(three)} cameras."
    sigmas = {n: _rms(_entries(cameras, "numbers", "rings", (n, USUAL, "plain")), "sigma_position_mm") for n in numbers}
    claimed = {n: sigma for n, sigma in sigmas.items() if sigma is not None}
    if len(claimed) > 1:
        best = min(claimed.values())
        advised = min(n for n, sigma in claimed.items() if sigma <= NEARLY * best)
        said = [f"{sigma:.2f} mm with {n}" for n, sigma in claimed.items()]
        text += (
            f" The claimed standard deviation of rings: {', '.join(said)}. Advice: {advised} targets, which are within "
            f"{100.0 * (NEARLY - 1.0):.0f} % of the best; with one more, one may be hidden."
        )
    return text


def _said_of_sizes(cameras: list[Result], sizes: list[int], scale: float) -> str:
    said = []
    usual = (NUMBER, USUAL, "plain")
    rings = _rms(_entries(cameras, "sizes", "rings", usual), "position_mm")
    for kind, word in KINDS.items():
        other = _rms(_entries(cameras, "sizes", kind, usual), "position_mm")
        if rings and other and kind != "rings":
            said.append(f"{word} {other / rings:.1f} times")
    text = (
        f"With {NUMBER} of {USUAL} mm ({scale * USUAL:.0f} px across) the position error of the rings is "
        f"{rings:.2f} mm; {', '.join(said)} that. "
        if rings and said
        else ""
    )
    least = {k: _least(cameras, k, "plain", sizes) for k in ("rings", *FAMILIES)}
    named = [f"{KINDS[k]} from {scale * v:.0f} px across" for k, v in least.items() if v is not None]
    if named:
        text += f"All are found: {', '.join(named)}. "
    tried = [c for c in CONDITIONS if _entries(cameras, "sizes", "rings", (NUMBER, sizes[-1], c))]
    hard = {c: _least(cameras, "rings", c, sizes) for c in tried}
    enough, bad = [v for v in hard.values() if v is not None], [c for c, v in hard.items() if v is None]
    if enough:
        text += (
            f"Advice: rings at least {scale * max(enough):.0f} px across in the picture"
            f"{', enough under all conditions tried' if len(tried) > 1 and not bad else ''}. "
        )
    for condition in bad:
        found = {k: _least(cameras, k, condition, sizes) for k in FAMILIES}
        others = [f"{KINDS[k]} from {scale * v:.0f} px" for k, v in found.items() if v is not None]
        text += (
            f"No size tried is enough for rings under {ABOUT[condition]} (tags are found: "
            f"{', '.join(others) or 'none'}): mind the light. "
        )
    claimed = _rms(_entries(cameras, "sizes", "rings", usual), "sigma_position_mm")
    if rings and claimed:
        text += (
            f"The rings' claimed standard deviation is {claimed / rings:.0f} times their error: it allows "
            f"{PoseSettings().target_sigma:g} px per centre for print and lens, which a painted target has not."
        )
    return text.strip()


_MARKS = dict(zip(KINDS, "osD^", strict=True))


def _line(ax: Any, x: list[float], entries: list[list[Result]], kind: str, k: int) -> None:
    """Position error with its claim (dashed) and its bound (dotted)."""
    lines = (
        ([_rms(e, "position_mm") for e in entries], {"marker": _MARKS[kind]}),
        ([_rms(e, "sigma_position_mm") for e in entries], {**THESIS, "linewidth": 0.7}),
        ([_bound(e) for e in entries], BOUND),
    )
    for values, how in lines:
        points = zip(x, values, strict=True)
        known = [(a, y) for a, y in points if y is not None]
        style = {"linestyle": "-", **how}
        ax.plot([a for a, _ in known], [y for _, y in known], color=f"C{k}", **style)
    for a, here in zip(x, entries, strict=True):
        y = _rms(here, "position_mm")
        if y is not None and any("error" in e for e in here):  # white inside: not the same cameras
            ax.plot([a], [y], color=f"C{k}", marker=_MARKS[kind], markerfacecolor=ax.get_facecolor(), linestyle="")


def _finish(ax: Any) -> None:
    ax.set_yscale("log")
    decades(ax.yaxis)


def _handles(claimed: bool = True) -> list[Any]:
    from matplotlib.lines import Line2D

    lines = [
        Line2D([], [], color=f"C{k}", marker=_MARKS[kind], linestyle="-", label=name)
        for k, (kind, name) in enumerate(KINDS.items())
    ]
    grey = [Line2D([], [], color="0.5", label=name, **how) for name, how in (("claimed", THESIS), ("bound", BOUND))]
    return [*lines, *(grey if claimed else [])]


def _figure_numbers(cameras: list[Result], numbers: list[int]) -> Figure:
    def draw(canvas: Any) -> None:
        ax = canvas.subplots()
        for k, kind in enumerate(KINDS):
            entries = [_entries(cameras, "numbers", kind, (n, USUAL, "plain")) for n in numbers]
            _line(ax, [float(n) for n in numbers], entries, kind, k)
        _finish(ax)
        ax.set(xlabel="targets", ylabel="position of the camera, mm", xticks=numbers)
        canvas.legend(handles=_handles(), loc="outside upper center", ncols=6)

    return Figure(
        "targets-number",
        "Error of the camera's position (RMS over cameras) against the number of targets, its claimed standard "
        f"deviation (dashed), and the bound with centres as good as they were (dotted). Hollow: not all cameras had a "
        "pose. "
        f"Rings end at {len(CODES)}: there are no more orders of three colours.",
        draw,
        (7.2, 3.3),
    )


def _figure_sizes(cameras: list[Result], sizes: list[int], scale: float) -> Figure:
    def draw(canvas: Any) -> None:
        left, right = canvas.subplots(1, 2)
        across = [scale * s for s in sizes]
        for k, kind in enumerate(KINDS):
            entries = [_entries(cameras, "sizes", kind, (NUMBER, s, "plain")) for s in sizes]
            _line(left, across, entries, kind, k)
            if kind.endswith("centres"):
                continue
            shares = [100.0 * (_share(e) or 0.0) for e in entries]
            right.plot(across, shares, color=f"C{k}", marker=_MARKS[kind], linestyle="-")
        _finish(left)
        for ax in (left, right):
            ax.set(xscale="log", xlabel="target across, px")
            ax.set_xticks(across, [f"{x:.0f}" for x in across])
            ax.minorticks_off()
        left.set_ylabel("position of the camera, mm")
        right.set_ylabel("found, %")
        canvas.legend(handles=_handles(), loc="outside upper center", ncols=6)

    return Figure(
        "targets-size",
        f"Left: error of the camera's position from {NUMBER} targets against their size in the picture, its claimed "
        "standard deviation (dashed), and the bound with centres as good as they were (dotted); hollow: not all "
        "cameras had a pose. Right: share of the targets that is found.",
        draw,
        (7.2, 3.5),
    )
