"""Style of figures: matplotlib with `light.mplstyle` and `dark.mplstyle`, the colours, and figures as `<svg>`."""

import io
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, MUTED, GRID, PAPER = "#2b2b2b", "#8a8a8a", "#e6e6e6", "#fefefd"
RED, GREEN, BLUE, GOLD = "#c8553d", "#3a7d5d", "#2f6690", "#b8860b"  # apart in grey and for most colour-blind eyes
_VARIABLES = {
    INK: "ink",
    MUTED: "muted",
    GRID: "grid",
    PAPER: "paper",
    BLUE: "blue",
    RED: "red",
    GREEN: "green",
    GOLD: "gold",
}


@contextmanager
def styled(*overrides: str | Mapping[str, Any]) -> Iterator[None]:
    """Use the light style of this package for figures that are made and saved in this block.

    `overrides` are names of further styles of this package ("dark"), or rcParams. Of several, the last one wins. Styles
    of a user's matplotlibrc have no effect.
    """
    from matplotlib import style

    sheets = [f"{__package__}.{s}" if isinstance(s, str) else s for s in ("light", *overrides)]
    with style.context(["default", *sheets]):  # type: ignore[list-item]
        yield


def round_number(most: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten up to `most`, for the magnification of a figure."""
    power = 10.0 ** math.floor(math.log10(most))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= most * (1.0 + 1e-9))


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
