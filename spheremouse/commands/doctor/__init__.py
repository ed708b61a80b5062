"""`spheremouse doctor`: check everything from the camera to the pointer."""

import json
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.commands.options import Balls, CameraFile, RigFile, settings_given


def doctor(
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Configuration file.  [default: that of the daemon or of the service]"),
    ] = None,
    source: Annotated[
        str | None, typer.Option(metavar="KIND:ARG", help="As of run.  [default: as configured, else the first camera]")
    ] = None,
    output: Annotated[
        list[str] | None, typer.Option(metavar="KIND:ARG", help="As of run.  [default: as configured, else auto]")
    ] = None,
    rig: RigFile = None,
    camera: CameraFile = None,
    tracker: Annotated[
        str | None, typer.Option(metavar="so3|ekf1|ekf2|wand", help="As of run; wand looks for balls in a hand.")
    ] = None,
    balls: Balls = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="As JSON for a bug report: without names, home folder, serial numbers.")
    ] = False,
) -> None:
    """Check everything from the camera to the pointer, and print a remedy for each fault.

    It takes about five seconds, two of them with the camera, and changes nothing. A running daemon keeps its camera;
    the report then has the daemon's figures. The exit code is 1 if anything is wrong.
    """
    from rich.console import Console

    from spheremouse.commands.doctor.examine import examine
    from spheremouse.commands.doctor.private import redactor
    from spheremouse.commands.findings import Section, data, show, summary
    from spheremouse.errors import ConfigurationError
    from spheremouse.finding import Verdict
    from spheremouse.session.run_config import CommandLineOverrides

    if balls and tracker != "wand":
        raise ConfigurationError("--ball: goes with --tracker wand; add that, or leave it out")
    options = {"tracker": tracker, "source": source, "output": output}
    options |= {"rig": rig, "camera_file": camera, "wand.balls": balls}
    overrides = CommandLineOverrides(config, settings_given([], config, options))
    console = Console(highlight=False, soft_wrap=False)
    sections: list[Section] = []
    with Console(stderr=True, quiet=as_json).status("") as status:  # only a terminal shows it
        for section in examine(overrides, progress=lambda text: status.update(f"{text} ...")):
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
