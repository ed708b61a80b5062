"""The documentation site, with the pages that are made from the code: modules, command line, picture.

They are written to _build/generated before Sphinx reads the pages that include them. What the package does not have
yet is left out and the page says so; what it has must be right, for the build treats warnings as errors.
"""

import dataclasses
import importlib
import importlib.metadata
import importlib.util
import inspect
import os
import pkgutil
import re
import textwrap
import tomllib
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
GENERATED = HERE / "_build" / "generated"

project = "spheremouse"
release = importlib.metadata.version("spheremouse")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.doctest", "sphinx.ext.viewcode"]
exclude_patterns = ["_build", "figures.md"]  # figures.md is included by accuracy
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

# The rooms from the ground up, as import-linter holds them. Those named here are the shell, and not in the reference,
# which is for those who call the core.
SHELL = {"__main__", "commands", "experiments", "session", "capture", "files"}


def core() -> list[str]:
    """Names of the core's rooms."""
    tools = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    layers = next(c["layers"] for c in tools["importlinter"]["contracts"] if c["id"] == "layers")
    return [room for layer in reversed(layers) for room in re.findall(r"\w+", layer) if room not in SHELL]


def page(name: str, text: str) -> None:
    """Write a generated page, only if it differs: Sphinx goes by dates."""
    path = GENERATED / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text() != text:
        path.write_text(text)


def exists(module: str) -> bool:
    """Whether the package has such a module; one that exists and fails to import is an error, not absent."""
    return importlib.util.find_spec(module) is not None


def core_modules() -> list[str]:
    """Names of the core's modules."""
    import spheremouse

    names = [m.name for m in pkgutil.walk_packages(spheremouse.__path__, "spheremouse.")]
    rooms = core()
    return sorted((n for n in names if n.split(".")[1] in rooms), key=lambda n: (rooms.index(n.split(".")[1]), n))


def modules_page() -> str:
    """The reference: one section a module."""
    parts = []
    for name in core_modules():
        parts.append(f"## {name}\n\n```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n```\n")
    return "\n".join(parts)


def command_line_page() -> str:
    """`--help` of every command."""
    if not exists("spheremouse.commands"):
        return "*Not in this version yet.*\n"
    import typer.main
    import typer.testing

    cli = importlib.import_module("spheremouse.commands")
    app = next(value for value in vars(cli).values() if isinstance(value, typer.Typer))
    runner = typer.testing.CliRunner(env={"COLUMNS": "100", "TERMINAL_WIDTH": "100", "NO_COLOR": "1", "TERM": "dumb"})

    def pages(command: Any, words: list[str]) -> list[str]:
        result = runner.invoke(app, [*words, "--help"], prog_name="spheremouse")
        if result.exit_code != 0:
            raise RuntimeError(f"spheremouse {' '.join(words)} --help failed: {result.output}")
        text = "\n".join(line.rstrip() for line in result.output.strip("\n").splitlines())
        here = [f"## {' '.join(['spheremouse', *words])}\n\n```text\n{text}\n```\n"]
        for name, sub in getattr(command, "commands", {}).items():
            if not sub.hidden:
                here += pages(sub, [*words, name])
        return here

    return "\n".join(pages(typer.main.get_command(app), []))


def picture_page() -> str:
    """The picture of the README where it was made."""
    if (HERE / "images" / "overlay.jpg").exists():
        return (
            "```{figure} /images/overlay.jpg\n"
            "A frame with the contours of the detected discs in white, the targets in green and the predicted discs in "
            "red, the last epochs fading. Made by `make picture`.\n```\n"
        )
    return "*`make picture` makes the picture that belongs here.*\n"


def plain_docstring(lines: list[str]) -> list[str]:
    """Docstrings are plain text, written to be read in the source: make them literal for reStructuredText.

    Paragraphs stay paragraphs, `names` become code, what is indented stays as it stands, examples stay examples.
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
    """A dataclass's fields are told once, by `fields`; slots and aliases of imported types are no news."""
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
    """Make the generated pages, then hook into autodoc."""
    os.environ.setdefault("MPLBACKEND", "Agg")
    page("modules.md", modules_page())
    page("command-line.md", command_line_page())
    page("picture.md", picture_page())
    app.connect("doctree-read", twins, priority=100)  # before pictures are collected
    app.connect("autodoc-process-docstring", document)
    app.connect("autodoc-process-signature", shorten)
    app.connect("autodoc-skip-member", skip)
