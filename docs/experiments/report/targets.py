"""Numbers and figures of the page on the frame's targets."""

from typing import Any

import numpy as np
import pandas as pd

from experiments.kit.job import Results
from experiments.report.frames import by, markdown, tidy
from experiments.report.page import Page
from experiments.report.plot import BOUND, THESIS, Drawing, decades
from experiments.targets import (
    ABOUT,
    CONDITIONS,
    FAMILIES,
    KINDS,
    MATCH,
    NEARLY,
    NUMBER,
    NUMBERS,
    REFINED,
    REFINEMENTS,
    STRAY,
    SURE,
    USUAL,
)
from spheremouse.ball.pose import TARGET_SIGMA_PX
from spheremouse.ball.rig import CODES

_VECTORS = {
    "position_mm": "position, mm",
    "sigma_position_mm": "claimed, mm",
    "bound_mm": "bound, mm",
    "angle_deg": "angle, °",
    "sigma_angle_deg": "claimed, °",
}
_LOOKS: dict[str, dict[str, Any]] = {
    kind: {"color": f"C{k}", "marker": mark} for k, (kind, mark) in enumerate(zip(KINDS, "osD^", strict=True))
}


def page(results: Results) -> Page:
    """Number, size and kind: figures, tables, and what to put up."""
    means = _means(_tried(results))
    numbers, sizes = means[means["group"] == "numbers"], means[means["group"] == "sizes"]
    plain, usual = sizes[sizes["condition"] == "plain"], sizes[sizes["size"] == USUAL]
    scale = float(np.mean([camera["px_per_mm"] for camera in results.values()]))
    position, claimed, poses = (
        numbers.pivot(index="number", columns="kind", values=name).reindex(index=list(NUMBERS), columns=list(KINDS))
        for name in ("position_mm", "sigma_position_mm", "poses")
    )
    errors = usual[usual["condition"] == "plain"].set_index("kind").reindex(list(KINDS))
    smallest, corners = _smallest(sizes), _corners(results)
    dark = sizes[(sizes["condition"] == "dark") & (sizes["kind"] == "rings")]
    values = {
        "cameras": len(results),
        "turned": np.degrees(STRAY[2]),
        "plain": CONDITIONS["plain"],
        "refined": " or ".join(REFINED),
        "match": MATCH,
        "codes": len(CODES),
        "position": position,
        "claimed": claimed,
        "poses": poses,
        "nearly": NEARLY,
        "by_number": _table(numbers.assign(tried=numbers["number"].map(str)), "targets"),
        "number": NUMBER,
        "usual": USUAL,
        "across": scale * USUAL,
        "rings": errors.loc["rings"],
        "times": errors["position_mm"] / errors["position_mm"]["rings"],
        "allowed": TARGET_SIGMA_PX,
        "sure": SURE,
        "least": _least(smallest, scale),
        "smallest": smallest,
        "most_in_the_dark": dark["found"].max(),
        "advised": scale * smallest["rings"].max(),
        "by_condition": _table(usual.assign(tried=usual["condition"].map(ABOUT)), "condition"),
        "corners": corners["rms"],
        "refinements": _table_of_corners(corners),
    }
    return Page(values, (_figure_numbers(numbers), _figure_sizes(plain.assign(across=scale * plain["size"]))))


def _tried(results: Results) -> pd.DataFrame:
    """A row per camera and set of targets; errors are lengths of vectors."""
    records: list[dict[str, Any]] = []
    for camera in results.values():
        for group in ("numbers", "sizes"):
            for key, tried in camera[group].items():
                kind, number, size, condition = key.split("/")
                lengths = {name: np.linalg.norm(tried[name]) if name in tried else np.nan for name in _VECTORS}
                what = {"group": group, "kind": kind, "number": int(number), "size": float(size)}
                records.append({**what, "condition": condition, **tried, **lengths})
    tried = tidy(records)
    # The claim follows the residuals where these are larger than what is allowed for.
    noise = np.minimum(1.0, tried["point_px"] / TARGET_SIGMA_PX)
    tried = tried.assign(bound_mm=noise * tried["sigma_position_mm"])
    order = {name: k for k, name in enumerate((*CONDITIONS, *KINDS))}
    return tried.sort_values(["number", "size", "condition", "kind"], key=lambda column: column.replace(order))


def _means(tried: pd.DataFrame) -> pd.DataFrame:
    """A row per set of targets, over the cameras."""
    return by(
        tried,
        ["group", "number", "size", "condition", "kind"],
        cameras=("found", "size"),
        found=("found", "mean"),
        poses=("position_mm", "count"),
        **{name: (name, _rms) for name in ("point_px", *_VECTORS)},
    )


def _rms(values: "pd.Series[float]") -> float:
    """Return the RMS of the known values."""
    return float(np.sqrt((values**2).mean()))


def _table(means: pd.DataFrame, first: str) -> str:
    shown = means.assign(
        kind=means["kind"].map(KINDS),
        found=100.0 * means["found"],
        poses=means["poses"].map(str) + " of " + means["cameras"].map(str),
    )
    columns = {"tried": first, "kind": "kind", "found": "found, %", "poses": "poses"}
    columns |= {"point_px": "centres or corners, px", **_VECTORS}
    digits = {**{name: 2 if name.endswith("mm") else 3 for name in columns.values()}, "found, %": 0}
    return markdown(shown[list(columns)].rename(columns=columns), digits, sparse=[first])


def _smallest(sizes: pd.DataFrame) -> pd.DataFrame:
    """mm, by condition and kind: the size from which on all targets are found; nan where there is none."""
    shares = sizes.pivot(index=["condition", "size"], columns="kind", values="found")
    found = (shares.sort_index(ascending=False) >= SURE).astype(int).groupby(level="condition").cummin()
    size = pd.Series(found.index.get_level_values("size"), found.index)
    least = found.mul(size, axis=0).where(found == 1).groupby(level="condition").min()
    return least.reindex(index=list(CONDITIONS), columns=["rings", *FAMILIES])


def _least(smallest: pd.DataFrame, scale: float) -> str:
    shown = smallest.map(lambda mm: f"{scale * mm:.0f} px ({mm:.0f} mm)", na_action="ignore")
    return markdown(shown.rename(columns=KINDS, index=ABOUT).reset_index(names="condition"))


def _corners(results: Results) -> pd.DataFrame:
    """px, by refinement: errors of corners over the cameras, and the share of the corners that is found."""
    found = pd.DataFrame(
        index=pd.Index(REFINEMENTS, name="refinement"), columns=["found", "rms", "u", "v"], dtype=float
    )
    for name in REFINEMENTS:
        seen = [camera["refinements"][name] for camera in results.values()]
        errors = np.concatenate([np.reshape(one["errors"], (-1, 2)) for one in seen])
        u, v = errors.mean(axis=0) if len(errors) else (np.nan, np.nan)
        found.loc[name] = (np.mean([one["found"] for one in seen]), _rms(pd.Series(errors.ravel())), u, v)
    return found


def _table_of_corners(corners: pd.DataFrame) -> str:
    names = {"rms": "corner RMS per axis, px", "u": "mean error u, px", "v": "mean error v, px"}
    shown = corners.assign(found=100.0 * corners["found"]).reset_index().rename(columns={"found": "found, %", **names})
    return markdown(shown, dict.fromkeys(names.values(), 3))


def _lines(ax: Any, means: pd.DataFrame, x: str) -> None:
    """Position error with its claim (dashed) and its bound (dotted)."""
    for kind, look in _LOOKS.items():
        line = means[means["kind"] == kind].dropna(subset=["position_mm"])
        ax.plot(line[x], line["position_mm"], color=look["color"], linestyle="-")
        for some, points in line.groupby(line["poses"] < line["cameras"]):  # hollow: not all cameras had a pose
            inside = {"markerfacecolor": "none"} if some else {}
            ax.plot(points[x], points["position_mm"], linestyle="", **look, **inside)
        ax.plot(line[x], line["sigma_position_mm"], color=look["color"], **{**THESIS, "linewidth": 0.7})
        ax.plot(line[x], line["bound_mm"], color=look["color"], **BOUND)
    ax.set(yscale="log", ylabel="position of the camera, mm")
    decades(ax.yaxis)


def _legend(canvas: Any) -> None:
    from matplotlib.lines import Line2D

    kinds = [Line2D([], [], linestyle="-", label=KINDS[kind], **look) for kind, look in _LOOKS.items()]
    grey = [Line2D([], [], color="0.5", label=name, **how) for name, how in (("claimed", THESIS), ("bound", BOUND))]
    canvas.legend(handles=[*kinds, *grey], loc="outside upper center", ncols=6)


def _figure_numbers(numbers: pd.DataFrame) -> Drawing:
    def draw(canvas: Any) -> None:
        ax = canvas.subplots()
        _lines(ax, numbers, "number")
        ax.set(xlabel="targets", xticks=numbers["number"].unique())
        _legend(canvas)

    return Drawing("targets-number", draw, (7.2, 3.3))


def _figure_sizes(plain: pd.DataFrame) -> Drawing:
    """`plain`: has what the targets are `across`, px."""

    def draw(canvas: Any) -> None:
        left, right = canvas.subplots(1, 2)
        _lines(left, plain, "across")
        for kind in ("rings", *FAMILIES):
            line = plain[plain["kind"] == kind]
            right.plot(line["across"], 100.0 * line["found"], linestyle="-", **_LOOKS[kind])
        for ax in (left, right):
            ax.set(xscale="log", xlabel="target across, px")
            ax.set_xticks(across := plain["across"].unique(), [f"{x:.0f}" for x in across])
            ax.minorticks_off()
        right.set_ylabel("found, %")
        _legend(canvas)

    return Drawing("targets-size", draw, (7.2, 3.5))
