"""docs/tour.md leads to the code: each figure of `ctl status` is in its table, each function it names in its file."""

import ast
import re
from pathlib import Path
from typing import get_args

from pydantic import BaseModel

from spheremouse.session.control.status import StatusReport

ROOT = Path(__file__).parents[1]
TOUR = (ROOT / "docs/tour.md").read_text(encoding="utf-8")
TABLE = TOUR.split("## Where a figure of `ctl status` comes from")[1].split("\n## ")[0]
ROWS = re.findall(r"^\| (`.+) \| (.+) \|$", TABLE, re.MULTILINE)  # figures, computed by
PLACE = re.compile(r"`([\w/]+\.py): ([\w.]+)`")  # file.py: function


def fields(model, before=""):
    """Of a status; those of a part come after it, as `pose.age_s` after `pose`."""
    for name, field in model.model_fields.items():
        yield before + name
        outer = [field.annotation, *get_args(field.annotation)]
        for kind in [*outer, *(inner for part in outer for inner in get_args(part))]:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from fields(kind, f"{before}{name}.")


def functions(file):
    """What it defines: functions, classes, and methods as `Class.method`."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    for outer in (node for node in ast.parse(file.read_text(encoding="utf-8")).body if isinstance(node, kinds)):
        yield outer.name
        yield from (f"{outer.name}.{inner.name}" for inner in outer.body if isinstance(inner, kinds))


def test_every_figure_of_the_status_has_a_row_that_names_a_function():
    """A part that is named, as `latency_ms`, stands for all that is in it."""
    named = {name for figures, _ in ROWS for name in re.findall(r"`(.+?)`", figures)}
    there = set(fields(StatusReport))
    parts = {name.rpartition(".")[0] for name in there}
    assert {name for name in there - parts if not named & {name, name.rpartition(".")[0]}} == set(), "have no row"
    assert named - there == set(), "are in no status"
    assert [figures for figures, by in ROWS if not PLACE.search(by)] == [], "name no function"


def test_every_function_that_the_tour_names_is_in_its_file():
    """One that moves, or gets another name, does so in the tour as well."""
    there = {file: set(functions(ROOT / "spheremouse" / file)) for file, _ in PLACE.findall(TOUR)}
    gone = [f"{file}: {name}" for file, name in PLACE.findall(TOUR) if name not in there[file]]
    assert not gone, gone
