"""Options from dataclasses, and help."""

import json
import re
import subprocess
import sys
from dataclasses import dataclass, fields
from typing import Literal

import pytest
import typer
from invoking import refusal
from typer.testing import CliRunner

from spheremouse.commands.options import with_fields
from spheremouse.errors import ConfigurationError
from spheremouse.settings import param


@dataclass(frozen=True)
class Film:
    number: int | None = param(None, "-", "How many.  [default: all]")
    share: float = param(0.5, "-", "Of what.", ge=0, le=1)
    length_m: float = param(2.0, "m", "How long.")
    kind: Literal["one", "two"] = param("one", "-", "Which.")
    size: tuple[int, int] = param((640, 480), "WxH", "How large.", ge=16)
    places: tuple[float, float] = param((1.0, -0.5), "X,Y", "Where.")
    seen: bool = param(False, "-", "Whether.")
    heard: bool = param(True, "-", "Whether.")


@pytest.fixture
def run():
    """(*words) -> the film that the command got; or what it printed."""
    app, got = typer.Typer(rich_markup_mode=None), []

    @app.command()
    @with_fields(length_m=("--length", "--long"))
    def film(name: str, *, options: Film, again: bool = False) -> None:
        got.append(options)

    def call(*words):
        result = CliRunner().invoke(app, ["name", *words])
        if isinstance(result.exception, ConfigurationError):
            raise result.exception
        return got.pop() if got else result.output

    return call


def test_what_is_typed_arrives_in_the_fields(run):
    assert run() == Film()
    words = "--number 3 --share 1 --long 4 --kind two --size 64X48 --places 3,4e-1 --seen --no-heard"
    assert run(*words.split()) == Film(3, 1.0, 4.0, "two", (64, 48), (3.0, 0.4), True, False)
    assert run("--long", "5mm").length_m == 0.005


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--size", "8x8"), "--size 8x8: write WIDTHxHEIGHT in px, as in 640x480, each from 16 to 8192"),
        (("--places", "1"), "--places 1: write 2 numbers, as in 1,-0.5"),
        (("--long", "5km"), "--length: '5km': 'km' is not a unit known here; write mm, cm, m or in, as in 5mm"),
        (("--places", "1,inf"), "--places 1,inf: write 2 numbers, as in 1,-0.5"),
    ],
)
def test_a_word_that_is_written_otherwise_is_refused_with_an_example(run, words, message):
    assert refusal(ConfigurationError, run, *words) == message


def test_help_tells_meaning_unit_bounds_and_default_of_every_field(run):
    said = " ".join(run("--help").split())
    for field in fields(Film):
        assert " ".join(field.metadata["meaning"].split()) in said
    for option in (
        *(
            "--number N How",
            "--share F Of what. [default: 0.5; 0<=x<=1]",
            "--length, --long LENGTH How long. [default: 2m]",
            "--seen Whether.",
        ),
        *("--size WxH How large. [default: 640x480]", "--places X,Y Where. [default: 1,-0.5]"),
    ):
        assert option in said
    assert "--no-seen" not in said


HEAVY = {"numpy", "scipy", "cv2", "matplotlib", "pandas", "PIL", "ruamel"}
WALK = f"""
import json, sys
import typer
from typer.testing import CliRunner
from spheremouse.commands import app

def walk(command, words):
    for name, inner in getattr(command, "commands", {{}}).items():
        yield from walk(inner, [*words, name])
    asked = CliRunner().invoke(app, [*words, "--help"], prog_name="spheremouse")
    yield " ".join(["spheremouse", *words]), asked.exit_code, asked.output, sorted({HEAVY!r} & sys.modules.keys())

print(json.dumps(list(walk(typer.main.get_command(app), []))))
"""


@pytest.fixture(scope="module")
def pages():
    """Of every command, the root last: its words, exit code, help, and what is loaded by then."""
    done = subprocess.run([sys.executable, "-c", WALK], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_every_command_has_help(pages):
    asked = [words for words, *_ in pages]
    assert {"spheremouse", "spheremouse run", "spheremouse ctl status", "spheremouse calibrate device"} <= set(asked)
    assert all(code == 0 and text.startswith(f"Usage: {words} ") for words, code, text, _ in pages)


def test_help_says_what_a_command_and_each_option_does_with_an_example_at_the_end(pages):
    for words, _, text, _ in pages:
        assert text.split("\n\n")[1].strip().endswith("."), words
        options, _, epilog = text.partition("Options:")[2].rpartition("\n\n")
        assert "spheremouse" in epilog or len(words.split()) > 2 or words.endswith("ctl"), words
        for option in re.findall(r"\n {2}(?:-\w, )?--[^\n]+(?:\n {4,}[^\n]*)*", options):
            assert re.search(r" {2,}\w", option), f"{words} says nothing of {option}"


def test_help_loads_nothing_that_computes(pages):
    first = next(((words, loaded) for words, _, _, loaded in pages if loaded), None)
    assert first is None, "imports at the head of a command's module: move them into its function"
