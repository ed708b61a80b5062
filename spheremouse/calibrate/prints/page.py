"""A page to print at true scale: shapes in mm in, a vector PDF out.

Each page has a horizontal and a vertical ruler, to check the scale of the print. It needs matplotlib, which is loaded
when something is drawn.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Literal

import numpy as np

from spheremouse.files.report.style import styled
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure
    from matplotlib.text import Text

PAPERS = {  # mm, upright; those above a3 are for a copy shop
    "a4": (210.0, 297.0),
    "letter": (215.9, 279.4),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
}
BLACK, GREY = (0.0, 0.0, 0.0), (0.55, 0.55, 0.55)
HAIR = 0.1  # mm, a line to cut along

_PAGE_MARGIN_MM = 6.0  # mm; printers leave out up to 5
_LEFT, _BOTTOM = 17.0, 18.0  # mm, for rulers and words
_RULER_LENGTH = 100.0  # mm
_POINTS_PER_MM = 72.0 / 25.4
_PDF_STYLE = {"path.simplify": False, "path.snap": False, "pdf.fonttype": 3, "pdf.compression": 9}

Colour = tuple[float, float, float]  # RGB, 0 to 1


@dataclass(frozen=True, slots=True)
class Paper:
    """A sheet, upright or on its side. All lengths in mm from its lower left corner."""

    name: str
    width: float
    height: float

    @property
    def room(self) -> tuple[float, float, float, float]:
        """Left, bottom, right, top of the area free of rulers, words and printer margins."""
        return _LEFT, _BOTTOM, self.width - _PAGE_MARGIN_MM, self.height - _PAGE_MARGIN_MM


@dataclass(frozen=True, slots=True)
class Page:
    """Content of one sheet. Its shapes are made when it is drawn, in the style of prints."""

    paper: Paper
    title: str
    notes: tuple[str, ...]  # up to two lines below the title
    shapes: "Iterable[Artist]"  # each above those before it


def paper(name: str, *, wide: bool = False) -> Paper:
    """Return the paper of a name in PAPERS, upright or wide."""
    short, long = PAPERS[name]
    return Paper(name, long, short) if wide else Paper(name, short, long)


def pdf(pages: Sequence[Page], title: str) -> bytes:
    """Return the pages as a PDF file; the same pages give the same bytes on any date, with the same matplotlib."""
    file = BytesIO()
    about = {"Title": title, "Creator": "spheremouse", "Producer": None, "CreationDate": None}
    with styled(_PDF_STYLE):
        from matplotlib.backends.backend_pdf import PdfPages

        with PdfPages(file, metadata=about) as book:
            for page in pages:
                book.savefig(figure_of(page), facecolor="white")
    return file.getvalue()


def figure_of(page: Page) -> "Figure":
    """Return a page as a figure. Its data coordinates are mm of paper."""
    from matplotlib.figure import Figure

    w, h = page.paper.width, page.paper.height
    figure = Figure(figsize=(w / 25.4, h / 25.4))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, w), ylim=(0.0, h))
    axes.set_axis_off()
    for i, shape in enumerate((*page.shapes, *_rulers_and_text(page))):
        shape.set_zorder(i)
        axes.add_artist(shape)
    return figure


# ---- shapes, in mm ----


def disc(x: float, y: float, radius: float, colour: Colour = BLACK) -> "Artist":
    """Return a filled circle about (x, y) mm of the paper; `radius` in mm."""
    from matplotlib.patches import Circle

    return Circle((x, y), radius, facecolor=colour, linewidth=0.0)


def circle(x: float, y: float, radius: float, colour: Colour, width: float) -> "Artist":
    """Return a circular line about (x, y) mm of the paper; `radius` and `width` of the line in mm."""
    from matplotlib.patches import Circle

    return Circle((x, y), radius, fill=False, edgecolor=colour, linewidth=width * _POINTS_PER_MM)


def boxes(corners: Array) -> "Artist":
    """Return black upright rectangles, (n, 4): left, bottom, right, top. As one path they show no seam."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    x0, y0, x1, y1 = corners.T
    outlines = np.stack([np.stack([x0, x1, x1, x0, x0], axis=1), np.stack([y0, y0, y1, y1, y0], axis=1)], axis=2)
    path = Path.make_compound_path(*(Path(outline, closed=False) for outline in outlines))
    return PathPatch(path, facecolor=BLACK, linewidth=0.0)


def lines(ends: Array | Sequence[Sequence[float]], width: float = HAIR, colour: Colour = GREY) -> "Artist":
    """Return separate straight lines, (n, 4): x, y, x, y."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    points = np.array(ends, dtype=float).reshape(-1, 2)
    path = Path(points, np.tile([Path.MOVETO, Path.LINETO], len(points) // 2))
    return PathPatch(path, fill=False, edgecolor=colour, linewidth=width * _POINTS_PER_MM, capstyle="butt")


def text_line(
    x: float,
    y: float,
    text: str,
    size: float,
    align: Literal["left", "center", "right"] = "left",
    bold: bool = False,
    max_width: float | None = None,
) -> "Text":
    """Return a line of text with its baseline at x, y mm. `size` is its height, mm.

    A line wider than `max_width` mm gets a smaller size.
    """
    from matplotlib.font_manager import FontProperties
    from matplotlib.text import Text
    from matplotlib.textpath import TextPath

    font = FontProperties(weight="bold" if bold else "normal")
    if max_width is not None and text:
        size *= min(1.0, max_width / float(TextPath((0.0, 0.0), text, size=size, prop=font).get_extents().x1))
    font.set_size(size * _POINTS_PER_MM)
    look = {"ha": align, "va": "baseline", "rotation_mode": "anchor", "parse_math": False}
    return Text(x, y, text, fontproperties=font, color=BLACK, **look)


# ---- rulers and words of every page ----

CHECK = "Both rulers must be 100 mm: print at 100 % (actual size), no “fit to page”."


def _rulers_and_text(page: Page) -> "Iterator[Artist]":
    """Yield the rulers, with the request to check them below, and to their right the page's title and notes."""
    x, y = _LEFT, 9.0
    yield from _ruler(x, y)
    yield from _ruler(x - 4.0, y, upwards=True)
    right = x + _RULER_LENGTH + 6.0
    max_width = page.paper.width - _PAGE_MARGIN_MM - right
    title = f"{page.title}, {page.paper.name.capitalize()}"
    yield text_line(right, 13.2, title, 3.3, bold=True, max_width=max_width)
    for k, note in enumerate(page.notes):
        yield text_line(right, 9.6 - 3.2 * k, note, 2.4, max_width=max_width)
    yield text_line(x, 6.3, CHECK, 2.3, max_width=_RULER_LENGTH)


def _ruler(x: float, y: float, upwards: bool = False) -> "Iterator[Artist]":
    """100 mm from x, y to the right, marks above it; or upwards, marks to the left."""
    mm = np.arange(_RULER_LENGTH + 1.0)
    length = np.where(mm % 10 == 0, 3.6, np.where(mm % 5 == 0, 2.7, 1.8))
    marks = np.stack([mm, 0.0 * mm, mm, length], axis=1)
    ends = np.vstack([marks, [0.0, 0.0, _RULER_LENGTH, 0.0]])
    if upwards:  # a quarter turn
        ends = ends[:, [1, 0, 3, 2]] * [-1.0, 1.0, -1.0, 1.0]
    yield lines(ends + np.array([x, y, x, y]), 0.12, BLACK)
    for cm in range(0, int(_RULER_LENGTH) + 1, 10):
        unit = " mm" if cm == _RULER_LENGTH else ""
        at = (x - 4.3, y + cm) if upwards else (x + cm, y + 4.3)
        label = text_line(*at, f"{cm}{unit}", 1.9, "center")
        label.set_rotation(90.0 if upwards else 0.0)
        yield label
