"""Damaged input of every kind: `python -m tests.fuzz [--seconds S] [--seed S] [--batch B] [--only NAME]`.

Files, names of sources and outputs, and parameters may be refused by a SpheremouseError with a message, and by nothing
else. The core takes any image and any detections without an exception and without a nan. No example may take 10 s of a
core, or 1 GB. Hypothesis makes a failing example small. The program prints it, and its exit code is 1.
"""

import argparse
import contextlib
import importlib
import os
import pkgutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import cv2

from tests.fuzz.guard import Limit, Result, tried
from tests.fuzz.targets import TARGETS

for _module in pkgutil.iter_modules([str(Path(__file__).parent)]):  # each adds its targets
    if _module.name != "__main__":
        importlib.import_module(f"tests.fuzz.{_module.name}")

# Compiling takes longer than an example may, so another process does it first.
_COMPILE = """
from dataclasses import replace
from itertools import product
from spheremouse.ball import warm as ball
from spheremouse.ball.settings import Settings
from spheremouse.wand import warm as wand
for tracker, detector in product(("so3", "ekf1", "ekf2"), ("default", "blobs")):
    ball.warm_up(replace(Settings(), tracker=tracker, detector=detector))
wand.warm_up()
"""


def _print(name: str, r: Result) -> None:
    print(
        f"{name}: {r.count} examples in {r.seconds:.0f} s, the longest {r.worst:.2f} s of a core, "
        f"{r.memory >> 20} MB: {'FAILED' if r.found else 'nothing found'}",
        flush=True,
    )
    if r.found:
        print("".join(f"    {line}\n" for line in r.found.splitlines()), flush=True)


def main() -> int:
    """Fuzz every target for its share of the time; return 1 if one failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seconds", type=float, default=600.0, metavar="S", help="for all targets (default: 600)")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--batch", type=int, default=0, metavar="B", help="first batch, as a failure prints it")
    parser.add_argument("--only", choices=list(TARGETS), help="one target")
    args = parser.parse_args()
    names = list(TARGETS) if args.only is None else [args.only]
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # no messages about damaged videos
    cv2.utils.logging.setLogLevel(0)
    warnings.simplefilter("error", RuntimeWarning)  # NumPy warns before a nan
    subprocess.run([sys.executable, "-c", _COMPILE], check=True)
    results: list[Result] = []
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for name in names:
            results.append(tried(name, args.seed, Limit(args.seconds / len(names), first=args.batch)))
            _print(name, results[-1])
    failed = sum(r.found is not None for r in results)
    print(
        f"fuzz: {sum(r.count for r in results)} examples, the longest {max(r.worst for r in results):.2f} s of a core, "
        f"{max(r.memory for r in results) >> 20} MB: "
        + (f"{failed} of the targets failed" if failed else "nothing was found")
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
