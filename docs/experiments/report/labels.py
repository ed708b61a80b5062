"""Names in a figure: of lines by their ends, of points, and of a horizontal line."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from matplotlib.lines import Line2D

_SIZE = 8.0  # points, of letters
_GAP = 4.0  # points between a point or a line and its name


class End(NamedTuple):
    """Name of a line, its last value in data, and its colour."""

    name: str
    y: float
    colour: Any


def label_ends(ax: Any, ends: Sequence[End]) -> None:
    """List the names of lines right of the axes, in the order of their ends."""
    lines = [Line2D([], [], color=e.colour, label=e.name) for e in sorted(ends, key=lambda end: -end.y)]
    if lines:
        look = {"labelcolor": "linecolor", "fontsize": _SIZE, "frameon": False, "handlelength": 0.8}
        ax.legend(handles=lines, loc="center left", bbox_to_anchor=(1.0, 0.5), **look)


def label_points(ax: Any, points: Iterable[tuple[str, float, float]], radius: float = 3.0, **look: Any) -> None:
    """Write a name above each point (name, x, y in data), whose mark has this radius in points."""
    look = {"va": "bottom", "ha": "center", "fontsize": _SIZE, **look}
    for name, *at in points:
        ax.annotate(name, at, xytext=(0.0, radius + _GAP), textcoords="offset points", **look)


def label_level(ax: Any, y: float, name: str, side: str = "left", **look: Any) -> None:
    """Write the name of a horizontal line at y, in data, on its left or right end."""
    x, shift = (0.0, _GAP) if side == "left" else (1.0, -_GAP)
    look = {"va": "bottom", "ha": side, "fontsize": _SIZE, "color": "0.5", **look}
    at, offset = ("axes fraction", "data"), {"xytext": (shift, 0.4 * _GAP), "textcoords": "offset points"}
    ax.annotate(name, (x, y), xycoords=at, **offset, **look)
