"""Numbers and figures of the page on the filter models."""

from typing import Any

import numpy as np
import pandas as pd

from experiments.filters import ENOUGH, PACES, PUBLISHED, THESIS
from experiments.kit import r1
from experiments.kit.film import TRACKERS, settings_of
from experiments.kit.job import Result, Results
from experiments.report.frames import markdown, tidy
from experiments.report.page import Page
from experiments.report.plot import Drawing
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball import profile
from spheremouse.simulate.ball.film import SimulationOptions

LARGE = ("series",)  # what the figures are drawn from
_FILMS = {"r1": "R1-like", "s1": "S1, ours", "far26": "far26"}
_PACES = {"r1": r1.PACE, **{f"pace-{pace:g}": pace for pace in PACES}}
_FILTERS = ("ekf1", "ekf2", f"ekf1{PUBLISHED}", f"ekf2{PUBLISHED}", "so3")
_QUANTITIES = {
    "rate_rmse_deg_s.combined": "rate",
    "surface_speed_rmse_mm_s.combined": "speed",
    "largest_mm_s": "largest",
    "attitude_rmse_deg.combined": "attitude",
    "frames": "frames",
    "tracked": "tracked",
    "lost_episodes": "lost",
    "mean_discs": "discs",
    "detection.centre_rms_px": "centres",
    "few_share": "few",
    "truth": "truth",
}


def page(results: Results) -> Page:
    """Table 19, the figures, the livelier players."""
    runs = _runs(results)
    like_r1, s1 = results.get("r1"), results.get("s1")
    beside = like_r1 or {"truth": {}, "match": {}, "from": np.nan, "to": np.nan}
    lost = runs["lost"].unstack("film")[list(_PACES)]
    films = [film for film in _FILMS if film != "far26" or film in results]
    values = {
        "far26": {},  # where there is none
        **{film: {who: runs.loc[(film, who)] for who in _FILTERS} for film in films},
        "noise_r1": r1.OPTIONS["noise"],
        "noise": SimulationOptions().noise,
        "table_19": _table_19(runs, films),
        "assumed": settings_of().euler.acceleration_sigma,
        "acceleration": acceleration(profile.thesis()),
        "enough": ENOUGH,
        "true_r": beside["truth"].get("r", np.nan),
        "match": {k: beside["match"].get(k, np.nan) for k in ("lag_ms", "lag_sigma_ms", "scale", "scale_sigma")},
        "lag_ms": 1e3 * r1.LAG,
        "scale": r1.SCALE,
        **{k: beside[k] for k in ("from", "to")},
        "lost_classic": lost.loc[["ekf1", "ekf2"]].min(axis=None, skipna=False),
        "lost_so3": lost.loc["so3"].max(skipna=False),
        "paces": _paces(runs),
    }
    drawings = [draw(of) for draw, of in ((_figure_r1, like_r1), (_figure_s1, s1)) if of is not None]
    return Page(values, tuple(drawings))


def _runs(results: Results) -> pd.DataFrame:
    """A row per film and filter, of all there can be; r is the correlation with the trackball, if there is one."""
    records: list[dict[str, Any]] = []
    for film, result in results.items():
        truth = result.get("truth", {}).get("r")
        records += [{"film": film, "filter": who, "truth": truth, **row} for who, row in result["rows"].items()]
    runs = tidy(records).set_index(["film", "filter"]).rename(columns=_QUANTITIES)
    rows = pd.MultiIndex.from_product([dict.fromkeys([*_FILMS, *_PACES]), _FILTERS], names=["film", "filter"])
    runs = runs.reindex(index=rows, columns=["trackball.r", "surface_speed_r.combined", *_QUANTITIES.values()])
    logged = runs.index.get_level_values("film").isin(list(_PACES))
    runs["r"] = runs["trackball.r"].where(logged, runs["surface_speed_r.combined"])
    return runs.astype(float)


def _table_19(runs: pd.DataFrame, films: list[str]) -> str:
    columns = {
        "film": "film",
        "filter": "filter",
        "r": "correlation",
        "rate": "rate RMSE, °/s",
        "speed": "mouse speed RMSE, mm/s (thesis: px/s)",
        "largest": "largest error of it, mm/s",
        "attitude": "attitude RMSE, °",
        "frames": "frames",
        "tracked": "tracked",
        "lost": "times lost",
    }
    typed = pd.DataFrame(THESIS, columns=["film", "filter", "r", "rate", "speed"])
    parts = []
    for film in films:
        ours = runs.loc[[film]].reset_index()
        named = ours.assign(film=_FILMS[film], filter=ours["filter"].map(_label))
        parts += [typed[typed["film"] == film.upper()], named]
    table = pd.concat(parts).reindex(columns=list(columns)).rename(columns=columns)
    return markdown(table, dict(zip(table.columns, (0, 0, 5, 2, 1, 0, 4, 0, 0, 0), strict=True)), sparse=["film"])


def _paces(runs: pd.DataFrame) -> str:
    shown = runs.loc[list(_PACES)].reset_index()
    shown = shown[shown["filter"].isin(TRACKERS)]
    shown = shown.assign(film=[f"{_PACES[film]:g}" for film in shown["film"]], filter=shown["filter"].map(_label))
    shown = shown[["film", "truth", "filter", "r", "rate", "lost"]]
    shown.columns = ["pace", "r of the true motion", "filter", "r", "rate RMSE, °/s", "times lost"]
    digits = dict(zip(shown.columns, (0, 3, 0, 3, 2, 0), strict=True))
    return markdown(shown, digits, sparse=["pace"])


def _label(name: str) -> str:
    tracker = name.removesuffix(PUBLISHED)
    return f"`{tracker}`, published detector" if name.endswith(PUBLISHED) else f"`{tracker}`"


def acceleration(motion: profile.Profile) -> float:
    """Mean angular acceleration, rad/s²."""
    t = np.linspace(0.0, motion.seconds, 2001)[:-1]
    steps = np.diff(motion.rate(t), axis=0) / (t[1] - t[0])
    return float(np.mean(np.linalg.norm(steps, axis=1)))


def _figure_r1(result: Result) -> Drawing:
    series, log = result["series"], result["log"]
    pale = {"color": "0.5", "alpha": 0.55, "linewidth": 2.4, "linestyle": "-"}

    def draw(canvas: Any) -> None:
        axes = canvas.subplots(2, len(TRACKERS), sharex=True, sharey="row", squeeze=False)
        for column, (name, ax) in enumerate(zip(TRACKERS, axes.T, strict=True)):
            ax[0].set_title(name)
            ax[1].set_xlabel("time, s")
            for axis in range(2):
                if log is not None:
                    ax[axis].plot(log["t"], np.array(log["speed"])[:, axis], **pale)
                if series[name]["t"]:
                    t, speed = _gapped(series[name], "t"), _gapped(series[name], "speed")
                    ax[axis].plot(t, speed[:, axis], color=f"C{column}", linewidth=0.9, linestyle="-")
        for axis, letter in enumerate("xy"):
            axes[axis, 0].set_ylabel(f"mouse speed {letter}, mm/s")
        handles = [axes[0, 0].plot([], [], label="trackball's log", **pale)[0]]
        for column, name in enumerate(TRACKERS):
            handles += axes[0, 0].plot([], [], color=f"C{column}", linewidth=0.9, linestyle="-", label=name)
        canvas.legend(handles=handles, loc="outside upper center", ncols=4)

    return Drawing("filters-r1", draw, (7.2, 4.0))


def _figure_s1(result: Result) -> Drawing:
    series = result["series"]

    def draw(canvas: Any) -> None:
        rows = 1 + len(TRACKERS)
        axes = canvas.subplots(rows, 2, sharex=True, sharey="row", gridspec_kw={"height_ratios": [1.6] + [1.0] * 3})
        truth = max(series.values(), key=lambda s: len(s["t"]))
        biggest = np.concatenate([np.abs(_gapped(s, "error")).ravel() for s in series.values() if s["t"]])
        most = 1.1 * float(np.nanmax(biggest)) if len(biggest) else 1.0
        for axis, letter in enumerate("xy"):
            axes[0, axis].set_title(letter)
            axes[0, axis].plot(_gapped(truth, "t"), _gapped(truth, "true")[:, axis], color="0.5", linestyle="-")
            for k, name in enumerate(TRACKERS):
                ax, s = axes[1 + k, axis], series[name]
                ax.set_ylim(-most, most)
                if s["t"]:
                    ax.plot(_gapped(s, "t"), _gapped(s, "error")[:, axis], color=f"C{k}", linewidth=0.9, linestyle="-")
                rms = result["rows"][name]["surface_speed_rmse_mm_s"][letter]
                words = name if rms is None else f"{name}, RMS {rms:.2f} mm/s"
                ax.annotate(words, (0.01, 0.97), xycoords="axes fraction", va="top", fontsize=8)
            axes[-1, axis].set_xlabel("time, s")
        axes[0, 0].set_ylabel("true speed,\nmm/s")
        for ax in axes[1:, 0]:
            ax.set_ylabel("error,\nmm/s")
        canvas.align_ylabels(axes[:, 0])

    return Drawing("filters-s1", draw, (7.2, 5.0))


def _gapped(series: Result, key: str) -> Array:
    """Values with nan where frames are missing: a curve breaks there."""
    t, values = np.array(series["t"], dtype=float), np.array(series[key], dtype=float)
    if len(t) < 2:
        return values
    missing = np.flatnonzero(np.diff(t) > 1.5 * np.median(np.diff(t))) + 1
    return np.insert(values, missing, np.nan, axis=0)
