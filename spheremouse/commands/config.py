"""`spheremouse config`: print the settings in force, check a file, write a new one."""

from pathlib import Path
from typing import Annotated

import typer

from spheremouse.commands.options import Assignments, ConfigFile
from spheremouse.errors import SpheremouseError

app = typer.Typer(no_args_is_help=True, help="Show, check or write a configuration file.")


@app.command()
def show(file: ConfigFile = None, assignments: Assignments = None) -> None:
    """Print the settings in force, with the default of each one that differs from it."""
    from spheremouse.files import config
    from spheremouse.session.settings import Configuration

    settings = config.in_force(file, assignments or (), Configuration)
    typer.echo(config.dump(settings, Configuration()), nl=False)


@app.command()
def check(file: Annotated[Path, typer.Argument(metavar="FILE", show_default=False)]) -> None:
    """Check a configuration file and the files it names: 'FILE: ok', or every problem with its line and exit code 2.

    The command reads files, finds plug-ins, and checks sources and outputs. It opens no device. A device that is not
    plugged in is a warning.
    """
    from spheremouse.files import config
    from spheremouse.files.yaml import Problem, read_document
    from spheremouse.session.config_check import validate
    from spheremouse.session.settings import Configuration

    try:
        document = read_document(file)
        found = validate(file, config.loads(document, Configuration))
    except SpheremouseError as e:
        typer.echo(str(e), err=True)
        raise typer.Exit(2) from None
    problems = [*found.wrong, *(Problem(p.key, f"warning: {p.text}") for p in found.now)]
    for line in [*([str(document.error(problems))] if problems else []), *found.elsewhere]:
        typer.echo(line, err=True)
    if found.wrong or found.elsewhere:
        raise typer.Exit(2)
    typer.echo(f"{file}: ok")


@app.command()
def init(
    file: Annotated[Path, typer.Argument(metavar="[FILE]")] = Path("spheremouse.yaml"),
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Write the settings for experts, too.")] = False,
) -> None:
    """Write a configuration file with the settings of daily use, each with meaning, unit, bounds and default."""
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.files import config
    from spheremouse.files.safe_files import write_atomically
    from spheremouse.session.settings import Configuration

    check_outputs([file], [], force=force)
    write_atomically(file, config.dump_commented(Configuration(), None if everything else Configuration.COMMON))
    typer.echo(f"{file}: written")
