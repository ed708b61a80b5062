"""`spheremouse ctl`: ask the running daemon how it is, and tell it what to do.

Exit codes: 0 done, 1 the daemon refuses (its reason is on standard error), 2 wrong usage, 3 no daemon that answers.
"""

import contextlib
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from spheremouse.commands import terminal
from spheremouse.errors import ControlError, printable
from spheremouse.session.control.client import Client, NoDaemonError

app = typer.Typer(no_args_is_help=True, help="Ask the running daemon how it is, and tell it what to do.")

REFUSED, NO_DAEMON = 1, 3

_COLOURS = {
    "starting": "cyan",
    "no-camera": "bold red",
    "searching-targets": "yellow",
    "tracking": "bold green",
    "lost": "bold yellow",
    "paused": "magenta",
    "failed-output": "bold red",
}

_WIDEST = 2 + max(map(len, _COLOURS))

_Json = Annotated[bool, typer.Option("--json", help="Print the reply as JSON.")]
_Socket = Annotated[
    Path | None,
    typer.Option(metavar="PATH", help="The daemon's socket.  [default: $SPHEREMOUSE_SOCKET, else where one answers]"),
]


@app.command(epilog="Example: spheremouse ctl status --json")
def status(as_json: _Json = False, socket: _Socket = None) -> None:
    """Show the state with its reason, frame rate, latency, discs, pose and output."""
    reply = _ask(socket, "status")
    if as_json:
        _print_json(reply)
    else:
        _console().print(status_table(reply))


@app.command()
def reinit(as_json: _Json = False, socket: _Socket = None) -> None:
    """Estimate the camera's pose anew, or look for balls in a hand anew; the pointer does not jump."""
    _report(_ask(socket, "reinit"), as_json, "looked for anew")


@app.command()
def pause(as_json: _Json = False, socket: _Socket = None) -> None:
    """Stop moving the pointer; tracking goes on."""
    _report(_ask(socket, "pause"), as_json, "paused; go on with: spheremouse ctl resume")


@app.command()
def resume(as_json: _Json = False, socket: _Socket = None) -> None:
    """Move the pointer again after a pause."""
    reply = _ask(socket, "resume")
    _report(reply, as_json, f"resumed: {reply['state']}" if reply.get("state") else "resumed")


@app.command()
def reload(as_json: _Json = False, socket: _Socket = None) -> None:
    """Read configuration and rig file anew; where one is wrong, what is in force stays."""
    _report(_ask(socket, "reload"), as_json, "reloaded")


@app.command("set", epilog="Example: spheremouse ctl set motion.scale_x=2")
def set_(
    assignments: Annotated[list[str], typer.Argument(metavar="KEY=VALUE...", show_default=False)],
    as_json: _Json = False,
    socket: _Socket = None,
) -> None:
    """Change parameters until the next start or reload: all of them or, where one is wrong, none. `save` keeps them."""
    _report(_ask(socket, "set", assignments=assignments), as_json, "set")


@app.command()
def save(as_json: _Json = False, socket: _Socket = None) -> None:
    """Write what was set into the daemon's configuration file; comments stay, and it holds at the next start."""
    from spheremouse.files import config
    from spheremouse.files.edit import save_settings
    from spheremouse.session.settings import Configuration

    status = _ask(socket, "status")
    file, changes = status.get("config"), status.get("changes") or []
    if file is None or not Path(file).is_file():
        _fail(ControlError("the daemon has no configuration file; start it with --config FILE to have one"))
    if changes:
        save_settings(
            Path(file), config.assigned(config.in_force(Path(file), changes, Configuration), changes), Configuration
        )
    told = f"saved: {', '.join(changes)}" if changes else "nothing was set that is not in it"
    _report({"file": file, "saved": changes}, as_json, told, "file")


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
    socket: _Socket = None,
) -> None:
    """Record what the camera sees as a dataset that run and evaluate replay."""
    if stop:
        if name is not None or seconds is not None or everything:
            raise typer.BadParameter("--stop goes alone")
        _report(_ask(socket, "record", stop=True), as_json, "the recording has ended")
        return
    reply = _ask(socket, "record", folder=name, seconds=seconds, everything=everything or None)
    _report(reply, as_json, "recording; end it with: spheremouse ctl record --stop", "folder")


@app.command()
def snapshot(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME.png]", help="Of the picture, below the daemon's recordings; no path.")
    ] = None,
    as_json: _Json = False,
    socket: _Socket = None,
) -> None:
    """Write the present picture to a file."""
    _report(_ask(socket, "snapshot", file=name), as_json, "written", "file")


@app.command(epilog="Example: spheremouse ctl watch --interval 5")
def watch(
    interval: Annotated[float, typer.Option(metavar="S", min=0.1, max=60.0, help="Between two lines, in s.")] = 1.0,
    as_json: _Json = False,
    socket: _Socket = None,
) -> None:
    """Print a line of status every second, and what the daemon logs, until Ctrl-C."""
    console = _console()
    with _failing(), contextlib.suppress(KeyboardInterrupt), Client(socket) as client:
        for event in client.watch(interval):
            if as_json:
                print(json.dumps(event), flush=True)
            else:
                console.print(event_line(event, time.strftime("%H:%M:%S")), soft_wrap=True)


@app.command()
def stop(as_json: _Json = False, socket: _Socket = None) -> None:
    """End the daemon; a service that systemd keeps is better stopped with systemctl."""
    _report(_ask(socket, "stop"), as_json, "the daemon ends")


# ---- what people read ----


def status_table(s: dict[str, Any]) -> Panel:
    """A status as a short table."""
    rows = Table.grid(padding=(0, 2))
    rows.add_column(style="dim", min_width=8)
    rows.add_column(overflow="fold")
    also = ", and paused" if s.get("paused") and s.get("state") != "paused" else ""
    rows.add_row("state", Text.assemble(_state(s), f" for {_span(s.get('since_s'))}{also}"))
    if s.get("reason"):
        rows.add_row("reason", _text(s["reason"]))
    rows.add_row("frames", _frames(s))
    rows.add_row("latency", _latency(s.get("latency_ms")))
    if s.get("balls") is None:
        rows.add_row("discs", f"{_n(s, 'discs')} used, {_n(s, 'discs_seen')} seen, {_n(s, 'discs_known')} known")
        rows.add_row("pose", _pose(s.get("pose")))
    for ball in s.get("balls") or ():
        rows.add_row("ball", _ball(ball))
    rows.add_row("motion", _motion(s))
    if s.get("changes"):
        rows.add_row("set", _text(f"{', '.join(map(str, s['changes']))} (until the next start; `ctl save` keeps it)"))
    rows.add_row("output", _output(s.get("output"), s.get("reason")))
    source = s.get("source") or {}
    rows.add_row("source", _text(source.get("description") or source.get("spec") or "-"))
    rows.add_row(
        "unseen", f"{_span(s.get('unseen_s'))} of {_span(s.get('uptime_s'))}, lost {_n(s, 'lost_count')} times"
    )
    if s.get("recording"):
        rows.add_row("recording", _recording(s["recording"]))
    head = Text.assemble((" spheremouse ", "bold"), f"{printable(s.get('version', ''))} │ process {_n(s, 'pid')} ")
    return Panel(rows, title=head, title_align="left", border_style="dim", expand=False)


def event_line(event: dict[str, Any], clock: str) -> Text:
    """An event of `watch` on one line."""
    if event.get("event") != "status":
        return Text.assemble((clock, "dim"), "  ", _text(event.get("text", "")))
    latency = event.get("latency_ms") or {}
    failed = (event.get("output") or {}).get("failed")
    parts = [
        f"{_number(event.get('fps'), '.1f'):>5} frames/s",
        f"latency {_number(latency.get('p50'), '.1f')}, 99 % {_number(latency.get('p99'), '.1f')} ms"
        if latency
        else "no latency",
        f"{_n(event, 'discs')}/{_n(event, 'discs_known')} discs"
        if event.get("balls") is None
        else ", ".join(f"{printable(b.get('name', ''))} {printable(b.get('state', ''))}" for b in event["balls"]),
    ]
    state = _state(event)
    state.pad_right(max(0, _WIDEST - len(state)))
    if event.get("motion"):
        parts.append(printable(event["motion"].get("words", "")))
    words = event.get("reason") if event.get("state") != "tracking" else f"output: {failed}" if failed else ""
    tail = f"  {printable(words)}" if words else ""
    return Text.assemble((clock, "dim"), "  ", state, "  ", "  ".join(parts), tail)


def _state(s: dict[str, Any]) -> Text:
    name = printable(s.get("state", "unknown"))
    return Text(f"● {name}", style=_COLOURS.get(name, ""))


def _frames(s: dict[str, Any]) -> str:
    lost = {"skipped": "skipped", "dropped": "dropped", "damaged": "damaged"}
    parts = [f"{s[key]} {words}" for key, words in lost.items() if s.get(key)]
    return ", ".join([f"{_number(s.get('fps'), '.1f')}/s, {_n(s, 'frames')} in all", *parts])


def _latency(values: Any) -> str:
    if not isinstance(values, dict):
        return "-"
    half, most, longest = (_number(values.get(k), ".1f") for k in ("p50", "p99", "max"))
    return f"median {half} ms, 99 % {most} ms, longest {longest} ms"


def _motion(s: dict[str, Any]) -> Text:
    """How the ball moves, and all that it has moved."""
    words = str((s.get("motion") or {}).get("words", "not known"))
    counts = s.get("counts")
    if counts:
        words += "; counts x {:+d}, y {:+d}, third {:+d}".format(*counts)
    return _text(words)


def _ball(ball: dict[str, Any]) -> Text:
    """A ball in a hand: where it is, and how sure that is."""
    words = f"{ball.get('name', '')} {ball.get('state', '')}"
    place, angles, sigma, turned = (ball.get(k) for k in ("position_m", "angles_deg", "sigma_mm", "sigma_deg"))
    if place and angles and sigma and turned:
        words += f": x {place[0]:+.3f}, y {place[1]:+.3f}, z {place[2]:.3f} m ±{max(sigma):.0f} mm"
        words += f"; yaw {angles[0]:+.0f}°, pitch {angles[1]:+.0f}°, roll {angles[2]:+.0f}° ±{max(turned):.1f}°"
    return _text(words)


def _pose(pose: Any) -> str:
    if not isinstance(pose, dict):
        return "not known"
    sigma = pose.get("sigma_mm") or []
    known = [v for v in sigma if isinstance(v, int | float)]
    return f"{_span(pose.get('age_s'))} old" + (f", within {max(known):.1f} mm (1 sigma)" if known else "")


def _output(output: Any, reason: Any) -> Text:
    if not isinstance(output, dict):
        return Text("-")
    spec = str(output.get("spec", "-"))
    text = _text(spec)
    if output.get("failed"):
        said = "failed" if output["failed"] == reason else printable(output["failed"]).removeprefix(f"{spec}: ")
        text.append(f": {said}", style="bold red")
    else:
        text.append(f", {output.get('reports', 0)} reports")
    if any(output.get("unsent") or ()):
        text.append(f", not sent: {' '.join(f'{n:+d}' for n in output['unsent'])} counts")
    return text


def _recording(r: dict[str, Any]) -> Text:
    dropped = f", {r['dropped']} dropped" if r.get("dropped") else ""
    megabytes = 1e-6 * (r.get("bytes") or 0)
    return _text(f"{r.get('folder')}: {_n(r, 'frames')} frames, {_span(r.get('seconds'))}, {megabytes:.0f} MB{dropped}")


def _span(seconds: Any) -> str:
    """A time as people say it."""
    if not isinstance(seconds, int | float):
        return "-"
    for size, limit, unit in ((1.0, 120.0, "s"), (60.0, 120.0, "min"), (3600.0, 48.0, "h")):
        if seconds / size < limit:
            return f"{seconds / size:.1f} {unit}" if seconds < 10.0 else f"{seconds / size:.0f} {unit}"
    return f"{seconds / 86400.0:.0f} days"


def _number(value: Any, form: str) -> str:
    return format(value, form) if isinstance(value, int | float) else "-"


def _n(s: dict[str, Any], key: str) -> str:
    value = s.get(key)
    return "-" if value is None else printable(value)


def _text(value: Any) -> Text:
    return Text(printable(value))


# ---- asking ----


def _ask(socket: Path | None, command: str, **arguments: Any) -> dict[str, Any]:
    with _failing(), Client(socket) as client:
        return client.ask(command, **arguments)


@contextlib.contextmanager
def _failing() -> Iterator[None]:
    """A ControlError as its line and its exit code."""
    try:
        yield
    except ControlError as e:
        _fail(e)


def _fail(error: ControlError) -> NoReturn:
    terminal.error(str(error))
    raise typer.Exit(NO_DAEMON if isinstance(error, NoDaemonError) else REFUSED)


def _report(reply: dict[str, Any], as_json: bool, words: str, place: str | None = None) -> None:
    """The daemon's own words, else ours; then what it wrote."""
    if as_json:
        _print_json(reply)
        return
    where = reply.get(place) if place else None
    told = reply.get("message")
    typer.echo(printable(told or (f"{where}: {words}" if where else words)))


def _print_json(reply: dict[str, Any]) -> None:
    print(json.dumps(reply, indent=1))


def _console() -> Console:
    return Console(highlight=False)
