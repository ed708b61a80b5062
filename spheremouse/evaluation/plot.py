"""Plot a run: estimate and true attitude and rate, and below them the errors with the filter's ±3 sigma.

Needs matplotlib, which is loaded when something is drawn.
"""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spheremouse.ball.truth import Truth
from spheremouse.errors import ConfigurationError
from spheremouse.evaluation.metrics import attitude_error
from spheremouse.evaluation.run import Run
from spheremouse.files.report.style import BLUE, GREEN, INK, MUTED, RED, styled
from spheremouse.files.safe_files import write
from spheremouse.geometry.rotation import Array, log

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_AXES = "XYZ"
_COLOURS = RED, GREEN, BLUE


def plot_run(run: Run, truth: Truth, path: Path | str) -> None:
    """Draw the tracked frames, at least one, to an image file; those between are gaps.

    Attitudes are drawn as rotation vectors from the first frame. Errors are those of `metrics`, with bands of ±3 of the
    filter's standard deviations. The suffix of `path` sets the format, `.png` if there is none. Raises
    ConfigurationError if the file cannot be written.
    """
    kept = run.tracked
    t, attitude, rate = run.stamp[kept], run.attitude[kept], run.rate[kept]
    truth_attitude, truth_rate = truth.attitude[run.frame[kept]], truth.rate[run.frame[kept]]
    gap = _gaps(t)[:, None]
    sigma = np.sqrt(np.maximum(np.diagonal(run.covariance[kept], axis1=1, axis2=2), 0.0))
    columns = (
        (
            "Attitude",
            "rotation from the first frame, °",
            "°",
            _unbroken(log(attitude @ attitude[0].T)),
            _unbroken(log(truth_attitude @ truth_attitude[0].T)),
            attitude_error(attitude, truth_attitude),
            sigma[:, :3],
        ),
        ("Angular velocity", "rate, °/s", "°/s", rate, truth_rate, rate - truth_rate, sigma[:, 3:]),
    )
    with styled():
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=(11.0, 6.8), dpi=160, layout="constrained")
        FigureCanvasAgg(figure)
        figure.get_layout_engine().set(w_pad=0.08, h_pad=0.03, hspace=0.03, wspace=0.04)  # type: ignore[union-attr]
        axes = figure.subplots(4, 2, sharex=True, gridspec_kw={"height_ratios": [3.4, 1, 1, 1]})
        for column, (title, label, unit, estimate, true, error, claimed) in zip(axes.T, columns, strict=True):
            column[0].set_title(title, pad=10, fontweight="bold")
            _draw_curves(column[0], t, np.rad2deg(estimate) + gap, np.rad2deg(true) + gap, label)
            _draw_errors(column[1:], t, np.rad2deg(error) + gap, np.rad2deg(claimed) + gap, unit)
            column[-1].set_xlabel("time, s")
        figure.align_ylabels(axes)
        _save(figure, Path(path))


def _save(figure: "Figure", path: Path) -> None:
    """Write a figure in the format of its ending, PNG by default. A failure leaves no half file."""
    path = path if path.suffix else path.with_name(f"{path.name}.png")  # as matplotlib does
    drawn = BytesIO()
    try:
        figure.savefig(drawn, format=path.suffix[1:], facecolor="white")
        write(path, drawn.getvalue())
    except (OSError, ValueError) as e:
        raise ConfigurationError(f"{path}: cannot be written: {e}") from None


def _draw_curves(axes: "Axes", t: Array, estimate: Array, truth: Array, label: str) -> None:
    """Draw truth (broad, pale) and estimate (thin), (n, 3), against `t` (n,) s; `label` names quantity and unit."""
    for i, colour in enumerate(_COLOURS):
        axes.plot(t, truth[:, i], color=colour, alpha=0.28, linewidth=4.0, solid_capstyle="round")
        axes.plot(t, estimate[:, i], color=colour, linewidth=1.1)
    _quiet(axes)
    axes.set_ylabel(label)
    handles = [axes.plot([], [], color=c, linewidth=1.6, label=n)[0] for c, n in zip(_COLOURS, _AXES, strict=True)]
    handles.append(axes.plot([], [], color=INK, linewidth=1.1, label="estimate")[0])
    handles.append(axes.plot([], [], color=INK, alpha=0.28, linewidth=4.0, label="truth")[0])
    axes.legend(
        handles=handles,
        ncols=5,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        handlelength=1.3,
        columnspacing=1.1,
        borderaxespad=0.2,
    )


def _draw_errors(column: "np.ndarray[Any, Any]", t: Array, error: Array, sigma: Array, unit: str) -> None:
    """Draw error and ±3 sigma, (n, 3) in `unit`, against `t` (n,) s, in one panel of `column` (3,) for each axis.

    All panels have one scale. It shows every error and ±3 times the largest median sigma; wider bands are cut off.
    """
    claim = 3.0 * float(np.max(np.nanmedian(sigma, axis=0)))
    limit = max(1.1 * float(np.nanmax(np.abs(error))), 1.3 * claim, 1e-9)
    for i, axes in enumerate(column):
        band = 3.0 * sigma[:, i]
        axes.fill_between(t, -band, band, color=_COLOURS[i], alpha=0.15, linewidth=0)
        axes.axhline(0.0, color=MUTED, linewidth=0.5)
        axes.plot(t, error[:, i], color=_COLOURS[i], linewidth=1.0)
        _quiet(axes)
        axes.set_ylim(-limit, limit)
        axes.set_ylabel(f"error {_AXES[i]}, {unit}")
        rms = np.sqrt(np.nanmean(error[:, i] ** 2))
        note = f"RMS {rms:.2g}{unit}" + (", band: ±3σ as claimed" if i == 0 else "")
        axes.annotate(note, (0.995, 0.97), xycoords="axes fraction", ha="right", va="top", fontsize=8, color=INK)


def _quiet(axes: "Axes") -> None:
    """Give axes a horizontal grid behind the curves, and narrow margins."""
    axes.grid(axis="y")
    axes.set_axisbelow(True)
    axes.margins(x=0.01)


def _gaps(t: Array) -> Array:
    """Return nan for frames after a step above 2.5 median steps, else 0, (n,). Added to a curve, it breaks it there."""
    step = np.diff(t, prepend=t[:1])
    usual = np.median(step[1:]) if len(t) > 1 else 0.0
    return np.where(step > 2.5 * usual, np.nan, 0.0) if usual > 0.0 else np.zeros(len(t))


def _unbroken(vectors: Array) -> Array:
    """Return rotation vectors, (n, 3), with nan where they jump by more than pi, which is no motion."""
    jump = np.linalg.norm(np.diff(vectors, axis=0, prepend=vectors[:1]), axis=1) > np.pi
    return np.where(jump[:, None], np.nan, vectors)
