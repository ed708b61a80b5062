"""`spheremouse doctor`: what is well, what is not, and what to do about it."""

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import typer


def doctor(
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Configuration file.  [default: that of the daemon or of the service]"),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(metavar="KIND:ARG", help="As of run.  [default: as configured, else the first camera]"),
    ] = None,
    output: Annotated[
        str | None, typer.Option(metavar="KIND:ARG", help="As of run.  [default: as configured, else auto]")
    ] = None,
    rig: Annotated[Path | None, typer.Option(metavar="FILE", help="The device as calibrated.")] = None,
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Interior orientation in place of the rig's.")
    ] = None,
    tracker: Annotated[
        str | None, typer.Option(metavar="so3|ekf1|ekf2|wand", help="As of run; wand looks for balls in a hand.")
    ] = None,
    balls: Annotated[
        list[Path] | None,
        typer.Option("--ball", metavar="FILE", help="As of run, with --tracker wand; may be repeated."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="As JSON for a bug report: without names, home folder, serial numbers.")
    ] = False,
) -> None:
    """Look at everything from the camera to the pointer, and say what to do.

    Takes some five seconds, two of them with the camera; changes nothing. A daemon that runs keeps its camera: it is
    asked instead. Exit code 0 where nothing is wrong, 1 where something is.
    """
    from rich.console import Console

    from spheremouse.commands.doctor.examine import examine
    from spheremouse.commands.doctor.finding import Section, Verdict
    from spheremouse.commands.doctor.private import redactor
    from spheremouse.commands.doctor.report import data, show, summary
    from spheremouse.errors import ConfigurationError
    from spheremouse.session.plan import Request

    if balls and tracker != "wand":
        raise ConfigurationError("--ball: goes with --tracker wand; add that, or leave it out")
    said = [] if tracker is None else [f"tracker={tracker}"]
    said += [f"wand.balls={json.dumps([str(path.absolute()) for path in balls])}"] if balls else []
    request = Request(config, tuple(said), source, output, rig, camera)
    console = Console(highlight=False, soft_wrap=False)
    sections: list[Section] = []
    with _waiting(quiet=as_json) as say:
        for section in examine(request, say=say):
            sections.append(section)
            if not as_json:
                show(section, console)
    if as_json:
        print(json.dumps(redactor()(data(sections)), indent=2, ensure_ascii=False))
    else:
        console.print(summary(sections))
        console.print("for a bug report: spheremouse doctor --json", style="dim")
    if any(f.verdict is Verdict.WRONG for s in sections for f in s.findings):
        raise typer.Exit(1)


@contextlib.contextmanager
def _waiting(*, quiet: bool) -> Iterator[Callable[[str], None]]:
    """A line on what is being done, on a terminal's standard error while it takes."""
    from rich.console import Console

    console = Console(stderr=True)
    if quiet or not console.is_terminal:
        yield lambda _: None
        return
    with console.status("") as status:
        yield lambda text: status.update(f"{text} ...")
