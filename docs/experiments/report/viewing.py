"""Numbers and figures of the page on how the camera films."""

from typing import Any

import numpy as np
import pandas as pd

from experiments.kit import film as kit
from experiments.kit.job import Results
from experiments.kit.tour import AXES, FAR_OFF, FOLLOWED, KNOWN, NEAR, NOISE, SHARE, USUAL, is_lost
from experiments.report.cells import COLOURS, DASHES, MARKS
from experiments.report.frames import by, markdown, tidy
from experiments.report.labels import End, label_ends
from experiments.report.page import Page
from experiments.report.plot import BOUND, Drawing, plain_numbers
from experiments.viewing import FASTEST, KINDS, Kind
from spheremouse.ball.rig import UNKNOWN_READOUT

_UNITS = {"attitude": "°", "rate": "°/s"}


def page(results: Results) -> Page:
    """Errors against what is varied, how much they change over the range of it, and where they are small enough."""
    runs = _runs(results)
    once = runs[runs["filter"] == KNOWN]
    spans = {f"{what} {end}": (what, end) for what in _UNITS for end in ("min", "max")}
    medians = by(
        runs,
        ["kind", "value", "filter"],
        films=("lost", "size"),
        lost=("lost", "sum"),
        given=("given", "any"),
        speed=("rms", "median"),
        **{what: (what, _median) for what in _UNITS},
        **spans,
    )
    enough = (medians["attitude"] < NEAR) & (medians["rate"] < SHARE * medians["speed"])
    good = _values_of(medians[enough & (medians["lost"] == 0)])
    least = _least_rates(medians)
    ratios = {name: _ratios(medians, kind) for name, kind in KINDS.items() if name != "rate"}
    values = {
        "noise": NOISE,
        "axes": len(AXES),
        "speed": once["rms"].median(),
        "peak": once["peak"].max(),
        "usual": USUAL,
        "films": medians["films"].max(),
        "acceleration": once["acceleration"].median(),
        "published": kit.settings_of().euler.acceleration_sigma,
        "followed": FOLLOWED,
        "far_off": FAR_OFF,
        "fastest": FASTEST,
        "least_rate": markdown(least.rename(index=_named).reset_index(names="filter")),
        "over_least": least["highest over least"].to_dict(),
        "unposed": once.loc[once["given"], "value"].unique(),
        "unseen": once[once["unseen"]].groupby("value").size().to_dict(),
        "frame_ms": 1e3 / USUAL,
        "unknown_ms": 1e3 * UNKNOWN_READOUT,
        "over": {name: frame.to_dict() for name, frame in ratios.items()},
        "near": NEAR,
        "share": SHARE,
        "good": good,
        "good_table": _good_table(good),
        "tried": {name: list(kind.whole) for name, kind in KINDS.items()},
    }
    for name, kind in KINDS.items():
        values[f"{name}_table"] = _table(medians[medians["kind"] == name], kind)
    for name, frame in ratios.items():
        values[f"{name}_ratios"] = markdown(frame.rename(index=_named).reset_index(names="filter"))
    return Page(values, tuple(_figure(medians, kind) for kind in KINDS.values() if kind.name in set(medians["kind"])))


def _runs(results: Results) -> pd.DataFrame:
    """A row per film and filter, in the order of what is varied; the bound is one of the filters.

    The film without anything special stands for a value of three kinds. Without a rolling shutter its readout is as
    good as known.
    """
    films = []
    for key, result in results.items():
        kind, _, rest = key.partition("-")
        if kind == "rate":
            films += [(kind, value, point) for value, point in result["points"].items()]
        elif kind == "plain":
            films += [(k.name, k.plain, result) for k in KINDS.values() if k.plain]
        else:
            films.append((kind, rest.rpartition("-")[0], result))
    records: list[dict[str, Any]] = []
    for kind, value, film in sorted(films, key=lambda film: KINDS[film[0]].whole.index(film[1])):
        rows, unfound = film["rows"], film.get("pose") or ""  # why the camera's pose was not found
        about = {"kind": kind, "value": value, "given": bool(unfound), "unseen": unfound.startswith("0 of")}
        for who in KINDS[kind].shown:
            row = rows.get(who, rows[KNOWN])
            errors = {what: row[what] for what in _UNITS}
            records.append({**about, **film["moved"], "filter": who, **errors, "lost": is_lost(row)})
        limit = film["bound"] or dict.fromkeys(_UNITS)
        records.append({**about, **film["moved"], "filter": "bound", **limit, "lost": False})
    return tidy(records)


def _median(values: "pd.Series[float]") -> float:
    """nan where one is not known."""
    return float(np.median(np.asarray(values, float)))


def _named(who: str) -> str:
    return who if who == "bound" else f"`{who}`"


def _with_crosses(values: "pd.Series[str]") -> "pd.Series[str]":
    """640×480 for 640x480."""
    return values.str.replace("x", "×")


def _table(medians: pd.DataFrame, kind: Kind) -> str:
    label = "picture, px" if kind.name == "size" else kind.label
    gone = 2 * medians["lost"] >= medians["films"]
    made: dict[str, Any] = {label: _with_crosses(medians["value"]), "filter": medians["filter"].map(_named)}
    for what, unit in _UNITS.items():
        made[f"{what}, {unit}"] = medians[what].astype(object).mask(gone, "lost")
    counts = medians["lost"].astype(str) + " of " + medians["films"].astype(str)
    made["lost"] = counts.where(medians["filter"] != "bound", "")
    return markdown(pd.DataFrame(made), {"attitude, °": 3, "rate, °/s": 2}, sparse=[label])


def _least_rates(medians: pd.DataFrame) -> pd.DataFrame:
    """Errors of the rate at the best frame rate, the lowest and the highest."""
    kind = KINDS["rate"]
    low, high = kind.whole[0], kind.whole[-1]
    known = medians[medians["kind"] == "rate"].dropna(subset="rate")
    best = known.sort_values("rate").groupby("filter")[["rate", "value"]].first()
    at = known.pivot_table(index="filter", columns="value", values="rate").reindex(columns=[low, high])
    found = pd.DataFrame({
        "least, °/s": best["rate"],
        "at, frames per second": best["value"],
        f"at {low}": at[low],
        f"at {high}": at[high],
        "highest over least": at[high] / best["rate"],
    })  # fmt: skip
    return found.reindex([*kind.shown, "bound"])


def _ratios(medians: pd.DataFrame, kind: Kind) -> pd.DataFrame:
    """Errors at the last value over those at the first; a row per filter."""
    errors = medians[medians["kind"] == kind.name].set_index(["value", "filter"])[list(_UNITS)]
    who = [*kind.shown, "bound"]
    first, last = (errors.reindex([(value, w) for w in who]).to_numpy() for value in (kind.whole[0], kind.whole[-1]))
    return pd.DataFrame(last / first, who, list(_UNITS))


def _values_of(medians: pd.DataFrame) -> dict[str, dict[str, list[str]]]:
    """Values that are left, by what is varied and by filter."""
    found: dict[str, dict[str, list[str]]] = {name: {who: [] for who in kind.shown} for name, kind in KINDS.items()}
    for row in medians[medians["filter"] != "bound"].itertuples():
        found[str(row.kind)][str(row.filter)].append(str(row.value))
    return found


def _good_table(good: dict[str, dict[str, list[str]]]) -> str:
    cells = {
        KINDS[name].label: {_named(who): ", ".join(values) or "none" for who, values in found.items()}
        for name, found in good.items()
    }
    return markdown(pd.DataFrame(cells).reset_index(names="").apply(_with_crosses))


def _figure(medians: pd.DataFrame, kind: Kind) -> Drawing:
    lines = medians[medians["kind"] == kind.name]
    lines = lines.assign(x=[float(value.rpartition("x")[2]) for value in lines["value"]])  # of a size its rows

    def draw(canvas: Any) -> None:
        for ax, (what, unit) in zip(canvas.subplots(1, 2), _UNITS.items(), strict=True):
            ends = [_line(ax, lines[lines["filter"] == who], who, what) for who in (*kind.shown, "bound")]
            ax.set(yscale="log", xscale="log" if kind.log else "linear", ylabel=f"{what} RMSE, {unit}")
            ax.set_xlabel(kind.label)
            plain_numbers(ax.yaxis)
            ticks = [x for x in lines["x"].unique() if x not in (20.0, 40.0, 80.0)]  # no room beside their neighbours
            ax.set_xticks(ticks, [f"{x:g}" for x in ticks])
            if kind.log:
                ax.xaxis.minorticks_off()
            label_ends(ax, [end for end in ends if end is not None])
            if kind.name == "blur":
                top = ax.secondary_xaxis(
                    "top", functions=(lambda ms: ms * USUAL / 10.0, lambda share: share * 10.0 / USUAL)
                )
                top.set_xlabel("share of the frame's time, %")

    return Drawing(f"viewing-{kind.name}", draw, (7.2, 3.2 if kind.name != "blur" else 3.5))


def _line(ax: Any, line: pd.DataFrame, who: str, what: str) -> End | None:
    """Draw one; its name, where it ends and its colour."""
    line, colour = line[line[what] > 0.0], COLOURS[who]
    if line.empty:
        return None
    if who == "bound":
        ax.plot(line["x"], line[what], color=colour, **BOUND)
    else:
        ax.plot(line["x"], line[what], color=colour, linestyle=DASHES[who])
        for row in line.itertuples():
            look = {"marker": "x", "markersize": 7} if row.lost else {"marker": MARKS[who]}
            face = "none" if row.given else colour
            ax.plot([row.x], [getattr(row, what)], color=colour, linestyle="", markerfacecolor=face, **look)
    if who == KNOWN:
        ax.fill_between(line["x"], line[f"{what} min"], line[f"{what} max"], color=colour, alpha=0.15, linewidth=0)
    return End(who, line[what].iloc[-1], colour)
