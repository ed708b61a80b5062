"""Broken input of every kind: `python -m tests.fuzz [--short] [--seconds S] [--seed S] [--only NAME] [--guided]`.

Files, names of sources and outputs, and parameters may be refused by a SpheremouseError of one message, nothing else.
Pictures and detections may be anything, and the core takes them all without an exception and without a nan. What
hypothesis finds it makes small; the example is printed, and the exit code is 1.

With --guided, and `pip install atheris`, text is made by libFuzzer instead, which looks where in our code it leads:
longer, for control messages, configuration and the files of a device.
"""

import argparse
import contextlib
import importlib
import importlib.util
import io
import os
import pkgutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from typing import Any

import cv2
from hypothesis import HealthCheck, Phase, given, seed, settings

import tests.fuzz
from tests.fuzz.guided import SEEDS, guide, guided
from tests.fuzz.targets import STRATEGIES, TARGETS

for _module in pkgutil.iter_modules(tests.fuzz.__path__):  # each adds its targets
    if _module.name != "__main__":
        importlib.import_module(f"tests.fuzz.{_module.name}")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without what C libraries write to standard error about broken pictures."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def run(name: str, seconds: float, first: int) -> tuple[int, str | None]:
    """Examples tried in `seconds`, and what the smallest that fails does, if one does."""
    count = 0

    def counted(example: Any) -> None:
        nonlocal count
        count += 1
        TARGETS[name](example)

    end, batch = time.perf_counter() + seconds, 0
    while time.perf_counter() < end:
        options = settings(
            max_examples=25,
            deadline=None,
            database=None,
            print_blob=False,
            phases=(Phase.generate, Phase.shrink),
            suppress_health_check=(HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large),
        )
        told = io.StringIO()
        try:
            with contextlib.redirect_stdout(told), _quiet():
                seed(first * 100_003 + batch)(options(given(STRATEGIES[name]())(counted)))()
        except Exception as e:
            lines = traceback.format_exception(e)
            return count, "".join(lines)[-3000:] + told.getvalue()[-2000:]
        batch += 1
    return count, None


def main() -> int:
    """Fuzz every target for its share of the time; 1 if anything was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--short", action="store_true", help="half a minute in all; otherwise ten minutes")
    parser.add_argument("--seconds", type=float, metavar="S", help="in all")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--only", choices=list(TARGETS), help="one target, with its share of the time")
    parser.add_argument("--guided", action="store_true", help="by atheris, targets of text only; 60 s each unless told")
    parser.add_argument("--guide", choices=list(SEEDS), help=argparse.SUPPRESS)
    args = parser.parse_args()
    names = list(SEEDS) if args.guided else list(TARGETS)
    if args.only is not None and args.only not in names:
        parser.error(f"--guided: {args.only} is not among {', '.join(names)}")
    if args.guided and importlib.util.find_spec("atheris") is None:
        parser.error("--guided needs atheris: pip install atheris")
    share = (args.seconds or (28.0 if args.short else 60.0 * len(names) if args.guided else 600.0)) / len(names)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # broken videos are meant to be broken
    cv2.utils.logging.setLogLevel(0)
    warnings.simplefilter("error", RuntimeWarning)  # what NumPy warns of is on its way to a nan
    failed = 0
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        if args.guide:
            guide(args.guide, args.seconds, args.seed)
        for name in names if args.only is None else (args.only,):
            count, found = (guided if args.guided else run)(name, share, args.seed)
            print(f"{name}: {count} examples, {'FAILED' if found else 'nothing found'}", flush=True)
            if found:
                failed += 1
                print("".join(f"    {line}\n" for line in found.splitlines()), flush=True)
    print("fuzz: " + (f"{failed} of the targets failed" if failed else "nothing was found"))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
