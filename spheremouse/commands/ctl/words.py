"""Format the status: a table, and one line for each event."""

import json
from typing import Any

from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from spheremouse.errors import printable
from spheremouse.session.control import status

_COLOURS = {
    "starting": "cyan",
    "no-camera": "bold red",
    "searching-targets": "yellow",
    "tracking": "bold green",
    "lost": "bold yellow",
    "paused": "magenta",
    "failed-output": "bold red",
}

_MIN_SHIFT_MM = 2.0  # that the discs show for certain
_STATE_COLUMNS = 2 + max(map(len, _COLOURS))


def status_table(s: status.StatusReport) -> Panel:
    rows = Table.grid(padding=(0, 2))
    rows.add_column(style="dim", min_width=8)
    rows.add_column(overflow="fold")
    suffix = ", and paused" if s.paused and s.state != "paused" else ""
    rows.add_row("state", Text.assemble(_state(s), f" for {span(s.since_s)}{suffix}"))
    if s.reason:
        rows.add_row("reason", _text(s.reason))
    rows.add_row("frames", _frames(s))
    rows.add_row("latency", _latency(s.latency_ms))
    if s.balls is None:
        rows.add_row("points", f"{_number(s.discs)} used, {_number(s.discs_seen)} seen, {_number(s.discs_known)} known")
        rows.add_row("pose", _pose(s.pose))
        if s.centre_shift_mm is not None and s.centre_shift_mm >= _MIN_SHIFT_MM:
            rows.add_row("centre", f"{s.centre_shift_mm:.0f} mm from its place: worn bearings, or an inexact rig")
    for ball in s.balls or ():
        rows.add_row("ball", _ball(ball))
    rows.add_row("motion", _motion(s))
    if s.changes:
        rows.add_row("set", _text(f"{', '.join(s.changes)} (until the next start; `ctl save` keeps it)"))
    if s.saved:
        rows.add_row("saved", _text(f"{', '.join(s.saved)} (`ctl save --forget` goes back to the configuration file)"))
    for output in s.outputs:
        rows.add_row("output", _output(output, s.reason))
    if not s.cameras:
        rows.add_row("source", _text(s.source.description or s.source.spec))
    for number, camera in enumerate(s.cameras, 1):
        rows.add_row(f"camera {number}", _camera(camera))
    rows.add_row("unseen", f"{span(s.unseen_s)} of {span(s.uptime_s)}, lost {s.lost_count} times")
    if s.recording:
        rows.add_row("recording", _recording(s.recording))
    head = Text.assemble((" spheremouse ", "bold"), f"{printable(s.version)} │ process {s.pid} ")
    return Panel(rows, title=head, title_align="left", border_style="dim", expand=False)


def settings_table(reply: dict[str, Any]) -> Table:
    """Return the reply to `settings` as a table."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column(
        "key", no_wrap=True, min_width=max((len(s["key"]) for s in reply.get("settings") or ()), default=0)
    )
    for name in ("value", "default", "unit", "range"):
        table.add_column(name, overflow="fold")
    for setting in reply.get("settings") or ():
        value, default = (_json(setting.get(name)) for name in ("value", "default"))
        low, high, choices = (setting.get(name) for name in ("minimum", "maximum", "choices"))
        bounds = f"{low:g} to {high:g}" if isinstance(low, int | float) and isinstance(high, int | float) else ""
        allowed = ", ".join(map(_json, choices)) if isinstance(choices, list) else bounds
        style = "" if value == default else "bold"
        key, unit = (printable(setting.get(name) or "") for name in ("key", "unit"))
        table.add_row(key, Text(value, style=style), Text(default), unit, Text(allowed))
    return table


def _json(value: Any) -> str:
    return printable(value if isinstance(value, str) else json.dumps(value))


def event_line(event: status.StatusReport | str, clock: str) -> Text:
    """Return an event of `watch` in one line that begins with `clock`, the time as text."""
    if isinstance(event, str):
        return Text.assemble((clock, "dim"), "  ", _text(event))
    latency = event.latency_ms
    parts = [
        f"{event.fps:>5.1f} frames/s",
        f"latency {_number(latency.p50, '.1f')}, 99 % {_number(latency.p99, '.1f')} ms" if latency else "no latency",
        f"{_number(event.discs)}/{_number(event.discs_known)} points"
        if event.balls is None
        else ", ".join(f"{printable(b.name)} {printable(b.state)}" for b in event.balls),
    ]
    state = _state(event)
    state.pad_right(max(0, _STATE_COLUMNS - len(state)))
    if event.motion:
        parts.append(printable(event.motion.words))
    failed = next((f"output {o.spec}: {o.failed}" for o in event.outputs if o.failed), "")
    words = event.reason if event.state != "tracking" else failed
    tail = f"  {printable(words)}" if words else ""
    return Text.assemble((clock, "dim"), "  ", state, "  ", "  ".join(parts), tail)


def _state(s: status.StatusReport) -> Text:
    name = printable(s.state)
    return Text(f"● {name}", style=_COLOURS.get(name, ""))


def _frames(s: status.StatusReport) -> str:
    lost = {"skipped": s.skipped, "dropped": s.dropped, "damaged": s.damaged}
    parts = [f"{n} {word}" for word, n in lost.items() if n]
    return ", ".join([f"{s.fps:.1f}/s, {s.frames} in all", *parts])


def _latency(ms: status.Quantiles | None) -> str:
    if ms is None:
        return "-"
    half, slow, longest = (_number(value, ".1f") for value in (ms.p50, ms.p99, ms.max))
    return f"median {half} ms, 99 % {slow} ms, longest {longest} ms"


def _motion(s: status.StatusReport) -> Text:
    words = s.motion.words if s.motion else "not known"
    return _text(words + "; counts x {:+d}, y {:+d}, third {:+d}".format(*s.counts))


def _ball(ball: status.BallStatus) -> Text:
    words = f"{ball.name} {ball.state}"
    place, angles, sigma, turned = ball.position_m, ball.angles_deg, ball.sigma_mm, ball.sigma_deg
    if place and angles and sigma and turned:
        words += f": x {place[0]:+.3f}, y {place[1]:+.3f}, z {place[2]:.3f} m ±{max(sigma):.0f} mm"
        words += f"; yaw {angles[0]:+.0f}°, pitch {angles[1]:+.0f}°, roll {angles[2]:+.0f}° ±{max(turned):.1f}°"
    return _text(words)


def _pose(pose: status.PoseStatus | None) -> str:
    if pose is None:
        return "not known"
    return f"{span(pose.age_s)} old, within {max(pose.sigma_mm):.1f} mm (1 sigma)"


def _camera(camera: status.CameraStatus) -> Text:
    """Return one camera of two, with the reason why it takes no part."""
    text = _text(f"{camera.description or camera.spec}, {camera.frames} frames")
    if camera.trouble:
        text.append(f": {printable(camera.trouble)}", style="bold red")
    return text


def _output(output: status.OutputStatus, reason: str) -> Text:
    """Return the line of an output. A failure that is the `reason` of the state is not repeated."""
    text = _text(output.spec)
    if output.failed:
        failed = "failed" if output.failed == reason else printable(output.failed).removeprefix(f"{output.spec}: ")
        text.append(f": {failed}", style="bold red")
    else:
        text.append(f", {output.reports} reports")
    if any(output.unsent):
        text.append(f", not sent: {' '.join(f'{n:+d}' for n in output.unsent)} counts")
    if output.left_out:
        text.append(f"\n{printable(output.left_out)}", style="dim")
    return text


def _recording(r: status.RecordingStatus) -> Text:
    dropped = f", {r.dropped} dropped" if r.dropped else ""
    return _text(f"{r.folder}: {r.frames} frames, {span(r.seconds)}, {1e-6 * r.bytes:.0f} MB{dropped}")


def span(seconds: float) -> str:
    """Return a time, s, in a unit that suits it."""
    for size, limit, unit in ((1.0, 120.0, "s"), (60.0, 120.0, "min"), (3600.0, 48.0, "h")):
        if seconds / size < limit:
            return f"{seconds / size:.1f} {unit}" if seconds < 10.0 else f"{seconds / size:.0f} {unit}"
    return f"{seconds / 86400.0:.0f} days"


def _number(value: float | None, form: str = "") -> str:
    return "-" if value is None else format(value, form)


def _text(value: str) -> Text:
    return Text(printable(value))
