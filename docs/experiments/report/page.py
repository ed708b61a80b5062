"""A page of Markdown written by hand, `NAME.md.jinja`, with the numbers of a run put in, and the numbers as JSON.

A template (Jinja2) has the words; `NAME.py` beside it gives what they name: numbers, tables, figures. In a template
`{{ x | fixed(2) }}` is a number with two digits, `{{ figure("name", "caption") }}` a picture, and what follows
`{{ shown(a < b) }}` is a claim that the page marks where a run does not bear it out.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from experiments.kit.job import Result, Results
from experiments.report.plot import Drawing, save
from spheremouse import __version__
from spheremouse.files.safe_files import write_atomically, write_json

MISSING = "–"
_NOT_SHOWN = "**Not borne out by this run:** "


class Page(NamedTuple):
    """Values and drawings of a template."""

    values: Mapping[str, Any]  # numbers that are not known are nan
    drawings: tuple[Drawing, ...] = ()


class Said(NamedTuple):
    """A section as it is read."""

    text: str  # Markdown
    drawings: tuple[Drawing, ...] = ()
    doubts: int = 0  # claims that the numbers do not bear out


def said(name: str, page: Callable[[Results], Page], results: Results) -> Said:
    """The section of an experiment: its template with the values of its page, and what failed.

    Nothing but the title where nothing came of it.
    """
    good = {key: result for key, result in results.items() if "error" not in result}
    values, drawings = page(good) if good else Page({})
    drawn, doubts = {drawing.name for drawing in drawings}, 0

    def figure(which: str, caption: str) -> str:
        return f"![{caption}](experiments/{which}.svg)" if which in drawn else ""

    def shown(claim: Any) -> str:
        nonlocal doubts
        doubts += not claim
        return "" if claim else _NOT_SHOWN

    if good:
        text = _TEMPLATES.get_template(f"{name}.md.jinja").render(values, figure=figure, shown=shown)
    else:
        text = _LOADER.get_source(_TEMPLATES, f"{name}.md.jinja")[0].partition("\n")[0]
    failed = failures(results)
    if not results:
        text += "\n\nNothing was measured: the reference recordings were not at hand (`--datasets`)."
    parts = [text.strip(), *(["Failed:\n\n" + "\n".join(failed)] if failed else [])]
    return Said("\n\n".join(parts) + "\n", drawings, doubts)


def write_report(out: Path, sections: Mapping[str, Said], numbers: Mapping[str, Any], command: str) -> list[Path]:
    """experiments.md, experiments.json and the figures in experiments/; what was written.

    `sections` and `numbers` by the experiments' names, in their order; `command` is what was typed.
    """
    drawings = [drawing for section in sections.values() for drawing in section.drawings]
    written = [save(drawing, out / "experiments") for drawing in drawings]
    front = _TEMPLATES.get_template("front.md.jinja").render(
        command=command, version=__version__, quick="--quick" in command.split(), missing=MISSING
    )
    parts = [front, *(f"\n({name})=\n{section.text}" for name, section in sections.items())]
    page, json = out / "experiments.md", out / "experiments.json"
    write_atomically(page, "\n".join(part.rstrip("\n") + "\n" for part in parts))
    write_json(json, numbers)
    return [page, json, *written]


def numbers_of(report: Any, results: Results) -> Any:
    """What experiments.json has: what the report says, or results without what figures alone are drawn from."""
    return report.numbers(results) if hasattr(report, "numbers") else without(results, getattr(report, "LARGE", ()))


def without(tree: Any, keys: Sequence[str]) -> Any:
    """Plain data without what stands under some keys, at any depth: what experiments.json has no room for."""
    if isinstance(tree, dict):
        return {key: without(value, keys) for key, value in tree.items() if key not in keys}
    return [without(value, keys) for value in tree] if isinstance(tree, list) else tree


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of Markdown."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def fixed(number: Any, digits: int = 2, factor: float = 1.0) -> str:
    """A number with so many digits; – where it is not known."""
    known = isinstance(number, int | float | np.number) and not math.isnan(number)
    return f"{factor * number:.{digits}f}" if known else MISSING


def failures(results: Mapping[str, Result]) -> list[str]:
    """Return the failures as a Markdown list."""
    return [f"- {key}: {result['error']}" for key, result in results.items() if "error" in result]


_LOADER = PackageLoader("experiments.report", "")
_TEMPLATES = Environment(loader=_LOADER, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
_TEMPLATES.filters["fixed"] = fixed
