"""Numbers and figures of the page on the number of discs."""

from typing import Any

import numpy as np
import pandas as pd

from experiments.count import ATTITUDE, RATE, STORED
from experiments.kit.film import TRACKERS
from experiments.kit.job import Results
from experiments.report.frames import by, markdown, rms, tidy
from experiments.report.page import Page
from experiments.report.plot import BOUND, THESIS, Drawing, plain_numbers
from spheremouse.simulate.ball.film import SimulationOptions

_WHO = (*TRACKERS, "bound")
_QUANTITIES = {"attitude": "attitude_rmse_deg", "rate": "rate_rmse_deg_s"}
_UNITS = {"attitude": "°", "rate": "°/s"}
_LOOKS: dict[str, dict[str, Any]] = {
    **{who: {"color": f"C{k}", "marker": "osD"[k]} for k, who in enumerate(TRACKERS)},
    "bound": {"color": "0.5", **BOUND},
}
_THESIS_LOOK: dict[str, Any] = {"color": "C3", "marker": "x", "markersize": 6, **THESIS}


def page(results: Results) -> Page:
    """Table 20, and errors against the number of discs."""
    runs = _runs(results)
    ours = runs[runs["filter"] == "so3"]
    share = 100.0 * ours.groupby("discs")["mean_discs"].mean()
    share = (share / share.index).reindex(list(STORED))
    means = by(
        runs,
        ["discs", "filter"],
        films=("layout", "size"),
        used=("mean_discs", "mean"),
        **{name: (f"{column}.combined", rms) for name, column in _QUANTITIES.items()},
        lost=("lost_episodes", "sum"),
    )
    filters = means[means["filter"] != "bound"].groupby("discs")["attitude"]
    values = {
        "frames": ours["frames"].max(),
        "noise": SimulationOptions().noise,
        "layouts": means["films"].max(),
        "table_20": _table_20(runs),
        "share_least": share.min(skipna=False),
        "share_most": share.max(skipna=False),
        "centre_best": ours["detection.centre_rms_px"].min(),
        "centre_worst": ours["detection.centre_rms_px"].max(),
        "gains": _gains(means),
        "best_10": filters.min().get(10, np.nan),
        "worst_16": filters.max().get(16, np.nan),
        "everything": _everything(means),
    }
    return Page(values, (_figure(means),))


def _runs(results: Results) -> pd.DataFrame:
    """A row per film and filter; the bound is one of these."""
    records: list[dict[str, Any]] = []
    for key, result in results.items():
        discs, layout = map(int, key.split("-"))
        bound = result["bound"] or {"attitude_deg": {}, "rate_deg_s": {}}
        limit = {"attitude_rmse_deg": bound["attitude_deg"], "rate_rmse_deg_s": bound["rate_deg_s"]}
        for who, row in {**result["rows"], "bound": limit}.items():
            records.append({"discs": discs, "layout": layout, "filter": who, **row})
    return tidy(records)


def _table_20(runs: pd.DataFrame) -> str:
    columns = {"mean_discs": "used per frame (thesis: stored)"}
    columns |= {f"attitude_rmse_deg.{a}": f"attitude {a}, °" for a in "xyz"}
    columns |= {f"rate_rmse_deg_s.{a}": f"rate {a}, °/s" for a in "xyz"}
    typed = [["thesis, EKF2", n, f"{STORED[n]:.1f}", *(f"{x:.3f}" for x in (*ATTITUDE[n], *RATE[n]))] for n in STORED]
    thesis = pd.DataFrame(typed, columns=["filter", "discs", *columns])
    first = runs[(runs["layout"] == 0) & runs["filter"].isin(TRACKERS) & runs["discs"].isin(list(STORED))]
    both = pd.concat([thesis, first.assign(filter=first["filter"].map(_named))])
    both = both[["discs", "filter", *columns]].sort_values("discs", kind="stable").rename(columns=columns)
    digits = {name: 4 if "attitude" in name else 3 if "rate " in name else 1 for name in columns.values()}
    return markdown(both, digits, sparse=["discs"])


def _gains(means: pd.DataFrame) -> str:
    """Errors with the fewest discs of table 20 over those with the most."""
    few, many = min(STORED), max(STORED)
    columns = {"thesis, EKF2": [_norm(typed[few]) / _norm(typed[many]) for typed in (ATTITUDE, RATE)]}
    errors = means.set_index(["filter", "discs"])[list(_QUANTITIES)]
    for who in _WHO:
        ratio = errors.reindex([(who, few)]).to_numpy() / errors.reindex([(who, many)]).to_numpy()
        columns[_named(who)] = ratio[0].tolist()
    return markdown(pd.DataFrame({"error of": list(_QUANTITIES), **columns}))


def _everything(means: pd.DataFrame) -> str:
    columns = {"attitude": "attitude, °", "rate": "rate, °/s", "lost": "times lost"}
    used = means["discs"].map(means[means["filter"] == "so3"].set_index("discs")["used"])
    shown = means.assign(used=used, filter=means["filter"].map(_named)).rename(columns=columns)
    shown.loc[means["filter"] == "bound", "times lost"] = np.nan
    return markdown(
        shown[["discs", "films", "used", "filter", *columns.values()]].rename(columns={"used": "used per frame"}),
        {"used per frame": 1, "attitude, °": 4, "rate, °/s": 2},
        sparse=["discs"],
    )


def _figure(means: pd.DataFrame) -> Drawing:
    def draw(canvas: Any) -> None:
        from matplotlib.ticker import NullLocator

        for ax, (name, typed) in zip(canvas.subplots(1, 2), {"attitude": ATTITUDE, "rate": RATE}.items(), strict=True):
            for who, look in _LOOKS.items():
                line = means[means["filter"] == who]
                ax.plot(line["discs"], line[name], label=who, **look)
            ax.plot(list(typed), [_norm(v) for v in typed.values()], label="thesis, EKF2", **_THESIS_LOOK)
            ax.set(xscale="log", yscale="log", xlabel="discs on the ball", ylabel=f"{name} RMSE, {_UNITS[name]}")
            plain_numbers(ax.yaxis)
            discs = means["discs"].unique()
            ax.set_xticks(discs, map(str, discs))
            ax.xaxis.set_minor_locator(NullLocator())
        canvas.legend(*canvas.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)

    return Drawing("count", draw, (7.2, 3.5))


def _named(who: str) -> str:
    return f"`{who}`" if who in TRACKERS else who


def _norm(values: tuple[float, ...]) -> float:
    return float(np.linalg.norm(values))
