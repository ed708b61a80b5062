"""Write a report, a guide or a print as one HTML file that needs no other.

The page is `page.html`, and `style.css` is the look of all: reports follow the reader's light or dark screen, all print
in black on white. A template of a report imports tables, figures and other blocks from `blocks.html`. All text except
`Markup` is escaped.
"""

import base64
import re
from functools import cache

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from spheremouse.files.report import style

_PACKAGE = "spheremouse.files.report"


def page(title: str, lead: str, body: Markup, foot: str = "", paper: str | None = None) -> str:
    """Return the whole file; for a `paper` ("A4", "Letter") a handout to print on it."""
    given = {"title": title, "lead": lead, "body": body, "foot": foot, "paper": paper}
    return str(render(_PACKAGE, "page.html", **given)) + "\n"


def render(package: str, name: str, **values: object) -> Markup:
    return Markup(_templates(package).get_template(name).render(values))


@cache
def _templates(package: str) -> Environment:
    """Return the template environment of a package; our shared templates are found, too."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package, ""), PackageLoader(_PACKAGE, "")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["worded"] = lambda text: Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))
    environment.filters["svg"] = style.of_figure
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    return environment
