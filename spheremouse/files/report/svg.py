"""Figures of matplotlib as `<svg>` elements of a page, with colours that follow the page's theme."""

import io
import re
from typing import TYPE_CHECKING

from markupsafe import Markup

from spheremouse.files.report.style import BLUE, GOLD, GREEN, GRID, INK, MUTED, PAPER, RED, styled

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
