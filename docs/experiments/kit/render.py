"""The one renderer of tables and plots: a section of Markdown, its figures as SVG and its numbers as CSV.

An experiment returns parts, `Table` and `Plot`. They are made of tidy frames, whose columns have the names that a
reader sees.
"""

import io
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from experiments.kit.job import Result, Results
from spheremouse.files.report.style import styled
from spheremouse.files.safe_files import write_atomically

MISSING = "–"
_NOTHING = "Nothing was measured: the reference recordings were not at hand (`--datasets`)."
_FRONT = """# Experiments

Values of the theses are typed in. All other values and all figures come from runs.

`ekf1` and `ekf2` are the filters of Wittich 2017 as published, with our detector unless stated otherwise. `so3` is \
ours, the default. RMSE is the root mean square error. Attitude errors are rotation vectors, relative to the first \
frame. They and errors of the rate are those of all three axes together unless an axis is named. Each experiment lists \
its failed films, which no value includes. – stands where there is no value. Figures show medians, shaded from the \
least to the largest value.

The bound is the posterior Cramér-Rao bound: the best average of any filter, with centres as noisy as those that `so3` \
measured. It takes common errors of centres for noise, and an error is that of one film. So values below it occur.

Our films are compared with those of Wittich 2017. R1 is real: somebody plays on a ball of 32 discs. S1, S2 and S3 \
are modelled, with 26, 50 and 74 discs before the far camera (2.35 m from the ball's centre). S4 has 50 discs before \
the near camera (1.35 m). The ball turns for ten seconds at up to 28 °/s and back, in 300 frames. Those films are \
not available; ours have those cameras and that motion. far26 is a Blender recording like S1, with struts, \
highlights and a room. Our own films show the same device and room. So the comparison is between similar films, not \
between the same pictures.
"""
# The colours of Okabe and Ito (2008), which colour-blind eyes tell apart; the curves differ in their dashes as well.
STYLE = {
    "axes.grid": True,
    "axes.prop_cycle": 'cycler("color", ["0072B2", "D55E00", "009E73", "CC79A7", "56B4E9", "E69F00"])'
    '+ cycler("linestyle", ["-", (0, (5, 1.5)), (0, (1.5, 1)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1)), "-"])',
    "text.parse_math": True,
}
BOUND: dict[str, Any] = {"color": "0.5", "linestyle": ":", "linewidth": 1.2}
_THESIS: dict[str, Any] = {"color": "k", "linestyle": "", "marker": "x", "markersize": 6}
_MARKS = "osDv^P"
_MAX_TICKS = 9  # of a logarithmic axis that has a tick at each value


@dataclass(frozen=True, slots=True)
class Table:
    """A table; numbers have three significant digits, or the decimals that are given by column.

    A section leaves out tables and plots without rows.
    """

    caption: str
    rows: pd.DataFrame
    merged: Sequence[str] = ()  # columns that show a value only where it differs from the one above
    decimals: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Plot:
    """Curves through medians, with a band from the least to the largest value at the same place.

    There is a panel for each column of `y` and each value of `facet`, and a curve for each value of `by`. Values whose
    name begins with "thesis" are drawn as crosses, those that begin with "bound" as dotted lines.
    """

    name: str  # of the file
    caption: str
    rows: pd.DataFrame  # a row for each value
    x: str
    y: Sequence[str]
    by: str
    facet: str = ""
    log: str = ""  # logarithmic axes: "x", "y" or "xy"
    levels: Mapping[str, float] = field(default_factory=dict)  # horizontal lines, by name


Part = Table | Plot

ATTITUDE, RATE = "attitude, °", "rate, °/s"
# Errors of a run, of all axes together and of each.
ERRORS = {"attitude_rmse_deg.combined": ATTITUDE, "rate_rmse_deg_s.combined": RATE}
AXES = {f"attitude_rmse_deg.{a}": f"attitude {a}, °" for a in "xyz"}
AXES |= {f"rate_rmse_deg_s.{a}": f"rate {a}, °/s" for a in "xyz"}


# ---- frames ----


def tidy(records: Iterable[Mapping[str, Any]], columns: Sequence[str] | Mapping[str, str] = ()) -> pd.DataFrame:
    """A row for each record. A nested value has the column `outer.inner`; an unknown one is nan.

    `columns`: which ones, in this order, by a new name if it is a mapping.
    """
    frame = pd.json_normalize(list(records)).replace({None: np.nan})  # pyright: ignore[reportArgumentType]
    if not columns:
        return frame
    frame = frame.reindex(columns=list(columns))
    return frame.rename(columns=dict(columns)) if isinstance(columns, Mapping) else frame


def filter_rows(about: Mapping[str, Any], rows: Results, bound: Result | None) -> Iterator[dict[str, Any]]:
    """Records of the filters of a film; the bound is one of them, with the errors of a filter."""
    limit = bound or {"attitude_deg": None, "rate_deg_s": None}
    errors = {"attitude_rmse_deg": limit["attitude_deg"], "rate_rmse_deg_s": limit["rate_deg_s"]}
    for name, row in {**rows, "bound": errors}.items():
        yield {**about, "filter": name, **row}


def rms(values: "pd.Series[float]") -> float:
    """Root mean square; nan where one is not known."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, float)))))


def by(frame: pd.DataFrame, keys: Sequence[str], how: Mapping[str, Any]) -> pd.DataFrame:
    """Rows of each group, in the order in which groups first come, with its columns put together as `how` says."""
    return frame.groupby(list(keys), sort=False, dropna=False).agg(dict(how)).reset_index()


def where(frame: pd.DataFrame, **values: Any) -> pd.DataFrame:
    """The rows that have these values; of a list, one of them."""
    for name, value in values.items():
        column = frame[name]
        frame = frame[column.isin(value) if isinstance(value, list | tuple) else column == value]
    return frame


def lengths(frame: pd.DataFrame, columns: Sequence[str]) -> "pd.Series[float]":
    """Norms of the vectors that rows have in these columns."""
    return pd.Series(np.linalg.norm(frame[list(columns)].to_numpy(float), axis=1), frame.index)


# ---- Markdown ----


def number(value: Any, decimals: int | None = None) -> str:
    """A value as text; – where it is not known."""
    if value is None or (isinstance(value, float | np.floating) and np.isnan(value)):
        return MISSING
    if not isinstance(value, int | float | np.number) or isinstance(value, bool):
        return str(value)
    if decimals is not None:
        return f"{value:.{decimals}f}"
    return f"{value:.0f}" if abs(value) >= 999.5 or float(value).is_integer() else f"{value:.3g}"


def markdown(table: Table) -> str:
    """The table itself, without its caption."""
    columns = []
    for name in table.rows.columns:
        cells = [number(x, table.decimals.get(name)).replace("|", "\\|") for x in table.rows[name].tolist()]
        if name in table.merged:
            cells = [x if k == 0 or x != cells[k - 1] else "" for k, x in enumerate(cells)]
        columns.append([str(name).replace("|", "\\|"), "---", *cells])
    return "\n".join("| " + " | ".join(line) + " |" for line in zip(*columns, strict=True))


def write_section(folder: Path, name: str, module: Any, results: Results, made: str) -> None:
    """Write NAME.md into a folder, with the figures and the numbers of its parts.

    The module gives `TITLE`, its docstring as the introduction, and `section(results)`, the parts from the jobs that
    did not fail. `made`: how the results were made.
    """
    good = {key: result for key, result in results.items() if "error" not in result}
    failed = [f"- {key}: {result['error']}" for key, result in results.items() if "error" in result]
    parts: Sequence[Part] = module.section(good) if good else ()
    text = [f"## {module.TITLE}", *_paragraphs(module.__doc__), made, *([] if results else [_NOTHING])]
    text += [block for k, part in enumerate(parts) for block in _written(part, folder, f"{name}-{k}")]
    text += ["Failed:\n\n" + "\n".join(failed)] if failed else []
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / f"{name}.md", "\n\n".join(text) + "\n")


def write_page(out: Path, names: Iterable[str]) -> Path:
    """Write experiments.md: the sections that its folder has, in the order of the names."""
    sections = [out / "experiments" / f"{name}.md" for name in names]
    texts = [_FRONT, *(path.read_text("utf-8") for path in sections if path.exists())]
    write_atomically(out / "experiments.md", "\n".join(texts))
    return out / "experiments.md"


def _paragraphs(docstring: str) -> list[str]:
    return [" ".join(paragraph.split()) for paragraph in docstring.split("\n\n")]


def _written(part: Part, folder: Path, name: str) -> list[str]:
    if part.rows.empty:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    if isinstance(part, Plot):
        save(part.name, lambda canvas: draw(part, canvas), folder, size_of(part))
        name, shown = part.name, f"![{part.caption}](experiments/{part.name}.svg)"
    else:
        shown = f"**{part.caption}**\n\n{markdown(part)}"
    write_atomically(folder / f"{name}.csv", part.rows.to_csv(index=False))
    return [f"{shown}\n\n[Numbers](experiments/{name}.csv)"]


# ---- figures ----


def save(name: str, draw: Callable[[Any], None], folder: Path, size: tuple[float, float]) -> None:
    """Write NAME.svg into a folder, drawn on a matplotlib figure. The same data give the same bytes."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with styled("light", STYLE):
        canvas = Figure(figsize=size, layout="constrained")
        FigureCanvasSVG(canvas)
        draw(canvas)
        text = io.StringIO()
        canvas.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    write_atomically(folder / f"{name}.svg", re.sub(r"[ \t]+$", "", text.getvalue(), flags=re.MULTILINE))


def _facets(plot: Plot) -> list[Any]:
    return list(plot.rows[plot.facet].unique()) if plot.facet else [None]


def size_of(plot: Plot) -> tuple[float, float]:
    return 7.2, 1.0 + 1.8 * (len(plot.y) if plot.facet else 1.3)


def draw(plot: Plot, canvas: Any) -> None:
    """Draw the panels of a plot on a matplotlib figure."""
    facets, names = _facets(plot), list(dict.fromkeys(plot.rows[plot.by]))
    looks = _looks(names)
    if plot.facet:
        grid = canvas.subplots(len(plot.y), len(facets), sharex="col", sharey="row", squeeze=False)
    else:
        grid = canvas.subplots(1, len(plot.y), squeeze=False).T
    for k, (row, column) in enumerate(zip(grid, plot.y, strict=True)):
        row[0].set_ylabel(column)
        for ax, facet in zip(row, facets, strict=True):
            here = plot.rows if facet is None else plot.rows[plot.rows[plot.facet] == facet]
            for name in names:
                _curve(ax, here[here[plot.by] == name].dropna(subset=[column]), plot, column, looks[name])
            for level in plot.levels.values():
                ax.axhline(level, **BOUND)
            _scale(ax, plot, here[plot.x])
            if plot.facet and k == 0:
                ax.set_title(str(facet), fontsize="small")
            if not plot.facet or k == len(grid) - 1:
                ax.set_xlabel(plot.x)
    _legend(canvas, looks, plot.levels)


def _looks(names: Sequence[Any]) -> dict[Any, dict[str, Any]]:
    looks: dict[Any, dict[str, Any]] = {}
    for name in names:
        k = len([look for look in looks.values() if look is not BOUND and look is not _THESIS])
        ours: dict[str, Any] = {"color": f"C{k % 6}", "marker": _MARKS[k % len(_MARKS)], "markersize": 4}
        word = str(name).split(" ", 1)[0].strip(",")
        looks[name] = BOUND if word == "bound" else _THESIS if word == "thesis" else ours
    return looks


def _curve(ax: Any, rows: pd.DataFrame, plot: Plot, column: str, look: Mapping[str, Any]) -> None:
    if rows.empty:
        return
    found = rows.groupby(plot.x, sort=is_numeric_dtype(rows[plot.x]))[column].agg(["median", "min", "max", "size"])
    if len(found) > 60:
        look = {**look, "marker": "", "linewidth": 0.9}
    ax.plot(found.index, found["median"], **look)
    if found["size"].max() > 1 and "marker" in look and look is not _THESIS:
        ax.fill_between(found.index, found["min"], found["max"], color=look["color"], alpha=0.15, linewidth=0)


def _scale(ax: Any, plot: Plot, values: "pd.Series[Any]") -> None:
    """Set logarithmic axes, with plain numbers; along x a tick at each value."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    for letter in plot.log:
        axis = {"x": ax.xaxis, "y": ax.yaxis}[letter]
        ax.set(**{f"{letter}scale": "log"})
        axis.set_major_locator(
            LogLocator(subs=(1.0,) if plot.facet and letter == "x" else (1.0, 2.0, 5.0), numticks=12)
        )
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
    if not is_numeric_dtype(values):
        ax.tick_params(axis="x", rotation=40)
    ticks = sorted(values.unique()) if "x" in plot.log else []
    if 0 < len(ticks) <= (5 if plot.facet else _MAX_TICKS):
        ax.set_xticks(ticks, [f"{x:g}" for x in ticks])
        ax.minorticks_off()


def _legend(canvas: Any, looks: Mapping[Any, Mapping[str, Any]], levels: Collection[str]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], label=str(name), **look) for name, look in looks.items()]
    handles += [Line2D([], [], label=name, **BOUND) for name in levels]
    canvas.legend(handles=handles, loc="outside lower center", ncols=4)
