"""The documentation, its lists and the metadata agree with the code."""

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import reference
from markdown_it import MarkdownIt
from pydantic import BaseModel
from trove_classifiers import classifiers

from spheremouse.files.config import loads, parameters
from spheremouse.files.yaml import parse_document
from spheremouse.session.control.status import StatusReport
from spheremouse.session.run_config import read_balls
from spheremouse.session.settings import Configuration
from spheremouse.simulate.wand.film import WandOptions, prepare_wand, simulate_wand
from spheremouse.tracker import Status
from spheremouse.wand.build import build
from spheremouse.wand.track import begin, step

DOCS = Path(__file__).parents[1] / "docs"
NO_PAGES = {"index", "figures"}  # the index itself, and a part of accuracy


def test_every_page_is_of_one_kind_and_the_list_that_is_read_is_the_one_of_the_sidebar():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    kinds = re.findall(r"^## (.+?)\n(.+?)```{toctree}\n:caption: \1\n:hidden:\n\n(.+?)\n```", index, re.M | re.S)
    assert [name for name, _, _ in kinds] == ["Tutorials", "How-to guides", "Reference", "Explanation"]
    listed = [re.findall(r"^- \[.+?\]\((.+?)\.md\): .", text, re.MULTILINE) for _, text, _ in kinds]
    assert listed == [sidebar.splitlines() for _, _, sidebar in kinds]
    pages = {path.stem for path in DOCS.glob("*.md")} - NO_PAGES
    assert Counter(name for names in listed for name in names) == Counter(pages)
    assert "(decisions/index.md)" in index


def test_decisions_are_numbered_without_a_gap_and_say_why():
    pages = sorted((DOCS / "decisions").glob("[0-9]*.md"))
    assert [int(path.name[:4]) for path in pages] == list(range(1, len(pages) + 1))
    for number, path in enumerate(pages, 1):
        text = path.read_text(encoding="utf-8")
        assert text.startswith(f"# {number}. "), path.name
        assert "\n## Rationale\n" in text, path.name


def test_the_pages_of_settings_have_each_setting_once(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    made, listed = importlib.import_module("configuration_page"), []
    for path, tables in made.PAGES:
        page = path.read_text(encoding="utf-8")
        assert page == made.written(page, tables()), "python docs/configuration_page.py --write"
        text = page.partition("configuration_page.py --write -->")[2]
        listed += re.findall(r"^\| `([a-z_0-9.]+)` \|", text, re.MULTILINE)
    assert sorted(listed) == sorted(".".join(key) for key, _ in parameters(Configuration()))


def test_the_file_that_the_configuration_page_shows_is_one():
    text = (DOCS / "configuration.md").read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0]
    assert loads(parse_document(text, "page"), Configuration).motion.counts_per_mm == 2.0


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


TEXT = (ROOT / "docs" / "wand.md").read_text(encoding="utf-8")


@pytest.fixture
def shown(tmp_path):
    """Its YAML blocks as files: a configuration and a ball."""
    configuration, ball = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
    (tmp_path / "config.yaml").write_text(configuration)
    (tmp_path / "mine.yaml").write_text(ball)
    return tmp_path


def test_the_ball_that_is_shown_is_found(shown):
    read = read_balls([shown / "mine.yaml"])
    balls, colours = read.balls, read.colours
    assert (balls[0].name, balls[0].radius, set(colours)) == ("mine", 0.04, {"red", "green"})
    film = prepare_wand(WandOptions("hand", seed=1, seconds=0.2, size=(640, 480)), balls[0])
    tracker = build(film.scene.camera, balls, colours=colours)
    state = begin(tracker, 1)
    for shot in simulate_wand(film):
        state, pose, _ = step(state, shot.frame, tracker)
        assert pose.status is Status.TRACKING
        assert pose.position == pytest.approx(shot.position[0], abs=0.03)
        assert np.trace(pose.rotation.T @ shot.rotation[0]) > 2.99


def test_the_configuration_that_is_shown_is_right(spheremouse, shown):
    _, _err = spheremouse.succeed("config", "show", "--config", shown / "config.yaml")


def test_the_balls_that_ship_are_named_and_every_field_is_told():
    for path in (ROOT / "calibration" / "wand").glob("*.yaml"):
        assert f"`{path.name}`" in TEXT
    for field in ("name", "radius", "body", "discs", "azimuth", "latitude", "diameter", "colour", "points", "colours",
                  "hue_min", "hue_max", "saturation_min", "saturation_max", "value_min", "value_max"):  # fmt: skip
        assert f"`{field}`" in TEXT


@pytest.fixture(scope="module")
def metadata():
    command = [sys.executable, "-m", "scikit_build_core.build", "project-table"]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout)


def test_the_description_leads_nowhere_that_an_index_has_not(metadata):
    inline = [t for token in MarkdownIt().parse(metadata["readme"]["text"]) for t in token.children or ()]
    places = [t.attrGet("href") or t.attrGet("src") for t in inline if t.type in ("link_open", "image")]
    assert [place for place in places if not place.startswith("https://")] == []
    assert "<!--" not in metadata["readme"]["text"]
    assert "](" not in metadata["readme"]["text"]
    assert metadata["readme"]["content-type"] == "text/markdown"


def test_nothing_but_links_pictures_and_notes_is_left_out_of_it(metadata):
    kept, there = set(metadata["readme"]["text"].splitlines()), (ROOT / "README.md").read_text().splitlines()
    gone = [line for line in there if line not in kept]
    assert all("](" in line or line.startswith(("<!--", "*The ")) for line in gone), gone


def test_classifiers_are_known_and_somebody_has_written_it(metadata):
    assert set(metadata["classifiers"]) <= classifiers
    assert metadata["authors"]
    assert metadata["keywords"]
    assert "urls" not in metadata  # until there are some


def test_an_upper_bound_has_its_reason_beside_it():
    for line in (ROOT / "pyproject.toml").read_text(encoding="utf-8").splitlines():
        if line.startswith('  "') and ",<" in line:
            assert "#" in line, line


sys.path.insert(0, str(ROOT / "docs"))


SHARE = ROOT / "service" / "share"


def test_the_files_are_what_would_be_made_now():
    """`make reference` mends it."""
    late = [
        str(path.relative_to(ROOT))
        for path, text in reference.made().items()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    ]
    assert late == []


def test_no_page_is_only_an_include():
    """GitHub and an editor show none."""
    for path in (ROOT / "docs").rglob("*.md"):
        text = re.sub(r"```{include}.*?```", "", path.read_text(encoding="utf-8"), flags=re.S)
        assert "_build" in path.parts or len(text.split()) > 20, path


def test_the_man_page_has_every_command_and_option_that_help_has():
    help_page = reference.command_line()
    man = (SHARE / "man" / "man1" / "spheremouse.1").read_text(encoding="utf-8").replace("\\-", "-")
    names = re.findall(r"^## (spheremouse .+)$", help_page, re.M)
    assert len(names) > 40
    assert re.findall(r"^\.SS (.+)$", man, re.M) == names
    options = set(re.findall(r"^  (?:-\w, )?(--[\w-]+)", help_page, re.M))
    assert len(options) > 100
    assert {one for one in options if not re.search(rf"^\.B .*{one}\b", man, re.M)} == set()


@pytest.mark.skipif(shutil.which("mandoc") is None, reason="needs mandoc")
def test_the_man_page_is_one():
    page = SHARE / "man" / "man1" / "spheremouse.1"
    done = subprocess.run(["mandoc", "-T", "lint", "-W", "warning", page], capture_output=True, text=True, check=False)
    assert [line for line in done.stdout.splitlines() if "missing date" not in line] == []


ASK = {  # in each shell: what follows `spheremouse calibrate pr`
    "bash": "source {}; COMP_WORDS=(spheremouse calibrate pr); COMP_CWORD=2; _spheremouse_completion spheremouse; "
    'printf "%s\\n" "${{COMPREPLY[@]}}"',
    "fish": "source {}; complete -C 'spheremouse calibrate pr'",
    "zsh": "compdef() {{ :; }}; _arguments() {{ print -l -- $*; }}; "
    "words=(spheremouse calibrate pr); CURRENT=3; fpath=({}); autoload -U _spheremouse; _spheremouse",
}


@pytest.mark.parametrize("shell", ASK)
def test_a_shell_completes(shell, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")
    program = tmp_path / "spheremouse"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m spheremouse "$@"\n')
    program.chmod(0o755)
    script = SHARE / reference.COMPLETIONS[shell]
    env = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}", "HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
    asked = ASK[shell].format(script.parent if shell == "zsh" else script)
    done = subprocess.run([shell, "-c", asked], capture_output=True, text=True, check=False, env=env, cwd=tmp_path)
    assert {"practice", "print"} <= set(re.findall(r"\w+", done.stdout)), done
    assert "rolling" not in done.stdout
