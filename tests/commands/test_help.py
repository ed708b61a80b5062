"""The help of every command, which is said at once: nothing that computes is loaded for it."""

import json
import re
import subprocess
import sys

import pytest

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
