"""Repeat the experiments of the theses, and those that they left open, on all cores.

python docs/experiments NAME --quick --out DIR
"""

import os
import re
import sys
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse import __version__
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import ConfigurationError, SpheremouseError

sys.path.insert(0, str(Path(__file__).parents[1]))  # a folder that is run finds its own modules alone

from experiments import NAMES

if TYPE_CHECKING:
    from experiments.kit.job import Job, Result

_LINKS = re.compile(r"^!?\[.*\]\(experiments/.*\)\n", re.MULTILINE)


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

    DIR/experiments/jobs keeps the result of each film until the program changes, so an interrupted run continues.
    DIR/experiments.md has the sections of this run and, of other experiments, those of earlier runs. The report lists
    failures under their experiment, and the exit code is 1.
    """
    from rich.console import Console
    from rich.markdown import Markdown

    from experiments.kit.job import Request
    from experiments.kit.render import write_page, write_section

    chosen = _chosen(names)
    _check(cores, datasets)
    folder = _made(out)
    request = Request(quick, None if datasets is None else datasets.resolve())
    modules = {name: import_module(f"experiments.{name}") for name in chosen}
    jobs = {name: module.jobs(request) for name, module in modules.items()}
    results = _worked(jobs, folder, cores or os.cpu_count() or 1, again)
    console = Console(highlight=False)
    words = [*(names or ()), *(["--quick"] if quick else []), *(["--datasets DIR"] if datasets else []), "--out DIR"]
    made = f"Made by `{' '.join(['python docs/experiments', *words])}`, spheremouse {__version__}."
    made += " This is a quick run, mostly with one short film instead of several; not to be quoted." if quick else ""
    for name, module in modules.items():
        write_section(out / "experiments", name, module, results[name], made)
        console.print(Markdown(_LINKS.sub("", (out / "experiments" / f"{name}.md").read_text("utf-8"))))
    page = write_page(out, NAMES)
    failed = [f"{name}/{key}: {r['error']}" for name, of in results.items() for key, r in of.items() if "error" in r]
    for line in failed:
        console.print(f"failed: {line}", markup=False)
    print(f"{page}: written; its figures, its numbers and the result of each film are in {folder.parent}")
    if failed:
        raise typer.Exit(1)


def _chosen(names: list[str] | None) -> list[str]:
    for name in names or ():
        if name not in NAMES:
            raise ConfigurationError(f"unknown experiment {name!r}; there are {', '.join(NAMES)}")
    return [name for name in NAMES if not names or name in names]


def _check(cores: int | None, datasets: Path | None) -> None:
    if cores is not None and cores < 1:
        raise ConfigurationError(f"--cores: must be 1 or more, is {cores}")
    if datasets is not None and not datasets.is_dir():
        raise ConfigurationError(f"--datasets: {datasets}: no such folder")
    if find_spec("pandas") is None:
        raise ConfigurationError("the experiments need pandas: pip install pandas, or use make experiments")


def _made(out: Path) -> Path:
    folder = out / "experiments" / "jobs"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise ConfigurationError(f"--out {out}: cannot be made a folder ({e.strerror}); name another") from None
    return folder


def _worked(jobs: "dict[str, list[Job]]", folder: Path, cores: int, again: bool) -> "dict[str, dict[str, Result]]":
    """All jobs in one queue; results by experiment and key."""
    from experiments.kit.run import work_all

    wanted = [replace(job, key=f"{name}/{job.key}") for name, of in jobs.items() for job in of]
    with progress_bar() as bar:
        task = bar.add_task("experiments", total=len(wanted))
        found = work_all(wanted, folder, cores, again, lambda job: bar.update(task, advance=1, description=job.key))
    return {name: {job.key: found[f"{name}/{job.key}"] for job in of} for name, of in jobs.items()}


if __name__ == "__main__":
    app = typer.Typer(add_completion=False)
    app.command()(experiments)
    try:
        app()
    except SpheremouseError as e:
        sys.exit(f"experiments: {e}")
