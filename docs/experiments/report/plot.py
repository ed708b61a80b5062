"""Style of the figures: quiet axes, and colours that colour-blind eyes tell apart.

matplotlib is loaded when something is drawn. The style is that of `files/report`; the colours of curves
are those of Okabe and Ito (2008), and they differ in their dashes as well.
"""

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spheremouse.files.report.style import styled
from spheremouse.files.safe_files import write_atomically

BOUND, THESIS = {"linestyle": ":", "linewidth": 1.2}, {"linestyle": "--", "linewidth": 1.0}  # how these are drawn
_OVER = {
    "axes.grid": True,
    "axes.prop_cycle": 'cycler("color", ["0072B2", "D55E00", "009E73", "CC79A7", "56B4E9", "E69F00"])'
    '+ cycler("linestyle", ["-", (0, (5, 1.5)), (0, (1.5, 1)), (0, (6, 1.5, 1, 1.5)), (0, (3, 1)), "-"])',
    "text.parse_math": True,
}


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure and the function that draws it."""

    name: str  # of its file
    draw: Callable[[Any], None]  # on a matplotlib figure
    size: tuple[float, float] = (7.2, 3.4)  # inches


def save(figure: Drawing, folder: Path) -> Path:
    """Write NAME.svg into a folder. The same data give the same bytes."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure as Canvas

    folder.mkdir(parents=True, exist_ok=True)
    with styled("light", _OVER):
        canvas = Canvas(figsize=figure.size, layout="constrained")
        FigureCanvasSVG(canvas)
        figure.draw(canvas)
        text = io.StringIO()
        canvas.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    path = folder / f"{figure.name}.svg"
    write_atomically(path, re.sub(r"[ \t]+$", "", text.getvalue(), flags=re.MULTILINE))
    return path


def plain_numbers(axis: Any) -> None:
    """0.01, 0.1, 1 in place of powers of ten; few others where there is less than a decade."""
    from matplotlib.ticker import LogFormatter, StrMethodFormatter

    class Few(LogFormatter):
        def _num_to_string(self, x: float, vmin: float, vmax: float) -> str:
            return f"{x:g}"

    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(Few(minor_thresholds=(1.5, 0.7)))


def decades(axis: Any, within: tuple[float, ...] = (1.0, 3.0), most: int | None = None) -> None:
    """The same, at these places of each decade and no others; at most so many."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=within, numticks=most))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())
