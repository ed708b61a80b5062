"""`spheremouse experiments`: repeat the experiments of the theses, and those that they left open, on all cores."""

import os
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table as Shown

from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import ConfigurationError
from spheremouse.experiments import NAMES
from spheremouse.experiments.kit.job import Job, Request, Result, Section, Table
from spheremouse.experiments.kit.run import work_all
from spheremouse.experiments.report.page import write_report
from spheremouse.files.report.style import require_matplotlib


def experiments(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder of experiments.md and its figures; made where needed.")
    ],
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help=f"Of {', '.join(NAMES)}.  [default: all]")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and shorter films: minutes.")] = False,
    datasets: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of the reference recordings (far26); without, their rows are missing."
        ),
    ] = None,
    cores: Annotated[int | None, typer.Option(metavar="N", help="Processes at a time.  [default: all cores]")] = None,
    again: Annotated[bool, typer.Option("--again", help="Do anew what is done already.")] = False,
) -> None:
    """Repeat the experiments of the theses, and those they left open, on all cores.

    What each film gave is kept in DIR/experiments/jobs until the program changes: a run that was interrupted goes on
    where it stopped. What fails becomes a row that says so, and exit code 1.
    """
    chosen = _chosen(names)
    if cores is not None and cores < 1:
        raise ConfigurationError(f"--cores: must be 1 or more, is {cores}")
    if datasets is not None and not datasets.is_dir():
        raise ConfigurationError(f"--datasets: {datasets}: no such folder")
    require_matplotlib()
    folder = out / "experiments" / "jobs"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise ConfigurationError(f"--out {out}: cannot be made a folder ({e.strerror}); name another") from None
    request = Request(quick, None if datasets is None else datasets.resolve())
    modules = {name: import_module(f"spheremouse.experiments.{name}") for name in chosen}
    jobs = {name: module.jobs(request) for name, module in modules.items()}
    results = _worked(jobs, folder, cores or os.cpu_count() or 1, again)
    reports = {name: import_module(f"spheremouse.experiments.report.{name}") for name in chosen}
    sections = {n: (modules[n].TITLE, report.section(request, results[n])) for n, report in reports.items()}
    console = Console(soft_wrap=True, highlight=False)
    if not console.is_terminal:
        console.width = 1000
    for title, section in sections.values():
        _show(console, title, section)
    words = ["spheremouse experiments", *(names or ()), *(["--quick"] if quick else [])]
    written = write_report(out, sections, " ".join([*words, *(["--datasets DIR"] if datasets else []), "--out DIR"]))
    failed = [f"{name}/{key}: {r['error']}" for name, of in results.items() for key, r in of.items() if "error" in r]
    for line in failed:
        console.print(f"failed: {line}", markup=False)
    print(f"{written[0]}: written, with {len(written) - 1} files beside it; what each film gave is kept in {folder}")
    if failed:
        raise typer.Exit(1)


def _chosen(names: list[str] | None) -> list[str]:
    for name in names or ():
        if name not in NAMES:
            raise ConfigurationError(f"unknown experiment {name!r}; there are {', '.join(NAMES)}")
    return [name for name in NAMES if not names or name in names]


def _worked(jobs: dict[str, list[Job]], folder: Path, cores: int, again: bool) -> dict[str, dict[str, Result]]:
    """All jobs in one queue; results by experiment and key."""
    wanted = [replace(job, key=f"{name}/{job.key}") for name, of in jobs.items() for job in of]
    with progress_bar() as bar:
        task = bar.add_task("experiments", total=len(wanted))
        found = work_all(wanted, folder, cores, again, lambda job: bar.update(task, advance=1, description=job.key))
    return {name: {job.key: found[f"{name}/{job.key}"] for job in of} for name, of in jobs.items()}


def _show(console: Console, title: str, section: Section) -> None:
    console.print(f"\n[bold]{title}[/bold]")
    for part in section.parts:
        if isinstance(part, Table):
            shown = Shown(title=part.title or None, title_justify="left")
            for k, name in enumerate(part.head):
                shown.add_column(name, justify="left" if k == 0 else "right")
            for row in part.rows:
                shown.add_row(*row)
            console.print(shown)
