"""`spheremouse experiments`: repeat the experiments of the theses with simulated films, on all cores.

What is done is kept in a folder, job by job: a run that was interrupted goes on where it stopped.
"""

import json
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from spheremouse import __version__
from spheremouse.cli_evaluate_wand import axes, shown
from spheremouse.errors import ConfigurationError
from spheremouse.progress import progress_bar
from spheremouse.wand_experiments import Job, Row, jobs, measure_speeds, rows, verdicts, work
from spheremouse.yaml_file import write_atomically, write_json

app = typer.Typer(no_args_is_help=True, help="Repeat the experiments of the theses with simulated films.")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@app.callback()
def _experiments() -> None:
    """Repeat the experiments of the theses with simulated films."""


@app.command(epilog="Example: spheremouse experiments wand --quick --out figures")
def wand(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the results; made where it is not.")],
    quick: Annotated[bool, typer.Option("--quick", help="4 seeds and fewer films: minutes.")] = False,
    cores: Annotated[int | None, typer.Option(metavar="N", help="Processes at a time.  [default: all cores]")] = None,
    again: Annotated[bool, typer.Option("--again", help="Do anew what is done already.")] = False,
) -> None:
    """The hand-held ball: accuracy, runs that lose it, start without a pose, speed (Grzonka 2005, chapter 4)."""
    if cores is not None and cores < 1:
        raise ConfigurationError(f"--cores: must be 1 or more, is {cores}")
    folder = out / "wand"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise ConfigurationError(f"--out {out}: cannot be made a folder ({e.strerror}); name another") from None
    wanted = jobs(quick)
    results = {} if again else _done(folder, wanted)
    todo = [job for job in wanted if job.key not in results]
    with progress_bar() as bar:
        task = bar.add_task("films", total=len(wanted), completed=len(results))
        for job, result in _worked(todo, cores or os.cpu_count() or 1):
            results[job.key] = result
            if "error" not in result:
                write_atomically(folder / f"{job.key}.json", json.dumps(result))
            bar.advance(task)
    speeds = measure_speeds()  # when nothing else of ours runs
    table = rows(quick, results)
    console = Console(soft_wrap=True, highlight=False)
    if not console.is_terminal:
        console.width = 1000
    console.print(_films_table(table))
    console.print(_verdict_table(table, speeds))
    for row in table[:]:
        for failure in row.failures:
            console.print(f"{row.film.name}, {row.variant}: {failure}", markup=False)
    write_atomically(out / "wand.md", _markdown(table, speeds, quick))
    write_json(out / "wand.json", _figures(table, speeds, quick))
    print(f"{out / 'wand.md'}, {out / 'wand.json'}: written; what each film gave is kept in {folder}")
    if any(row.failures for row in table):
        raise typer.Exit(1)


def _done(folder: Path, wanted: list[Job]) -> dict[str, dict[str, Any]]:
    """Results of an earlier run that still answer the same question."""
    found = {}
    for job in wanted:
        try:
            result = json.loads((folder / f"{job.key}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        if isinstance(result, dict) and result.get("recipe") == job.recipe:
            found[job.key] = result
    return found


def _worked(todo: list[Job], cores: int) -> Iterator[tuple[Job, dict[str, Any]]]:
    """Jobs with their results as they come; a job that fails has an `error`."""
    if not todo:
        return
    for name in _THREADS:  # one core each: threads of the linear algebra only wait for each other
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(cores, len(todo)), mp_context=context) as pool:
        waiting = {pool.submit(_safely, job): job for job in todo}
        try:
            for future in as_completed(waiting):
                job = waiting[future]
                try:
                    yield job, future.result()
                except BrokenProcessPool:
                    yield job, {"error": "its process ended; was there too little memory?"}
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _safely(job: Job) -> dict[str, Any]:
    try:
        return work(job)
    except Exception as e:  # one job must not end the others: it becomes a row that says so
        return {"error": " ".join(f"{type(e).__name__}: {e}".split())[:300]}


# ---- for a reader ----

_COLUMNS = (
    ("film", False),
    ("particles", False),
    ("runs", True),
    ("lost", True),
    ("tracked, %", True),
    ("found in 5", True),
    ("p95 x  y  z, cm", True),
    ("max x  y  z, cm", True),
    ("rotation p95, max, °", True),
    ("ANEES position, rotation", True),
    ("within 95 %, %", True),
)


def _cells(row: Row) -> list[str]:
    figures = row.figures
    if row.runs == 0:
        failed = "failed: see below" if row.failures else "not done"
        return [f"{row.film.name}: {row.film.words}", row.variant, "0", failed, *["–"] * (len(_COLUMNS) - 4)]
    name = f"{row.film.name}: {row.film.words}" + (f" ({len(row.failures)} failed)" if row.failures else "")
    return [
        name,
        row.variant,
        str(row.runs),
        str(row.lost),
        f"{100.0 * row.tracked:.1f}",
        str(row.found),
        axes(figures["position_p95_mm"], ".2f", 0.1),
        axes(figures["position_max_mm"], ".2f", 0.1),
        f"{shown(figures['rotation_p95_deg'], '.2f')}  {shown(figures['rotation_max_deg'], '.2f')}",
        f"{shown(figures['anees']['position'])}  {shown(figures['anees']['rotation'])}",
        "–" if figures["within_95"] is None else f"{100.0 * figures['within_95']:.1f}",
    ]


def _films_table(table: list[Row]) -> Table:
    shown_table = Table(title="wand: films and trackers", title_justify="left")
    for name, right in _COLUMNS:
        shown_table.add_column(name, justify="right" if right else "left")
    for row in table:
        shown_table.add_row(*_cells(row))
    return shown_table


def _verdict_table(table: list[Row], speeds: dict[str, Any]) -> Table:
    shown_table = Table(title="wand: what is to be reached", title_justify="left")
    for name in ("", "thesis", "ours", "reached"):
        shown_table.add_column(name)
    for asked, thesis, ours, good in verdicts(table, speeds):
        shown_table.add_row(asked, thesis, ours, _word(good))
    return shown_table


def _word(good: bool | None) -> str:
    return "not measured" if good is None else "yes" if good else "no"


def _markdown(table: list[Row], speeds: dict[str, Any], quick: bool) -> str:
    lines = [
        "# Experiments of the wand",
        "",
        f"`spheremouse experiments wand{' --quick' if quick else ''}`, spheremouse {__version__}, simulated films.",
        "",
        "| asked | thesis | ours | reached |",
        "| --- | --- | --- | --- |",
    ]
    for asked, thesis, ours, good in verdicts(table, speeds):
        lines.append(f"| {asked} | {thesis} | {ours} | {_word(good)} |")
    lines += ["", f"| {' | '.join(name for name, _ in _COLUMNS)} |", f"|{' --- |' * len(_COLUMNS)}"]
    lines += [f"| {' | '.join(_cells(row))} |" for row in table]
    lines += ["", "| speed | median fps | mean fps | 90th percentile, ms |", "| --- | --- | --- | --- |"]
    for name, speed in speeds.items():
        lines.append(f"| {name} | {speed['fps']:.0f} | {speed['mean_fps']:.0f} | {speed['p90_ms']:.1f} |")
    failures = [f"- {row.film.name}, {row.variant}: {f}" for row in table for f in row.failures]
    return "\n".join([*lines, *(["", "Failed:", "", *failures] if failures else [])]) + "\n"


def _figures(table: list[Row], speeds: dict[str, Any], quick: bool) -> dict[str, Any]:
    return {
        "quick": quick,
        "rows": [
            {
                "film": row.film.name,
                "variant": row.variant,
                "runs": row.runs,
                "lost_runs": row.lost,
                "found_within_5": row.found,
                "tracked": row.tracked,
                "failures": list(row.failures),
                **row.figures,
            }
            for row in table
        ],
        "speeds": speeds,
        "reached": [
            {"asked": asked, "thesis": thesis, "ours": ours, "reached": good}
            for asked, thesis, ours, good in verdicts(table, speeds)
        ],
    }
