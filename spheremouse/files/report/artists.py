"""Words of a figure that find their places when it is drawn, as artists of matplotlib.

What they keep clear of, all in px: the edge of the axes, other words, marks, lines; in this order.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.lines import Line2D
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from spheremouse.files.report.places import End, apart

Places = Callable[[float, float, float, float], Iterable[tuple[float, float]]]  # of x, y, width, height; px

_SIZE = 8.0  # points, of letters
_NEAR = 4.0  # points from the end of a line to what leads on to its name
_BESIDE = 11.0  # points from axes to the names of lines
_FAR = 12.0  # points from a remark to its point, from where on a line leads there
_CLEAR = 2.0  # points around marks: beside another's mark a word seems to be that one's
_LEADER = {"linewidth": 0.6, "alpha": 0.8, "linestyle": "-"}
_OUT, _WORD, _MARK, _LINE, _BY = 1e4, 1e3, 1e2, 1e1, 1.0  # what it costs to stick out of the axes, to touch a word, ...


class Ends(Artist):
    """Names of lines, ascending, beside their ends."""

    def __init__(self, ax: Any, ends: Sequence[End]) -> None:
        super().__init__()
        self._ax, self._ends = ax, ends
        look = {"va": "center", "ha": "left", "fontsize": _SIZE}
        self._texts = [Text(0.0, 0.0, name, color=colour, figure=ax.figure, **look) for name, _, colour, _ in ends]

    def get_tightbbox(self, renderer: Any = None) -> Bbox:
        """The room right of the axes that the layout keeps for them."""
        box, width = self._ax.bbox, max(text.get_window_extent(renderer).width for text in self._texts)
        return Bbox([[box.x1, box.y0], [box.x1 + _px(self._ax, _BESIDE) + width, box.y1]])

    def draw(self, renderer: Any) -> None:
        """Where they are, of axes that have their size."""
        ax, box = self._ax, self._ax.bbox
        left = box.x1 + _px(ax, _BESIDE)
        starts = [self._end(end) for end in self._ends]
        heights = [text.get_window_extent(renderer).height for text in self._texts]
        places = apart([y for _, y in starts], heights, box.y0, box.y1)
        for text, end, (x, y), at in zip(self._texts, self._ends, starts, places, strict=True):
            text.set_position((left, at))
            text.draw(renderer)
            start = x if end.x is None else x + _px(ax, _NEAR)
            _lead(ax, renderer, (start, y), (left - _px(ax, 2.0), at), end.colour)

    def _end(self, end: End) -> tuple[float, float]:
        """px; within the axes."""
        ax = self._ax
        x, y = ax.transData.transform((ax.get_xlim()[1] if end.x is None else end.x, end.y))
        return min(x, ax.bbox.x1), float(np.clip(y, ax.bbox.y0, ax.bbox.y1))


@dataclass(frozen=True, slots=True)
class _Word:
    text: Text
    places: Places  # that it may have, the better first
    named: Sequence[float]  # x, y in data
    led: bool  # whether a line leads from there


class Words(Artist):
    """Remarks within axes, each in the first of its places where it touches the least."""

    def __init__(self, ax: Any) -> None:
        super().__init__()
        self._ax, self._words = ax, list[_Word]()
        self.set_in_layout(False)
        self.set_zorder(6.0)  # over lines

    def px(self, points: float) -> float:
        """Points in px."""
        return _px(self._ax, points)

    def add(self, name: str, places: Places, named: Sequence[float], *, led: bool, **look: Any) -> None:
        """Another word."""
        look = {"va": "center", "ha": "center", "fontsize": _SIZE, **look}
        self._words.append(_Word(Text(0.0, 0.0, name, figure=self._ax.figure, **look), places, named, led))

    def draw(self, renderer: Any) -> None:
        """Where they are, of axes that have their size."""
        marks, lines = _drawn(self._ax)
        said = [text.get_window_extent(renderer) for text in self._ax.texts]
        for word in self._words:
            size, named = word.text.get_window_extent(renderer), self._ax.transData.transform(word.named)
            w, h = size.width, size.height
            found = [_box(x, y, w, h) for x, y in word.places(named[0], named[1], w, h)]
            cost = [_cost(box, self._ax.bbox, said, marks, lines, self.px(_CLEAR)) for box in found]
            box = found[int(np.argmin(cost))]
            said.append(box.padded(self.px(_CLEAR)))
            nearest = np.clip(named, box.min, box.max)
            if word.led and np.hypot(*(nearest - named)) > self.px(_FAR):
                _lead(self._ax, renderer, named, nearest, word.text.get_color())
            word.text.set_position((0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1)))
            word.text.draw(renderer)


def put(ax: Any, artist: Any) -> Any:
    """An artist added to axes."""
    ax.add_artist(artist)
    artist.set_clip_on(False)  # what is clipped to the axes has no say in the layout
    return artist


def words(ax: Any) -> Words:
    """Those of the axes: all of them find their places together."""
    there = next((artist for artist in ax.artists if isinstance(artist, Words)), None)
    return there or put(ax, Words(ax))


# ---- what is there already ----


def _drawn(ax: Any) -> tuple[list[Bbox], list[Path]]:
    """Boxes of marks, and lines, px."""
    boxes, paths = [], []
    for line in ax.lines:
        path = line.get_transform().transform_path(line.get_path())
        if line.get_marker() not in ("", " ", "None", None):
            boxes += _marks(path.vertices, _px(ax, 0.5 * line.get_markersize()))
        if line.get_linestyle() not in ("", " ", "None"):
            paths.append(path)
    for collection in ax.collections:
        if isinstance(collection, PathCollection):
            places = collection.get_offset_transform().transform(collection.get_offsets())
            boxes += _marks(places, _px(ax, 0.5 * float(np.sqrt(np.max(collection.get_sizes())))))
        elif isinstance(collection, LineCollection):
            paths += [collection.get_transform().transform_path(path) for path in collection.get_paths()]
    return boxes, paths


def _marks(places: Any, half: float) -> list[Bbox]:
    return [_box(x, y, 2.0 * half, 2.0 * half) for x, y in places if np.isfinite(x + y)]


def _box(x: float, y: float, w: float, h: float) -> Bbox:
    return Bbox.from_bounds(x - 0.5 * w, y - 0.5 * h, w, h)


def _cost(
    box: Bbox, axes: Bbox, said: Sequence[Bbox], marks: Sequence[Bbox], lines: Sequence[Path], clear: float
) -> float:
    out = box.x0 < axes.x0 or box.y0 < axes.y0 or box.x1 > axes.x1 or box.y1 > axes.y1
    touched = _WORD * box.count_overlaps(said) + _MARK * box.count_overlaps(marks)
    crossed = _LINE * sum(path.intersects_bbox(box, filled=False) for path in lines)
    return _OUT * out + touched + crossed + _BY * box.padded(clear).count_overlaps(marks)


def _px(ax: Any, points: float) -> float:
    return points * ax.figure.dpi / 72.0


def _lead(ax: Any, renderer: Any, start: Any, end: Any, colour: Any) -> None:
    """A thin line from px to px."""
    line = Line2D(*np.array([start, end]).T, color=colour, **_LEADER)
    line.set_figure(ax.figure)
    line.draw(renderer)
