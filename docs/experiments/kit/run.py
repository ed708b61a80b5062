"""Jobs on all cores. Each result is kept in a file, so an interrupted run can continue."""

import hashlib
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from itertools import chain
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

import spheremouse
from experiments.kit.job import Job, Result
from spheremouse.files import plain_json
from spheremouse.files.safe_files import read_text, write_atomically

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_MAX_BYTES = 100_000_000  # of a job's result
_SECTION = b"# ---- section ----"  # from which on an experiment puts its results into words


@cache
def program() -> str:
    """Fingerprint of the code that films, tracks and compares: of all but what puts it into words."""
    ours, theirs = Path(__file__).parents[1], Path(spheremouse.__file__).parent
    files = [p for folder in (theirs, ours) for p in sorted(folder.rglob("*.py")) if p.name != "render.py"]
    return hashlib.sha256(b"".join(p.read_bytes().partition(_SECTION)[0] for p in files)).hexdigest()[:16]


def work_all(
    jobs: Iterable[Job], folder: Path, cores: int, again: bool = False, done: Callable[[Job], None] = lambda _: None
) -> dict[str, Result]:
    """Results by key; `done` hears of each. A job that fails has an `error`, and is tried again the next time."""
    wanted = list(jobs)
    results = {} if again else _kept(folder, wanted)
    for job in wanted:
        if job.key in results:
            done(job)
    todo = sorted((j for j in wanted if j.key not in results), key=lambda job: -job.cost)
    together, alone = [j for j in todo if not j.alone], [j for j in todo if j.alone]
    for job, result in chain(_worked(together, cores), _worked(alone, 1)):
        results[job.key] = result
        if "error" not in result:
            path = folder / f"{job.key}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, json.dumps({"program": program(), "recipe": job.recipe, "result": result}))
        done(job)
    return {job.key: results[job.key] for job in wanted}


def _kept(folder: Path, wanted: list[Job]) -> dict[str, Result]:
    """Results of an earlier run that still answer the same question."""
    found = {}
    for job in wanted:
        try:
            kept = plain_json.loads(read_text(folder / f"{job.key}.json", _MAX_BYTES, "result"), constants=True)
        except (OSError, ValueError):
            continue
        if isinstance(kept, dict) and kept.get("recipe") == job.recipe and kept.get("program") == program():
            found[job.key] = kept["result"]
    return found


def _worked(todo: list[Job], cores: int) -> Iterator[tuple[Job, Result]]:
    if not todo:
        return
    for name in _THREADS:  # one core each: threads of the linear algebra only wait for each other
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(cores, len(todo)), mp_context=context, initializer=_obedient) as pool:
        waiting = {pool.submit(_safely, job.work, job.parameters): job for job in todo}
        try:
            for future in as_completed(waiting):
                job = waiting[future]
                try:
                    yield job, future.result()
                except BrokenProcessPool:
                    yield job, {"error": "its process ended; was there too little memory?"}
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():  # its job may take minutes, and its result is not wanted
                child.terminate()
            raise


def _obedient() -> None:
    """In each worker: it ends with its parent, however that ends, and only then."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; the parent answers it
    parent = multiprocessing.parent_process()
    assert parent is not None, "a worker has one"

    def follow() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _safely(work: Callable[..., Result], parameters: dict[str, Any]) -> Result:
    try:
        return json.loads(json.dumps(work(**parameters)))  # as it will be read again
    except Exception as e:  # one job must not end the others: it becomes a row that says so
        return {"error": " ".join(f"{type(e).__name__}: {e}".split())[:300]}
