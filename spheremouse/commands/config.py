"""`spheremouse config`: show what is in force, check a file, write one to begin with."""

from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from spheremouse.errors import ConfigurationError, SpheremouseError

app = typer.Typer(no_args_is_help=True, help="Show, check or write a configuration file.")


def root() -> type[Any]:
    """The settings of the whole program; imported late, since it brings all of the core."""
    from spheremouse.session.settings import Configuration

    return Configuration


@app.command()
def show(
    file: Annotated[Path | None, typer.Option("--config", metavar="FILE", help="Configuration file.")] = None,
    assignments: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One parameter.")] = None,
) -> None:
    """Print the configuration in force; what differs from the default is marked."""
    from spheremouse.files import config

    try:
        settings = config.in_force(file, assignments or (), root())
    except SpheremouseError as e:
        _fail(e)
    typer.echo(config.dump(settings, root()()), nl=False)


@app.command()
def check(file: Annotated[Path, typer.Argument(metavar="FILE", show_default=False)]) -> None:
    """Check a configuration file and what it names: 'FILE: ok', or every problem with its line and exit code 2.

    Files are read, plug-ins found, slips in sources and outputs told, and the camera is asked for its sizes, which
    disturbs no run. What may be missing only now, as a camera that is not plugged in, is a warning.
    """
    from spheremouse.files import config
    from spheremouse.files.yaml import Problem, read_document
    from spheremouse.session.named import look

    try:
        document = read_document(file)
        found = look(file, config.loads(document, root()))
    except SpheremouseError as e:
        _fail(e)
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
) -> None:
    """Write a configuration file with every parameter, its unit, default and reason."""
    from spheremouse.files import config
    from spheremouse.files.atomic import write_atomically

    try:
        if file.is_dir():
            raise ConfigurationError(f"{file}: is a directory; name a file in it")
        if file.exists() and not force:
            raise ConfigurationError(f"{file}: exists already; choose another name, or replace it with --force")
        write_atomically(file, config.dump_commented(root()()))
    except SpheremouseError as e:
        _fail(e)
    typer.echo(f"{file}: written")


def _fail(error: SpheremouseError) -> NoReturn:
    typer.echo(str(error), err=True)
    raise typer.Exit(2)
