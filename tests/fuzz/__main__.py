"""Broken input of every kind: `python -m tests.fuzz [--short] [--seconds S | --examples N] [--seed S] [--only NAME]`.

Files, names of sources and outputs, and parameters may be refused by a SpheremouseError of one message, nothing else.
Pictures and detections may be anything, and the core takes them all without an exception and without a nan. No example
may take 10 s of a core, or 1 GB. What hypothesis finds it makes small; the example is printed, and the exit code is 1.

With --guided, and `pip install atheris`, text is made by libFuzzer instead, which looks where in our code it leads:
longer, for control messages, configuration and the files of a device.
"""

import argparse
import contextlib
import importlib
import importlib.util
import math
import os
import pkgutil
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import cv2

from tests.fuzz.guard import Limit, Result, tried
from tests.fuzz.guided import SEEDS, guide, guided
from tests.fuzz.targets import TARGETS

for _module in pkgutil.iter_modules([str(Path(__file__).parent)]):  # each adds its targets
    if _module.name != "__main__":
        importlib.import_module(f"tests.fuzz.{_module.name}")

_SHORT, _LONG = 28.0, 600.0  # s in all
_ROUND = 60.0  # s of one target before it is the next one's turn
_LEAST = 20  # examples of each target, however long they take
# What a target calls is compiled beforehand, by a process of its own: it takes longer than an example may.
_READY = """
from dataclasses import replace
from itertools import product
from spheremouse.ball import warm as ball
from spheremouse.ball.settings import Settings
from spheremouse.wand import warm as wand
for tracker, detector in product(("so3", "ekf1", "ekf2"), ("default", "blobs")):
    ball.warm_up(replace(Settings(), tracker=tracker, detector=detector))
wand.warm_up()
"""


def _for_seconds(names: list[str], seconds: float, seed: int, batch: int, every: int) -> dict[str, Result]:
    """Each target for its share of the time."""
    share, results = seconds / len(names), {}
    for name in names:
        results[name] = tried(name, seed, Limit(share, math.inf, batch, every))
        if results[name].count < _LEAST and results[name].found is None:
            more = Limit(math.inf, _LEAST - results[name].count, results[name].batch, every=0)
            results[name] = results[name].joined(tried(name, seed, more))
        _tell(name, results[name])
    return results


def _for_examples(names: list[str], examples: int, seed: int, batch: int) -> dict[str, Result]:
    """So many examples in all, in rounds of as much time for each target: the fast ones have most of them."""
    results, every = {name: Result(batch=batch) for name in names}, int(batch == 0)
    while (sound := [n for n in names if results[n].found is None]) and _missing(results, examples):
        for name in sound:
            if missing := _missing(results, examples):
                limit = Limit(_ROUND, missing, results[name].batch, every)
                results[name] = results[name].joined(tried(name, seed, limit))
                _tell(name, results[name])
        every = 0
    return results


def _missing(results: dict[str, Result], examples: int) -> int:
    return max(examples - sum(r.count for r in results.values()), 0)


def _tell(name: str, r: Result) -> None:
    print(
        f"{name}: {r.count} examples in {r.seconds:.0f} s, the longest {r.worst:.2f} s of a core, "
        f"{r.memory >> 20} MB: {'FAILED' if r.found else 'nothing found'}",
        flush=True,
    )
    if r.found:
        print("".join(f"    {line}\n" for line in r.found.splitlines()), flush=True)


def _by_guide(names: list[str], seconds: float, seed: int) -> dict[str, Result]:
    results = {}
    for name in names:
        begun = time.monotonic()
        count, found = guided(name, seconds / len(names), seed)
        results[name] = Result(count, seconds=time.monotonic() - begun, found=found)
        _tell(name, results[name])
    return results


def main() -> int:
    """Fuzz every target for its share; 1 if anything was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--short", action="store_true", help="about half a minute in all; otherwise ten minutes")
    parser.add_argument("--seconds", type=float, metavar="S", help="in all")
    parser.add_argument("--examples", type=int, metavar="N", help="in all; the long form has 1000000")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--batch", type=int, default=0, metavar="B", help="begin there, as a failure says")
    parser.add_argument("--only", choices=list(TARGETS), help="one target")
    parser.add_argument("--guided", action="store_true", help="by atheris, targets of text only; 60 s each unless told")
    parser.add_argument("--guide", choices=list(SEEDS), help=argparse.SUPPRESS)
    args = parser.parse_args()
    names = list(SEEDS) if args.guided else list(TARGETS)
    if args.only is not None and args.only not in names:
        parser.error(f"--guided: {args.only} is not among {', '.join(names)}")
    if args.guided and importlib.util.find_spec("atheris") is None:
        parser.error("--guided needs atheris: pip install atheris")
    seconds = args.seconds or (_SHORT if args.short else 60.0 * len(names) if args.guided else _LONG)
    if args.only is not None:
        seconds, names = seconds if args.seconds else seconds / len(names), [args.only]
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # broken videos are meant to be broken
    cv2.utils.logging.setLogLevel(0)
    warnings.simplefilter("error", RuntimeWarning)  # what NumPy warns of is on its way to a nan
    if not args.guide:
        subprocess.run([sys.executable, "-c", _READY], check=True)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        if args.guide:
            guide(args.guide, args.seconds, args.seed)
        if args.guided:
            results = _by_guide(names, seconds, args.seed)
        elif args.examples:
            results = _for_examples(names, args.examples, args.seed, args.batch)
        else:
            results = _for_seconds(names, seconds, args.seed, args.batch, 0 if args.batch else 3 if args.short else 1)
    every, failed = results.values(), sum(r.found is not None for r in results.values())
    print(
        f"fuzz: {sum(r.count for r in every)} examples, the longest {max(r.worst for r in every):.2f} s of a core, "
        f"{max(r.memory for r in every) >> 20} MB: "
        + (f"{failed} of the targets failed" if failed else "nothing was found")
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
