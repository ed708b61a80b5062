"""Words in figures that touch no other word, no mark and no line: set where they measure that there is room.

Names stand beside the ends of their lines, remarks beside points or along a line that goes all across, each with a thin
line to what it names where it stands apart from it. All is measured when the figure is drawn, for only then do axes
have their sizes.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from spheremouse.files.report.places import End, along, around

_NEAR = 4.0  # points from the edge of what is named


def label_ends(ax: Any, ends: Sequence[End]) -> None:
    """Names right of the axes, as near to the ends of their lines as they can be without touching."""
    from spheremouse.files.report.artists import Ends, put

    if ends:
        put(ax, Ends(ax, sorted(ends, key=lambda end: end.y)))


def label_points(ax: Any, points: Iterable[tuple[str, float, float]], radius: float = 3.0, **look: Any) -> None:
    """Words, x and y in data: each word beside its point, which is drawn so many points large."""
    from spheremouse.files.report.artists import words

    room = words(ax)
    for name, *named in points:
        room.add(name, lambda x, y, w, h: around(x, y, w, h, room.px(radius + _NEAR)), named, led=True, **look)


def label_level(ax: Any, y: float, name: str, side: str = "left", **look: Any) -> None:
    """A word on or under a line that goes all across at y, in data; as far to the side as there is room."""
    from spheremouse.files.report.artists import words

    room = words(ax)

    def places(_: float, y: float, w: float, h: float) -> Iterable[tuple[float, float]]:
        sides = (ax.bbox.x0, ax.bbox.x1) if side == "left" else (ax.bbox.x1, ax.bbox.x0)
        return along(*sides, y, w, h, room.px(0.4 * _NEAR))

    room.add(name, places, (ax.get_xlim()[0], y), led=False, **{"color": "0.5", **look})
