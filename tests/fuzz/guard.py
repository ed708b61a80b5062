"""One target tried in a process of its own: what hangs, ends or fills it is found and told with the example.

Within the process a timer ends what takes too long in Python; what takes too long in C, where no signal is heard, the
process that waits for it ends, and so does it learn of one that has died. `--seed` with the batch that is told makes
the same examples again.
"""

import contextlib
import ctypes
import faulthandler
import io
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

LONGEST = 10.0  # s of a core that an example may take
IN_C = 5.0  # s more until the process is ended from outside
PATIENCE = 90.0  # s on a clock: it waits for something that does not come
MEMORY = 1 << 30  # bytes, of the process at its largest
ADDRESSES = 16 << 30  # bytes: beyond, memory is refused, so that the machine goes on
BATCH = 1000  # examples of one seed


@dataclass(frozen=True, slots=True)
class Limit:
    """How much of a target is to be tried."""

    seconds: float  # on a clock
    examples: float  # in all
    first: int = 0  # batch
    every: int = 1  # of what is to be tried one after the other, each so-manieth comes first; 0: none


@dataclass(frozen=True, slots=True)
class Result:
    """What came of it."""

    count: int = 0  # examples
    worst: float = 0.0  # s of a core
    memory: int = 0  # bytes
    seconds: float = 0.0  # on a clock
    batch: int = 0  # the next
    found: str | None = None  # what is wrong, and the example

    def joined(self, other: "Result") -> "Result":
        """Of both, one after the other."""
        return Result(
            self.count + other.count,
            max(self.worst, other.worst),
            max(self.memory, other.memory),
            self.seconds + other.seconds,
            other.batch,
            self.found or other.found,
        )


class _Over(BaseException):
    """Enough has been tried."""


class _TooMuchError(BaseException):
    """Of time or memory; hypothesis shall not try to make it smaller, which would take as much again each time."""


def tried(name: str, first_seed: int, limit: Limit) -> Result:
    """What a target makes of its examples, in a process of its own."""
    where = mp.RawArray(ctypes.c_double, 3)  # batch, example, when it began
    where[2] = time.monotonic()
    here, there = mp.Pipe(duplex=False)
    stacks = Path("stacks").absolute()
    process = mp.get_context("fork").Process(target=_process, args=(name, first_seed, limit, where, there, stacks))
    begun = time.monotonic()
    process.start()
    there.close()
    assert process.pid is not None
    result, why = None, ""
    used, example = 0.0, where[1]
    while result is None and not why:
        try:
            if here.poll(0.2):
                result = here.recv()
                break
        except EOFError:
            process.join()
            why = f"the process ended ({process.exitcode})"
            break
        if where[1] != example:
            used, example = _core_seconds(process.pid), where[1]
        if _core_seconds(process.pid) - used > LONGEST + IN_C or time.monotonic() - where[2] > PATIENCE:
            why = f"an example takes longer than {LONGEST:g} s of a core, or {PATIENCE:g} s"
            os.kill(process.pid, signal.SIGABRT)  # with the stack of where it is
    process.join(30.0)
    if process.is_alive():
        process.kill()
    if result is None:
        told = stacks.read_text(errors="replace")[-3000:] if stacks.exists() else ""
        batch, count = int(where[0]), int(where[1])
        why = f"{why}, in example {count} (batch {batch}: --only {name!r} --seed {first_seed} --batch {batch})\n{told}"
        result = Result(count, LONGEST, 0, 0.0, batch + 1, why)
    return replace(result, seconds=time.monotonic() - begun)


def _core_seconds(pid: int) -> float:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0  # it has ended, or this system does not tell: then the clock alone counts
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _process(name: str, first_seed: int, limit: Limit, where: Any, there: Connection, stacks: Path) -> None:
    with stacks.open("w") as file, _quiet():
        faulthandler.enable(file)
        signal.signal(signal.SIGPROF, _hangs)
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, resource.getrlimit(resource.RLIMIT_AS)[1]))
        there.send(_batches(name, first_seed, limit, where))
        there.close()
        os._exit(0)  # threads of a server may live on


def _hangs(*_: Any) -> None:
    raise _TooMuchError(f"takes longer than {LONGEST:g} s of a core\n{''.join(traceback.format_stack()[-8:])}")


def _batches(name: str, first_seed: int, limit: Limit, where: Any) -> Result:
    count, worst, current, end = 0, 0.0, None, time.monotonic() + limit.seconds

    def counted(example: Any) -> None:
        nonlocal count, worst, current
        if count >= limit.examples or (time.monotonic() > end and not sweeping):
            raise _Over
        count, current = count + 1, example
        where[1], where[2] = count, time.monotonic()
        begun = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, LONGEST)
        try:
            TARGETS[name](example)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        worst = max(worst, time.process_time() - begun)
        if (peak := _peak()) > MEMORY:
            raise _TooMuchError(f"the process has taken {peak >> 20} MB")

    options = settings(
        max_examples=BATCH,
        deadline=None,
        database=None,
        print_blob=False,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    batch, found, told, sweeping = limit.first, None, io.StringIO(), limit.every > 0
    try:
        with contextlib.redirect_stdout(told):
            for example in EVERY[name]()[first_seed % limit.every :: limit.every] if limit.every else ():
                counted(example)
            sweeping = False
            while True:
                where[0] = batch
                seed(first_seed * 100_003 + batch)(options(given(STRATEGIES[name]())(counted)))()
                batch += 1
    except _Over:
        pass
    except (Exception, _TooMuchError) as e:
        lines = "".join(traceback.format_exception(e)) if isinstance(e, Exception) else f"{e}\n"
        if len(lines) > 6000:  # hypothesis adds the example, which may be long: where it happened comes before
            lines = f"{lines[:4000]}\n...\n{lines[-2000:]}"
        found = f"batch {batch}:\n{lines}{told.getvalue()[-2000:]}\nlast example: {repr(current)[:2000]}"
    return Result(count, worst, _peak(), 0.0, batch + 1, found)


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


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
