"""A report, a guide or a print as one HTML file: blocks of text, tables and figures in, a page that needs no other out.

The page is `page.html`, the blocks are the macros of `blocks.html`, the look of all is `style.css`: reports follow the
reader's light or dark screen, all print in black on white. All text except `Markup` is escaped.
"""

import base64
import re
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from spheremouse.files.report import svg
from spheremouse.geometry.rotation import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HERE = "spheremouse.files.report"


def page(title: str, lead: str, blocks: Sequence[str], foot: str = "", paper: str | None = None) -> str:
    """The whole file; for a `paper` ("A4", "Letter") a handout to print on it."""
    given = {"title": title, "lead": lead, "blocks": blocks, "foot": foot, "paper": paper}
    return str(rendered(_HERE, "page.html", **given)) + "\n"


def section(heading: str, *blocks: str) -> Markup:
    """Blocks under a heading."""
    return _blocks().section(heading, blocks)


def paragraph(text: str) -> Markup:
    """Plain text; what stands between backticks is set as code."""
    return _blocks().paragraph(text)


def numbers(items: Sequence[tuple[str, str, str]]) -> Markup:
    """The few figures that matter most, large: what it is, its value, a remark."""
    return _blocks().numbers(items)


def advice(items: Sequence[tuple[str, str]]) -> Markup:
    """A list of ("good" | "note" | "warning", text)."""
    return _blocks().advice(items)


def table(head: Sequence[str], rows: Sequence[Sequence[str]], faulty: Sequence[bool] = (), text: int = 1) -> Markup:
    """A table. `faulty` rows are set in red; the first `text` columns hold words, the others figures."""
    bad = [*faulty, *[False] * (len(rows) - len(faulty))]
    return _blocks().table(head, list(zip(rows, bad, strict=True)), text)


def correlations(names: Sequence[str], matrix: Array) -> Markup:
    """The lower half of a correlation matrix, (n, n), each cell the fuller of colour the nearer it is to 1 or -1."""
    return _blocks().correlations(names, [matrix[i, :i].tolist() for i in range(1, len(names))])


def figure(drawing: "Figure", caption: str) -> Markup:
    """A figure of matplotlib as SVG that follows the page's colours; the caption is what a screen reader says, too."""
    return _blocks().figure(svg.of_figure(drawing, caption), caption)


def picture(data: bytes, caption: str, kind: str = "jpeg") -> Markup:
    """An encoded image, put into the page."""
    return _blocks().picture(kind, base64.b64encode(data).decode("ascii"), caption)


def beside(*blocks: str) -> Markup:
    """Blocks next to each other where the screen is wide enough."""
    return _blocks().beside(blocks)


def sheet(pictures: Sequence[str]) -> Markup:
    """Many small pictures."""
    return _blocks().sheet(pictures)


def rendered(package: str, name: str, **values: object) -> Markup:
    """A template of a package with values put in."""
    return Markup(_templates(package).get_template(name).render(values))


@cache
def _templates(package: str) -> Environment:
    environment = Environment(
        loader=PackageLoader(package, ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["worded"] = _worded
    return environment


def _blocks() -> Any:
    return _templates(_HERE).get_template("blocks.html").module


def _worded(text: str) -> Markup:
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))
