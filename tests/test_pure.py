"""What import-linter cannot see: the pure rooms open no file and print nothing."""

import ast
import tomllib
from pathlib import Path

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
