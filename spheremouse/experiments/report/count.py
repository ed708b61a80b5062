"""What the experiments on the number of discs are said to show: tables, figures and sentences."""

from collections import Counter
from typing import Any

import numpy as np

from spheremouse.experiments.count import ATTITUDE, FAR_OFF, LAYOUTS, RATE, STORED, key_of
from spheremouse.experiments.kit.film import TRACKERS
from spheremouse.experiments.kit.job import Figure, Request, Result, Results, Section, Table
from spheremouse.experiments.report.page import failures, value
from spheremouse.experiments.report.plot import BOUND, THESIS, plain_numbers
from spheremouse.simulate.ball.film import SimulationOptions

_THESIS_FRAMES = 300
_MARKS = "osD"  # of the trackers


def section(request: Request, results: Results) -> Section:
    """Table 20, and errors against the number of discs."""
    balls = _by_count(results)
    parts: list[str | Table | Figure] = [
        f"The far camera, the thesis' motion{_length(balls)}, {_noise()}, the camera's "
        "pose found from the film; balls with other numbers of discs. Table 20 is compared with the first "
        "layout (places of the discs), in the axes of the device; what follows is the RMS over "
        f"{_layouts(balls)}.",
        _table_20(results),
    ]
    both = _both(balls)
    if both:
        parts.append(both)
    few = _too_few(balls)
    if few:
        parts.append(few)
    if len(balls) > 1:
        parts.append(_figure(balls))
    if balls:
        parts.append(_all_table(balls, _failed_of(results)))
    failed = failures(results)
    if failed:
        parts.append("Failed:\n\n" + "\n".join(failed))
    return Section(tuple(parts), dict(results))


def _by_count(results: Results) -> dict[int, list[Result]]:
    """What is there, by the number of discs."""
    found: dict[int, list[Result]] = {}
    for key, result in results.items():
        if "error" not in result:
            found.setdefault(int(key.split("-")[0]), []).append(result)
    return dict(sorted(found.items()))


def _failed_of(results: Results) -> dict[int, int]:
    """How many films failed, by the number of discs."""
    return dict(Counter(int(key.split("-")[0]) for key, result in results.items() if "error" in result))


def _layouts(balls: dict[int, list[Result]]) -> str:
    most = max((len(found) for found in balls.values()), default=0)
    return "the only layout" if most == 1 else f"up to {most} layouts each"


def _noise() -> str:
    noise = SimulationOptions().noise
    return f"noise of {noise:g} grey values" if noise else "without noise"


def _length(balls: dict[int, list[Result]]) -> str:
    """How long the films are, beside the thesis'."""
    frames = {b["rows"]["so3"].get("frames") for found in balls.values() for b in found} - {None}
    return f" (films of {max(frames)} frames; the thesis' have {_THESIS_FRAMES})" if frames else ""


def _table_20(results: Results) -> Table:
    rows = []
    for n, stored in STORED.items():
        typed = (*ATTITUDE[n], *RATE[n])
        rows.append((str(n), "thesis, EKF2", f"{stored:.1f}", *(f"{x:.3f}" for x in typed)))
        result = results.get(key_of(n, LAYOUTS[0]))
        for who in TRACKERS:
            row = result if result is None or "error" in result else result["rows"][who]
            attitude = (value(row, "attitude_rmse_deg", axis, digits=4) for axis in "xyz")
            rate = (value(row, "rate_rmse_deg_s", axis, digits=3) for axis in "xyz")
            rows.append(("", f"`{who}`", value(row, "mean_discs", digits=1), *attitude, *rate))
    head = (
        *("discs", "filter", "used per frame (thesis: stored)"),
        *(f"attitude {axis}, °" for axis in "xyz"),
        *(f"rate {axis}, °/s" for axis in "xyz"),
    )
    return Table(head, tuple(rows), "RMSE per axis (table 20)")


def _rms(balls: list[Result], who: str, quantity: str) -> float | None:
    """Of the combined errors over the layouts; None where one of them has none."""
    if who == "bound":
        values = [None if ball["bound"] is None else ball["bound"][quantity]["combined"] for ball in balls]
    else:
        key = {"attitude_deg": "attitude_rmse_deg", "rate_deg_s": "rate_rmse_deg_s"}[quantity]
        values = [ball["rows"][who][key]["combined"] for ball in balls]
    known = [v for v in values if v is not None]
    return float(np.sqrt(np.mean(np.square(known)))) if known and len(known) == len(values) else None


def _lost(balls: list[Result], who: str) -> int:
    return sum(ball["rows"][who]["lost_episodes"] for ball in balls)


def _both(balls: dict[int, list[Result]]) -> str:
    """What more discs bring, there and here; empty where one of the two numbers is missing."""
    few, many = min(STORED), max(STORED)
    if few not in balls or many not in balls:
        return ""
    thesis = {q: _norm(t[few]) / _norm(t[many]) for q, t in (("attitude_deg", ATTITUDE), ("rate_deg_s", RATE))}
    said = []
    for quantity, word in (("attitude_deg", "attitude"), ("rate_deg_s", "rate")):
        gains = [f"thesis {thesis[quantity]:.2f}"]
        for who in (*TRACKERS, "bound"):
            a, b = _rms(balls[few], who, quantity), _rms(balls[many], who, quantity)
            if a and b:
                gains.append(f"{'the bound' if who == 'bound' else f'`{who}`'} {a / b:.2f}")
        said.append(f"{word}: {', '.join(gains)}")
    noise = [b["rows"]["so3"]["detection"]["centre_rms_px"] for found in balls.values() for b in found]
    known = [x for x in noise if x is not None]
    centres = f" Centres are good to {min(known):.2f} to {max(known):.2f} px." if known else ""
    share = {
        n: 100.0 * np.mean([b["rows"]["so3"]["mean_discs"] / n for b in balls[n]])
        for n in STORED
        if n in balls and all(b["rows"]["so3"]["mean_discs"] for b in balls[n])
    }
    seen = f" {min(share.values()):.0f} to {max(share.values()):.0f} % of the discs are used" if share else ""
    return (
        f"Error with {few} discs over that with {many}: {'; '.join(said)}. If each disc said something "
        f"new, it would be √({many}/{few}) = {np.sqrt(many / few):.2f}. "
        + (f"In each frame{seen} (thesis: {_stored()} % stored)." if seen else "")
        + centres
    )


def _stored() -> str:
    """Shares of the discs that the thesis stores, %."""
    share = [100.0 * stored / n for n, stored in STORED.items()]
    return f"{min(share):.0f} to {max(share):.0f}"


def _too_few(balls: dict[int, list[Result]]) -> str:
    """With how many discs the attitude is no longer known; empty where there is no such ball."""
    said = []
    for n, found in balls.items():
        off = {who: _rms(found, who, "attitude_deg") for who in TRACKERS}
        lost = [who for who, x in off.items() if x is None or x > FAR_OFF]
        used = [b["rows"]["so3"]["mean_discs"] or 0.0 for b in found]
        if lost:
            said.append(
                f"{n} discs ({np.mean(used):.1f} of them used per frame): {', '.join(f'`{who}`' for who in lost)}"
            )
    if not said:
        return ""
    return (
        f"Too few discs for an attitude better than {FAR_OFF:g}°: {'; '.join(said)}. A single disc in view leaves the "
        "turn about itself open, none leaves all."
    )


def _norm(values: tuple[float, ...]) -> float:
    return float(np.linalg.norm(values))


def _all_table(balls: dict[int, list[Result]], failed: dict[int, int]) -> Table:
    """A row per number of discs and filter."""
    rows: list[tuple[str, ...]] = []
    for n in sorted({*balls, *failed}):
        found, bad = balls.get(n, []), failed.get(n, 0)
        films = f"{bad} of {len(found) + bad} failed" if bad else str(len(found))
        if not found:
            rows.append((str(n), films, *("–",) * 5))
            continue
        used = [b["rows"]["so3"]["mean_discs"] for b in found if b["rows"]["so3"]["mean_discs"] is not None]
        front = (str(n), films, f"{np.mean(used):.1f}" if used else "–")
        for who in (*TRACKERS, "bound"):
            attitude, rate = _rms(found, who, "attitude_deg"), _rms(found, who, "rate_deg_s")
            rows.append(
                (
                    *front,
                    "bound" if who == "bound" else f"`{who}`",
                    "–" if attitude is None else f"{attitude:.4f}",
                    "–" if rate is None else f"{rate:.2f}",
                    "" if who == "bound" else str(_lost(found, who)),
                )
            )
            front = ("", "", "")
    head = ("discs", "films", "used per frame", "filter", "attitude, °", "rate, °/s", "times lost")
    return Table(head, tuple(rows), "Combined RMSE by the number of discs, over the films")


def _figure(balls: dict[int, list[Result]]) -> Figure:
    panels = (("attitude_deg", "attitude RMSE, °", ATTITUDE), ("rate_deg_s", "rate RMSE, °/s", RATE))

    def draw(canvas: Any) -> None:
        from matplotlib.ticker import NullLocator

        axes = canvas.subplots(1, 2)
        handles: list[Any] = []
        for ax, (quantity, label, typed) in zip(axes, panels, strict=True):
            handles = []
            for k, who in enumerate(TRACKERS):
                x, y = _curve(balls, who, quantity)
                handles += ax.plot(x, y, color=f"C{k}", marker=_MARKS[k], label=who)
            x, y = _curve(balls, "bound", quantity)
            handles += ax.plot(x, y, color="0.5", label="Cramér-Rao bound", **BOUND)
            x, y = list(typed), [_norm(v) for v in typed.values()]
            handles += ax.plot(x, y, color="C3", marker="x", markersize=6, label="thesis, EKF2", **THESIS)
            ax.set(xscale="log", yscale="log", xlabel="discs on the ball", ylabel=label)
            plain_numbers(ax.yaxis)
            ax.set_xticks(list(balls), [str(n) for n in balls])
            ax.xaxis.set_minor_locator(NullLocator())
        canvas.legend(handles=handles, loc="outside upper center", ncols=5)

    return Figure(
        "count",
        "Errors against the number of discs, and the bound for the centres that `so3` measured.",
        draw,
        (7.2, 3.5),
    )


def _curve(balls: dict[int, list[Result]], who: str, quantity: str) -> tuple[list[int], list[float]]:
    points = [(n, _rms(found, who, quantity)) for n, found in balls.items()]
    known = [(n, y) for n, y in points if y is not None]
    return [n for n, _ in known], [y for _, y in known]
