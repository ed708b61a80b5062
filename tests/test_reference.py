"""What docs/reference.py makes of the program's definitions: up to date, complete, and read by those it is for."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs"))

import reference  # noqa: E402

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
