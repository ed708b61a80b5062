"""Run one target in its own process, and report a hang, a crash or too much memory with the batch that repeats it.

The parent process ends an example that takes too long, in Python or in C, with the stack of the place where it is.
"""

import contextlib
import ctypes
import faulthandler
import io
import math
import multiprocessing as mp
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.fuzz.targets import EVERY, STRATEGIES, TARGETS

MAX_CORE_SECONDS = 10.0  # of an example
MAX_SECONDS = 90.0  # of an example on a clock; it may wait for something that does not come
MAX_MEMORY = 1 << 30  # bytes of the process
ADDRESS_SPACE = 16 << 30  # bytes; beyond it the system refuses memory
BATCH = 1000  # examples of one seed
MIN_EXAMPLES = 20  # of each target, also after its time


@dataclass(frozen=True, slots=True)
class Limit:
    """Extent of a run of one target."""

    seconds: float  # on a clock
    examples: float = math.inf
    first: int = 0  # batch; only a run from batch 0 begins with the listed examples


@dataclass(frozen=True, slots=True)
class Result:
    """Result of a run."""

    count: int = 0  # examples
    worst: float = 0.0  # s of a core, of the slowest example
    memory: int = 0  # bytes
    seconds: float = 0.0  # on a clock
    found: str | None = None  # failure and example


class _EndOfRun(BaseException):
    """The limit is reached."""


class _TooMuchMemoryError(BaseException):
    """Not an Exception, so hypothesis does not try to shrink the example."""


def tried(name: str, first_seed: int, limit: Limit) -> Result:
    """Run a target on its examples in its own process."""
    progress = mp.RawArray(ctypes.c_double, 3)  # batch, example, its start
    progress[2] = time.monotonic()
    here, there = mp.Pipe(duplex=False)
    stacks = Path("stacks").absolute()
    process = mp.get_context("fork").Process(target=_process, args=(name, first_seed, limit, progress, there, stacks))
    start = time.monotonic()
    process.start()
    there.close()
    assert process.pid is not None
    result, failure = None, ""
    used, example = 0.0, progress[1]
    while result is None and not failure:
        try:
            if here.poll(0.2):
                result = here.recv()
                break
        except EOFError:
            process.join()
            failure = f"the process ended ({process.exitcode})"
            break
        if progress[1] != example:
            used, example = _core_seconds(process.pid), progress[1]
        if _core_seconds(process.pid) - used > MAX_CORE_SECONDS or time.monotonic() - progress[2] > MAX_SECONDS:
            failure = f"an example takes longer than {MAX_CORE_SECONDS:g} s of a core, or {MAX_SECONDS:g} s"
            os.kill(process.pid, signal.SIGABRT)
    process.join(30.0)
    if process.is_alive():
        process.kill()
    if result is None:
        stack = stacks.read_text(errors="replace")[-3000:] if stacks.exists() else ""
        batch, count = int(progress[0]), int(progress[1])
        repeat = f"batch {batch}: --only {name!r} --seed {first_seed} --batch {batch}"
        result = Result(count, MAX_CORE_SECONDS, found=f"{failure}, in example {count} ({repeat})\n{stack}")
    return replace(result, seconds=time.monotonic() - start)


def _core_seconds(pid: int) -> float:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0  # it has ended, or the system has no /proc
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _process(name: str, first_seed: int, limit: Limit, progress: Any, there: Connection, stacks: Path) -> None:
    with stacks.open("w") as file, _without_standard_error():
        faulthandler.enable(file)
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, resource.getrlimit(resource.RLIMIT_AS)[1]))
        there.send(_run(name, first_seed, limit, progress))
        there.close()
        os._exit(0)  # threads of a server may still run


def _run(name: str, first_seed: int, limit: Limit, progress: Any) -> Result:
    count, worst, current, end = 0, 0.0, None, time.monotonic() + limit.seconds

    def check(example: Any) -> None:
        nonlocal count, worst, current
        if count >= limit.examples or (time.monotonic() > end and count >= MIN_EXAMPLES and not listed):
            raise _EndOfRun
        count, current = count + 1, example
        progress[1], progress[2] = count, time.monotonic()
        start = time.process_time()
        TARGETS[name](example)
        worst = max(worst, time.process_time() - start)
        if (peak := _peak()) > MAX_MEMORY:
            raise _TooMuchMemoryError(f"the process has taken {peak >> 20} MB")

    options = settings(
        max_examples=BATCH,
        deadline=None,
        database=None,
        print_blob=False,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    batch, found, printed = limit.first, None, io.StringIO()
    listed = EVERY[name]() if batch == 0 else []
    try:
        with contextlib.redirect_stdout(printed):
            for example in listed:
                check(example)
            listed = []
            while True:
                progress[0] = batch
                seed(first_seed * 100_003 + batch)(options(given(STRATEGIES[name]())(check)))()
                batch += 1
    except _EndOfRun:
        pass
    except (Exception, _TooMuchMemoryError) as e:
        lines = "".join(traceback.format_exception(e)) if isinstance(e, Exception) else f"{e}\n"
        if len(lines) > 6000:  # hypothesis adds the example, which may be long
            lines = f"{lines[:4000]}\n...\n{lines[-2000:]}"
        found = f"batch {batch}:\n{lines}{printed.getvalue()[-2000:]}\nlast example: {repr(current)[:2000]}"
    return Result(count, worst, _peak(), found=found)


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


@contextlib.contextmanager
def _without_standard_error() -> Iterator[None]:
    """Discard the messages of C libraries about damaged images."""
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)
