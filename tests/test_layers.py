"""Imports point upwards only, and the core has no thread, clock, file or log: walked, not trusted.

The order is the layout of docs/design.md; a folder counts as one place in it. What is not in the list is the shell,
which may import anything.
"""

import ast
from pathlib import Path

import spheremouse

ROOT = Path(spheremouse.__file__).parent
TOP = ("errors", "settings", "rotation")
CORE = (
    *TOP,
    "camera",
    "disc_map",
    "rig",
    "frame",
    "detect",
    "resect",
    "intersect",
    "constellation_kernel",
    "constellation",
    "associate",
    "filters",
    "motion",
    "wand",
    "pointer",
    "watch",
    "bearing",
    "track",
    "warm",
    "adjustment",
    "simulate",
    "coincidence",
    "layout",
    "evaluate",
)
FORBIDDEN = {
    "asyncio",
    "datetime",
    "logging",
    "multiprocessing",
    "os",
    "pathlib",
    "socket",
    "subprocess",
    "tempfile",
    "threading",
    "time",
}


def imported_names(path, root):
    """Dotted names a file imports, wherever in it; relative ones made absolute."""
    package = [root.name, *path.relative_to(root).parent.parts]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) + "." if node.level else ""
            module = (base + (node.module or "")).rstrip(".")
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def place(parts):
    """The name in the layout that a path or a dotted name below the package belongs to."""
    return parts[0].removesuffix(".py")


def violations(root):
    """What the core's files import and must not, as lines of text."""
    modules = {place(p.relative_to(root).parts) for p in root.rglob("*.py")}
    found = set()
    for path in sorted(root.rglob("*.py")):
        relative = path.relative_to(root)
        here = place(relative.parts)
        if here not in CORE:
            continue
        for name in imported_names(path, root):
            top, *below = name.split(".")
            if top in FORBIDDEN:
                found.add(f"{relative} imports {top}")
            if top != root.name or not below or below[0] not in modules:
                continue
            there = below[0]
            if there not in CORE:
                found.add(f"{relative} imports {there}, of the shell")
            elif here in TOP and there in TOP and here != there:
                continue
            elif CORE.index(there) > CORE.index(here):
                found.add(f"{relative} imports {there}, which is below it")
    return sorted(found)


def test_the_core_imports_upwards_only_and_nothing_that_waits_or_writes():
    assert violations(ROOT) == []


def test_the_core_opens_no_file_and_prints_nothing():
    calls = [
        f"{path.relative_to(ROOT)}:{node.lineno} calls {node.func.id}"
        for path in sorted(ROOT.rglob("*.py"))
        if place(path.relative_to(ROOT).parts) in CORE
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in {"open", "print", "input"}
    ]
    assert calls == []


def test_the_walk_sees_every_way_to_import(tmp_path):
    """A package with one fault of each kind, and imports that are allowed."""
    root = tmp_path / "spheremouse"
    files = {
        "rotation.py": "import numpy\nfrom spheremouse.settings import param",
        "settings.py": "",
        "frame.py": "from spheremouse.ball import detect",
        "ball/detect/__init__.py": "from . import discs\nfrom .discs import x\nfrom ..rotation import exp",
        "ball/detect/discs.py": "from ..filters import so3\ndef f():\n    import time.x",
        "ball/filters/__init__.py": "from spheremouse.ball.detect.discs import x\nimport spheremouse.commands",
        "cli.py": "import os, threading\nfrom spheremouse.ball.filters import Filter",
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    assert violations(root) == [
        "ball/detect/discs.py imports filters, which is below it",
        "ball/detect/discs.py imports time",
        "ball/filters/__init__.py imports cli, of the shell",
        "frame.py imports detect, which is below it",
    ]
