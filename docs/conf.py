"""Documentation site: the pages, and the modules of the core from their docstrings."""

import dataclasses
import importlib.metadata
import inspect
import os
import re
import sys
import textwrap
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import reference  # noqa: E402

project = "spheremouse"
release = importlib.metadata.version("spheremouse")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.doctest"]
if "CI" not in os.environ:  # viewcode takes a third of the time, and .ci/run only checks the site
    extensions.append("sphinx.ext.viewcode")
exclude_patterns = ["_build", "figures.md", "experiments"]  # figures.md is included by accuracy
source_suffix = {".md": "markdown"}
myst_enable_extensions = ["deflist", "colon_fence"]
myst_heading_anchors = 3
nitpicky = False
suppress_warnings = ["ref.python"]  # two rooms may each have a View; annotations in quotes are no links then

html_theme = "furo"
html_title = "spheremouse"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
smartquotes = False
# Titles are enough: every page carries the tree of all, which had thousands of names in it (half of the time to build).
toc_object_entries = False

doctest_global_setup = """
import numpy as np
from scipy.spatial.transform import Rotation
np.set_printoptions(precision=6, suppress=True)
"""


def append_generated(_app: Any, name: str, source: list[str]) -> None:
    """Append all modules of the core, and the commands, to their pages."""
    if name == "modules":
        for module in reference.core_modules():
            source[0] += f"\n## {module}\n\n```{{eval-rst}}\n.. automodule:: {module}\n   :members:\n```\n"
    elif name == "command-line":
        source[0] += reference.command_line()


def plain_docstring(lines: list[str]) -> list[str]:
    """Docstrings are plain text, written to be read in the source: make them literal for reStructuredText.

    Paragraphs, indented text and examples keep their form, and `names` become code.
    """
    out: list[str] = []
    for paragraph in re.split(r"\n[ \t]*\n", "\n".join(lines).strip("\n")):
        rows = paragraph.split("\n")
        if rows[0].lstrip().startswith(">>>"):
            out += [*rows, ""]
        elif any(row.startswith((" ", "-")) for row in rows):
            out += ["::", "", *("    " + row for row in rows), ""]
        else:
            # A backslash takes a mark's meaning, and with a space after it vanishes: no line begins with a mark, and
            # code stands against anything, as in `obj`'s.
            pieces = re.split(r"(`[^`]+`)", paragraph)
            literal = [rf"\ `{p}`\ " if i % 2 else re.sub(r"([\\*|_`:])", r"\\\1", p) for i, p in enumerate(pieces)]
            out += [*(rf"\ {row}" for row in "".join(literal).split("\n")), ""]
    return out


def fields(cls: type) -> list[str]:
    """One line a field: its shape, unit and frame, which stand in a comment beside it or in its `settings.param`."""
    comments = dict(re.findall(r"^    (\w+): [^#\n]*?# (.*)$", textwrap.dedent(inspect.getsource(cls)), re.MULTILINE))
    rows = []
    for field in dataclasses.fields(cls):
        if "meaning" in field.metadata:
            unit = "" if field.metadata["unit"] == "-" else f" {field.metadata['unit']}"
            default = "none" if field.default is None else f"{field.default}{unit}"
            meaning = field.metadata["meaning"]
            told = unit.strip() if "[default: " in meaning else f"default {default}"
            meaning += f" ({told})" if told else ""
        else:
            meaning = comments.get(field.name, "")
        rows.append(f"    {field.name}: {meaning}" if meaning else f"    {field.name}")
    return ["Fields::", "", *rows, ""] if rows else []


def document(_app: Any, what: str, _name: str, obj: Any, _options: Any, lines: list[str]) -> None:
    """Docstrings as they are written, dataclasses with their fields."""
    record = isinstance(obj, type) and what == "class" and dataclasses.is_dataclass(obj)
    undocumented = record and (obj.__doc__ or "").startswith(f"{obj.__name__}(")  # what `dataclass` writes by itself
    lines[:] = ([] if undocumented else plain_docstring(lines)) + (fields(obj) if record else [])


def skip(_app: Any, what: str, name: str, obj: Any, would_skip: bool, _options: Any) -> bool | None:
    """A dataclass's fields appear once, by `fields`; slots and aliases of imported types are no news."""
    if what == "class" and (inspect.ismemberdescriptor(obj) or not (callable(obj) or isinstance(obj, property))):
        return True
    return True if name.startswith("_") else (would_skip or None)


def shorten(_app: Any, _what: str, _name: str, _obj: Any, _options: Any, signature: str, returns: str) -> Any:
    """Signatures as they are written: `Array`, not what it stands for."""
    array = r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[~?(?:numpy\.)?(\w+)\]\]"

    def short(text: str | None) -> str | None:
        return text and re.sub(array, lambda m: "Array" if m[1] == "float64" else f"NDArray[{m[1]}]", text)

    return short(signature), short(returns)


def twins(_app: Any, doctree: Any) -> None:
    """A picture NAME-light of a page in plain Markdown is joined by its twin NAME-dark, for dark screens."""
    from docutils import nodes

    for light in list(doctree.findall(nodes.image)):
        if "-light." in light["uri"] and "only-light" not in (*light["classes"], *light.parent["classes"]):
            dark = light.deepcopy()
            dark["uri"] = light["uri"].replace("-light.", "-dark.")
            light["classes"].append("only-light")
            dark["classes"].append("only-dark")
            light.parent.insert(light.parent.index(light) + 1, dark)


def setup(app: Any) -> None:
    """Hook into Sphinx."""
    os.environ.setdefault("MPLBACKEND", "Agg")
    app.connect("source-read", append_generated)
    app.connect("doctree-read", twins, priority=100)  # before pictures are collected
    app.connect("autodoc-process-docstring", document)
    app.connect("autodoc-process-signature", shorten)
    app.connect("autodoc-skip-member", skip)
