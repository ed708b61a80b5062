"""A page to print at true scale: shapes in mm in, a vector PDF out.

Each page has a horizontal and a vertical ruler, to check the scale of the print. It needs matplotlib, which is loaded
when something is drawn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from spheremouse.files.report.style import styled
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPERS = {"a4": (210.0, 297.0), "letter": (215.9, 279.4), "a3": (297.0, 420.0)}  # mm, upright
BLACK, GREY = (0.0, 0.0, 0.0), (0.55, 0.55, 0.55)
HAIR = 0.1  # mm, a line to cut along

_MARGIN = 6.0  # mm; printers leave out up to 5
_LEFT, _BOTTOM = 17.0, 18.0  # mm, for rulers and words
_RULER_LENGTH = 100.0  # mm
_POINTS_PER_MM = 72.0 / 25.4
_PDF_STYLE = {"path.simplify": False, "path.snap": False, "pdf.fonttype": 3, "pdf.compression": 9}

Colour = tuple[float, float, float]  # RGB, 0 to 1


@dataclass(frozen=True, slots=True)
class Circle:
    """A disc, or a circle of a line width."""

    x: float  # mm
    y: float
    radius: float
    colour: Colour = BLACK
    line: float | None = None  # mm


@dataclass(frozen=True, slots=True)
class Boxes:
    """Filled upright rectangles, drawn as one path: no seam shows where they touch."""

    corners: Array  # (n, 4) mm: left, bottom, right, top
    colour: Colour = BLACK


@dataclass(frozen=True, slots=True)
class Lines:
    """Separate straight lines."""

    ends: Array  # (n, 2, 2) mm: line, end, x and y
    width: float = HAIR  # mm
    colour: Colour = GREY


@dataclass(frozen=True, slots=True)
class Words:
    """One line of text, its baseline at x, y."""

    x: float  # mm
    y: float
    text: str
    size: float = 2.5  # mm, of a capital's body
    bold: bool = False
    align: Literal["left", "center", "right"] = "left"
    upwards: bool = False
    colour: Colour = BLACK
    max_width: float | None = None  # mm, width; a longer text is set smaller


Shape = Circle | Boxes | Lines | Words


@dataclass(frozen=True, slots=True)
class Paper:
    """A sheet, upright or on its side. All lengths in mm from its lower left corner."""

    name: str
    width: float
    height: float

    @property
    def room(self) -> tuple[float, float, float, float]:
        """Left, bottom, right, top of the area free of rulers, words and printer margins."""
        return _LEFT, _BOTTOM, self.width - _MARGIN, self.height - _MARGIN


@dataclass(frozen=True, slots=True)
class Page:
    """Content of one sheet."""

    paper: Paper
    title: str
    notes: tuple[str, ...]  # up to two lines below the title
    shapes: tuple[Shape, ...] = field(default_factory=tuple)


def paper(name: str, *, wide: bool = False) -> Paper:
    """Return the paper of a name in PAPERS, upright or wide."""
    short, long = PAPERS[name]
    return Paper(name, long, short) if wide else Paper(name, short, long)


def pdf(pages: Sequence[Page], title: str) -> bytes:
    """Return the pages as a PDF file; the same pages give the same bytes on any date and machine."""
    file = BytesIO()
    about = {"Title": title, "Creator": "spheremouse", "Producer": None, "CreationDate": None}
    with styled(_PDF_STYLE):
        from matplotlib.backends.backend_pdf import PdfPages

        with PdfPages(file, metadata=about) as book:
            for page in pages:
                book.savefig(_figure(page), facecolor="white")
    return file.getvalue()


def _figure(page: Page) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(page.paper.width / 25.4, page.paper.height / 25.4))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, page.paper.width), ylim=(0.0, page.paper.height))
    axes.set_axis_off()
    for i, shape in enumerate((*page.shapes, *_furniture(page))):
        artist = _artist(shape)
        artist.set_zorder(i)  # above those before it
        axes.add_artist(artist)
    return figure


def _artist(shape: Shape) -> Any:
    from matplotlib import patches
    from matplotlib.path import Path
    from matplotlib.text import Text

    if isinstance(shape, Words):
        return Text(
            shape.x,
            shape.y,
            shape.text,
            color=shape.colour,
            fontsize=_size(shape) * _POINTS_PER_MM,
            fontweight="bold" if shape.bold else "normal",
            horizontalalignment=shape.align,
            verticalalignment="baseline",
            rotation=90.0 if shape.upwards else 0.0,
            rotation_mode="anchor",
            parse_math=False,
        )
    if isinstance(shape, Circle):
        if shape.line is None:
            return patches.Circle((shape.x, shape.y), shape.radius, facecolor=shape.colour, linewidth=0.0)
        width = shape.line * _POINTS_PER_MM
        return patches.Circle((shape.x, shape.y), shape.radius, fill=False, edgecolor=shape.colour, linewidth=width)
    if isinstance(shape, Boxes):
        x0, y0, x1, y1 = shape.corners.T
        polygons = np.stack([np.stack([x0, x1, x1, x0], axis=1), np.stack([y0, y0, y1, y1], axis=1)], axis=2)
        path = Path.make_compound_path(*(Path(p, closed=False) for p in _closed(polygons)))
        return patches.PathPatch(path, facecolor=shape.colour, linewidth=0.0)
    path = Path(shape.ends.reshape(-1, 2), np.tile([Path.MOVETO, Path.LINETO], len(shape.ends)))
    width = shape.width * _POINTS_PER_MM
    return patches.PathPatch(path, fill=False, edgecolor=shape.colour, linewidth=width, capstyle="butt")


def _size(words: Words) -> float:
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    if words.max_width is None or not words.text:
        return words.size
    font = FontProperties(weight="bold" if words.bold else "normal")
    wide = float(TextPath((0.0, 0.0), words.text, size=words.size, prop=font).get_extents().x1)
    return words.size * min(1.0, words.max_width / wide)


def _closed(polygons: Array) -> Iterator[Array]:
    yield from np.concatenate([polygons, polygons[:, :1]], axis=1)


# ---- rulers and words of every page ----


def _furniture(page: Page) -> Iterator[Shape]:
    x, y = _LEFT, 9.0
    yield from _ruler(x, y)
    yield from _ruler(x, y, upwards=True)
    wording = x + _RULER_LENGTH + 6.0
    max_width = page.paper.width - _MARGIN - wording
    title = f"{page.title}, {page.paper.name.capitalize()}"
    yield Words(wording, 13.2, title, size=3.3, bold=True, max_width=max_width)
    for k, note in enumerate(page.notes):
        yield Words(wording, 9.6 - 3.2 * k, note, size=2.4, max_width=max_width)
    yield Words(x, 6.3, CHECK, size=2.3, max_width=_RULER_LENGTH)


CHECK = "Both rulers must be 100 mm: print at 100 % (actual size), no “fit to page”."


def _ruler(x: float, y: float, upwards: bool = False) -> Iterator[Shape]:
    """100 mm from x, y to the right, marks above it; or upwards, marks to the left."""
    mm = np.arange(_RULER_LENGTH + 1.0)
    length = np.where(mm % 10 == 0, 3.6, np.where(mm % 5 == 0, 2.7, 1.8))
    if upwards:
        x -= 4.0
        foot, head = np.stack([0.0 * mm, mm], axis=1), np.stack([-length, mm], axis=1)
        base = np.array([[[0.0, 0.0], [0.0, _RULER_LENGTH]]])
    else:
        foot, head = np.stack([mm, 0.0 * mm], axis=1), np.stack([mm, length], axis=1)
        base = np.array([[[0.0, 0.0], [_RULER_LENGTH, 0.0]]])
    origin = np.array([x, y])
    yield Lines(np.concatenate([np.stack([foot, head], axis=1), base]) + origin, 0.12, BLACK)
    for cm in range(0, int(_RULER_LENGTH) + 1, 10):
        unit = " mm" if cm == _RULER_LENGTH else ""
        at = (x - 4.3, y + cm) if upwards else (x + cm, y + 4.3)
        yield Words(*at, f"{cm}{unit}", size=1.9, align="center", upwards=upwards)


def lines(ends: Array | Sequence[Sequence[float]], width: float = HAIR, colour: Colour = GREY) -> Lines:
    """Return lines of (x, y, x, y) in mm."""
    return Lines(np.array(ends, dtype=float).reshape(-1, 2, 2), width, colour)
