"""`spheremouse ctl`: show the state of the running daemon, and send it requests.

Exit codes: 0 done, 1 the daemon refuses (its reason is on standard error), 2 wrong usage, 3 no daemon that answers.
"""

import contextlib
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spheremouse.commands import terminal
from spheremouse.commands.options import Socket
from spheremouse.errors import ControlError, printable

if TYPE_CHECKING:
    from spheremouse.session.control.client import Client

app = typer.Typer(no_args_is_help=True, help="Show the state of the running daemon, and send it requests.")

REFUSED, NO_DAEMON = 1, 3

_Json = Annotated[bool, typer.Option("--json", help="Print the reply as JSON.")]
_Config = Annotated[
    Path | None,
    typer.Option(
        "--config", metavar="FILE", help="Configuration file to write.  [default: the daemon's, if you or root run it]"
    ),
]


@app.command(epilog="Example: spheremouse ctl status --json")
def status(as_json: _Json = False, socket: Socket = None) -> None:
    """Show the state with its reason, frame rate, latency, discs, pose and output."""
    with _client(socket) as client:
        report = client.status()
    if as_json:
        _print_json(report.as_json())
    else:
        from rich.console import Console

        from spheremouse.commands.ctl.words import status_table

        Console(highlight=False).print(status_table(report))


@app.command()
def reinit(as_json: _Json = False, socket: Socket = None) -> None:
    """Estimate a new camera pose, or search for the balls in a hand again. The pointer does not jump."""
    _report(_ask(socket, "reinit"), "searched again", as_json=as_json)


@app.command()
def pause(as_json: _Json = False, socket: Socket = None) -> None:
    """Stop moving the pointer; tracking goes on."""
    _report(_ask(socket, "pause"), "paused; go on with: spheremouse ctl resume", as_json=as_json)


@app.command()
def resume(as_json: _Json = False, socket: Socket = None) -> None:
    """Move the pointer again after a pause."""
    reply = _ask(socket, "resume")
    _report(reply, f"resumed: {reply['state']}" if reply.get("state") else "resumed", as_json=as_json)


@app.command()
def reload(as_json: _Json = False, socket: Socket = None) -> None:
    """Read the configuration and the rig file again. If one has an error, the daemon keeps its settings."""
    _report(_ask(socket, "reload"), "reloaded", as_json=as_json)


@app.command("set", epilog="Example: spheremouse ctl set motion.scale_x=2 --save")
def set_(
    assignments: Annotated[list[str], typer.Argument(metavar="KEY=VALUE...", show_default=False)],
    keep: Annotated[bool, typer.Option("--save", help="Write these settings into the configuration file too.")] = False,
    config: _Config = None,
    as_json: _Json = False,
    socket: Socket = None,
) -> None:
    """Change parameters until the next start or reload: all of them or, if one is invalid, none.

    Prints each old and new value. The daemon refuses what cannot take effect. `save` keeps the changes.
    """
    from spheremouse.files.config import key_of

    place = _file_to_write(socket, config, assignments) if keep else None
    reply = _ask(socket, "set", assignments=assignments)
    if not as_json:
        _report(reply, "set")
    if keep:
        keys = [key_of(assignment) for assignment in assignments]
        saved = _ask(socket, "save", keys=keys) if place is None else _write(*place)
        reply |= saved
        if not as_json:
            _report(saved, _saved_words(saved), "file")
    if as_json:
        _print_json(reply)


@app.command()
def settings(as_json: _Json = False, socket: Socket = None) -> None:
    """List the settings that the tracker reads: key, value, default, unit and range; changed values are bold."""
    reply = _ask(socket, "settings")
    if as_json:
        _print_json(reply)
        return
    from rich.console import Console

    from spheremouse.commands.ctl.words import settings_table

    Console(highlight=False).print(settings_table(reply))


@app.command()
def reset(
    keys: Annotated[list[str], typer.Argument(metavar="KEY...", show_default=False)],
    as_json: _Json = False,
    socket: Socket = None,
) -> None:
    """Set parameters to their defaults, as `set` does."""
    from spheremouse.files.exchange import defaults

    _set_all(socket, defaults(_ask(socket, "settings")["settings"], keys), as_json)


@app.command()
def export(socket: Socket = None) -> None:
    """Print the settings that differ from their defaults, as a configuration file."""
    from spheremouse.files.exchange import export_settings

    typer.echo(export_settings(_ask(socket, "settings")["settings"]), nl=False)


@app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", show_default=False)],
    as_json: _Json = False,
    socket: Socket = None,
) -> None:
    """Read a file that `export` wrote, and set its parameters as `set` does."""
    from spheremouse.files.exchange import import_settings
    from spheremouse.files.yaml import read_document

    _set_all(socket, import_settings(_ask(socket, "settings")["settings"], read_document(file)), as_json)


def _set_all(socket: Path | None, values: dict[str, Any], as_json: bool) -> None:
    if not values:
        typer.echo("nothing differs")
        return
    assignments = [f"{key}={json.dumps(value)}" for key, value in values.items()]
    _report(_ask(socket, "set", assignments=assignments), "set", as_json=as_json)


@app.command(epilog="Example: spheremouse ctl profile doom")
def profile(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Of the configuration's `profiles`.")] = None,
    as_json: _Json = False,
    socket: Socket = None,
) -> None:
    """Use a profile of the configuration file until the next start or reload; without NAME, list the profiles.

    A profile replaces the changes by `set` and by another profile. `reload` ends it, and `save` keeps it.
    """
    reply = _ask(socket, "profile", name=name)
    if as_json or name is not None:
        _report(reply, f"profile {name}", as_json=as_json)
        return
    profiles = reply.get("profiles")
    if isinstance(profiles, dict) and profiles:
        for key, values in profiles.items():
            typer.echo(printable(f"{key}: {', '.join(map(str, values)) if isinstance(values, list) else values}"))
    else:
        typer.echo("there are no profiles; write `profiles:` into the configuration file (docs/configuration.md)")


@app.command()
def save(
    config: _Config = None,
    forget: Annotated[
        bool, typer.Option("--forget", help="Remove what the system's service saved, and read its configuration again.")
    ] = False,
    as_json: _Json = False,
    socket: Socket = None,
) -> None:
    """Write what was set into the daemon's configuration file. Comments stay, and it holds at the next start.

    The system's service may not write there. It saves in its state folder, which overrides the configuration file.
    """
    place = None if forget else _file_to_write(socket, config)
    saved = _ask(socket, "save", forget=forget or None) if place is None else _write(*place)
    _report(saved, _saved_words(saved), "file", as_json=as_json)


def _file_to_write(
    socket: Path | None, config: Path | None, assignments: list[str] | None = None
) -> tuple[Path, list[str]] | None:
    from spheremouse.session.control.client import settings_to_save

    with _client(socket) as client:
        return settings_to_save(client, config, assignments)


def _write(file: Path, changes: list[str]) -> dict[str, Any]:
    from spheremouse.files import config
    from spheremouse.files.edit import save_settings
    from spheremouse.session.settings import Configuration

    if changes:
        settings = config.in_force(file, changes, Configuration)
        save_settings(file, config.assigned_values(settings, changes), Configuration)
    return {"file": str(file), "saved": changes}


def _saved_words(saved: dict[str, Any]) -> str:
    return f"saved: {', '.join(saved['saved'])}" if saved.get("saved") else "nothing was set that is not in it"


@app.command(epilog="Example: spheremouse ctl record --seconds 60")
def record(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Of the folder, below the daemon's recordings; no path.")
    ] = None,
    seconds: Annotated[float | None, typer.Option(metavar="S", help="Length in s.  [default: as configured]")] = None,
    everything: Annotated[
        bool,
        typer.Option(
            "--everything",
            help="Keep the whole picture, not only the ball and the targets; needed for balls in a hand.",
        ),
    ] = False,
    stop: Annotated[bool, typer.Option("--stop", help="End the recording that runs.")] = False,
    as_json: _Json = False,
    socket: Socket = None,
) -> None:
    """Record what the camera sees as a dataset that run and evaluate replay."""
    if stop:
        if name is not None or seconds is not None or everything:
            raise typer.BadParameter("--stop goes alone")
        _report(_ask(socket, "record", stop=True), "the recording has ended", as_json=as_json)
        return
    reply = _ask(socket, "record", folder=name, seconds=seconds, everything=everything or None)
    _report(reply, "recording; end it with: spheremouse ctl record --stop", "folder", as_json=as_json)


@app.command()
def snapshot(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME.png]", help="Of the picture, below the daemon's recordings; no path.")
    ] = None,
    everything: Annotated[
        bool, typer.Option("--everything", help="Keep the whole picture, with all people in it.")
    ] = False,
    as_json: _Json = False,
    socket: Socket = None,
) -> None:
    """Write the present picture to a file, with the results; while targets are searched, with the rejected ones."""
    _report(_ask(socket, "snapshot", file=name, everything=everything or None), "written", "file", as_json=as_json)


@app.command(epilog="Example: spheremouse ctl replay --speed 0.25 --begin 2 --end 4")
def replay(
    speed: Annotated[
        float | None, typer.Option(metavar="X", min=0.05, max=20.0, help="1 is the recording's own speed.")
    ] = None,
    loop: Annotated[
        bool | None, typer.Option("--loop/--once", help="Play again and again, or pause at the end.")
    ] = None,
    begin: Annotated[float | None, typer.Option(metavar="S", min=0.0, help="Begin of the section, in s.")] = None,
    end: Annotated[
        float | None, typer.Option(metavar="S", min=0.0, help="End of the section, in s; 0 is that of the recording.")
    ] = None,
    step: Annotated[bool, typer.Option("--step", help="Pause, and play one more frame.")] = False,
    rewind: Annotated[bool, typer.Option("--rewind", help="Go back to the begin of the section.")] = False,
    as_json: _Json = False,
    socket: Socket = None,
) -> None:
    """Control a recording that `run --replay` plays. `pause` stops it."""
    given = {"speed": speed, "loop": loop, "begin": begin, "end": end, "step": step or None, "rewind": rewind or None}
    _report(_ask(socket, "replay", **given), "done", as_json=as_json)


@app.command(epilog="Example: spheremouse ctl watch --interval 5")
def watch(
    interval: Annotated[float, typer.Option(metavar="S", min=0.1, max=60.0, help="Between two lines, in s.")] = 1.0,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the sample of each ball and frame as JSON instead (docs/samples.md).")
    ] = False,
    socket: Socket = None,
) -> None:
    """Print a line of status every second, and the lines of the daemon's log, until Ctrl-C."""
    if as_json:
        _print_samples(socket)
        return
    from rich.console import Console

    from spheremouse.commands.ctl.words import event_line

    console = Console(highlight=False)
    with _client(socket) as client, contextlib.suppress(KeyboardInterrupt):
        for event in client.watch(interval):
            console.print(event_line(event, time.strftime("%H:%M:%S")), soft_wrap=True)


def _print_samples(socket: Path | None) -> None:
    with _client(socket) as client:
        try:
            with contextlib.suppress(KeyboardInterrupt):
                for sample in client.sample_objects():
                    print(json.dumps(sample, separators=(",", ":")), flush=True)
        finally:
            if client.dropped:
                terminal.error(f"{client.dropped} samples dropped, because their reader was too slow")


@app.command()
def stop(as_json: _Json = False, socket: Socket = None) -> None:
    """End the daemon. Stop a service with systemctl instead."""
    _report(_ask(socket, "stop"), "the daemon ends", as_json=as_json)


def _ask(socket: Path | None, command: str, **arguments: Any) -> dict[str, Any]:
    with _client(socket) as client:
        return client.ask(command, **arguments)


@contextlib.contextmanager
def _client(socket: Path | None) -> "Iterator[Client]":
    """Connect to the daemon. Its errors become a line and our exit codes."""
    from spheremouse.session.control.client import Client, NoDaemonError

    try:
        with Client(socket) as client:
            yield client
    except ControlError as e:
        terminal.error(str(e))
        raise typer.Exit(NO_DAEMON if isinstance(e, NoDaemonError) else REFUSED) from None


def _report(reply: dict[str, Any], words: str, place: str | None = None, *, as_json: bool = False) -> None:
    """Print the daemon's message, else our words with the path that it wrote."""
    if as_json:
        _print_json(reply)
        return
    where = reply.get(place) if place else None
    message = reply.get("message")
    typer.echo(printable(message or (f"{where}: {words}" if where else words)))


def _print_json(reply: dict[str, Any]) -> None:
    print(json.dumps(reply, indent=1))
