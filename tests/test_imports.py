"""What importing loads, and what pure rooms do not call."""

import ast
import importlib
import pkgutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import spheremouse
from spheremouse.errors import SpheremouseError
from spheremouse.native import kernels

CLIP = Path(__file__).parent / "data" / "far26_clip"

MODULES = [
    m.name for m in pkgutil.walk_packages(spheremouse.__path__, "spheremouse.") if m.name != "spheremouse.__main__"
]


@pytest.mark.skipif(sys.platform != "linux", reason="some are of Linux alone")
@pytest.mark.parametrize("name", MODULES)
def test_it_can_be_imported(name):
    if name == "spheremouse.commands.demo.boulder":
        pytest.importorskip("pygame")
    importlib.import_module(name)


def test_kernels_older_than_their_callers_are_one_line_with_the_remedy():
    assert not hasattr(kernels, "added_later")
    with pytest.raises(SpheremouseError, match=r"in C\+\+ has no added_later: .*; run make native"):
        _ = kernels.added_later


OTHER_USES = (  # modules that the start of a run with discs does not need
    "scipy", "PIL", "rich", "matplotlib", "starlette", "uvicorn", "websockets", "prometheus_client",
    "spheremouse.ball.published", "spheremouse.ball.texture", "spheremouse.calibrate", "spheremouse.evaluation",
    "spheremouse.simulate", "spheremouse.view", "spheremouse.files.wand", "spheremouse.files.dataset.wand",
    "spheremouse.wand.ball", "spheremouse.wand.colour",
)  # fmt: skip


@pytest.mark.parametrize("more", [[], ["--realtime"]], ids=["fast", "daemon"])
def test_a_ball_is_tracked_without_what_other_uses_need(more, tmp_path):
    """SciPy's import alone takes as long as the rest of the start."""
    words = ["run", "--source", f"dataset:{CLIP}", "--frames", "2", "--output", "null", *more]
    words += ["--set", f"control.socket={tmp_path}/s", "--set", "realtime=off", "--set", "pose.frames=1"]
    run = f"app({words}, standalone_mode=False)"
    code = f"import sys; from spheremouse.commands import app; {run}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.PIPE, text=True).stdout.split()
    assert "spheremouse.ball.track" in loaded
    assert [name for name in OTHER_USES if name in loaded] == []


ROOT = Path(__file__).parents[1]


def pure():
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    contract = next(c for c in tools["importlinter"]["contracts"] if c["id"] == "pure")
    for name in contract["source_modules"]:
        place = ROOT / name.replace(".", "/")
        found = [*place.rglob("*.py")] if place.is_dir() else [place.with_suffix(".py")]
        assert found
        yield from found


def called(text):
    return [
        f"{node.lineno} calls {node.func.id}"
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in {"open", "print", "input"}
    ]


def test_the_pure_rooms_open_no_file_and_print_nothing():
    assert {str(p): found for p in pure() if (found := called(p.read_text(encoding="utf-8")))} == {}


def test_the_walk_sees_what_it_looks_for():
    assert called("def f():\n    with open('x') as g:\n        print(g)") == ["2 calls open", "3 calls print"]
