"""Drawings as `<svg>` elements of a page: figures of matplotlib, with colours that follow the page's theme, and others.

Handouts build their drawings from elements, since they must work without matplotlib.
"""

import io
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from spheremouse.files.report.style import BLUE, GOLD, GREEN, GRID, INK, MUTED, PAPER, RED, styled
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_VARIABLES = {
    INK: "ink",
    MUTED: "muted",
    GRID: "grid",
    PAPER: "paper",
    BLUE: "blue",
    RED: "red",
    GREEN: "green",
    GOLD: "gold",
}  # of style.css


def of_figure(figure: "Figure", label: str) -> Markup:
    """Return a figure with variables of the page as its colours. `label` is the text for a screen reader."""
    file = io.StringIO()
    with styled({"svg.fonttype": "none"}):  # words stay words
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    text = file.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text[text.index("<svg") :], flags=re.DOTALL)
    for colour, variable in _VARIABLES.items():
        text = text.replace(colour, f"var(--{variable})")
    opening = Markup('<svg role="img" aria-label="{}" ').format(label)
    return Markup(text.replace("<svg ", opening, 1))


def drawing(width: float, height: float, label: str, parts: Iterable[Markup], class_: str = "drawing") -> Markup:
    """Return an `<svg>` of this size in units, x to the right and y down. `label` is the text for a screen reader."""
    inside = Markup("\n").join(("", *parts))
    return element("svg", inside, class_=class_, viewBox=f"0 0 {width:g} {height:g}", role="img", aria_label=label)


def element(tag: str, inside: str = "", /, **attributes: str | float | Array) -> Markup:
    """One element: `class_` is class, font_size is font-size; numbers to hundredths, points (n, 2) as "x,y x,y"."""
    pairs = ((name.rstrip("_").replace("_", "-"), _written(value)) for name, value in attributes.items())
    opening = Markup("").join(Markup(' {}="{}"').format(name, value) for name, value in pairs)
    return Markup("<{0}{1}>{2}</{0}>").format(tag, opening, inside)


def _written(value: str | float | Array) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, np.ndarray) and value.ndim:
        return " ".join(f"{x:.2f},{y:.2f}" for x, y in value)
    return f"{round(float(value), 2) + 0.0:g}"
