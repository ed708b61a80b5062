"""Format the status: a table, and one line for each event."""

from typing import Any

from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from spheremouse.errors import printable

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


def status_table(s: dict[str, Any]) -> Panel:
    """Return a status as a short table."""
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
    """Return an event of `watch` in one line that begins with `clock`, the time as text."""
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
    if not values:
        return "-"
    half, most, longest = (_number(values.get(k), ".1f") for k in ("p50", "p99", "max"))
    return f"median {half} ms, 99 % {most} ms, longest {longest} ms"


def _motion(s: dict[str, Any]) -> Text:
    """Return the motion of the ball, and its sum."""
    words = str((s.get("motion") or {}).get("words", "not known"))
    counts = s.get("counts")
    if counts:
        words += "; counts x {:+d}, y {:+d}, third {:+d}".format(*counts)
    return _text(words)


def _ball(ball: dict[str, Any]) -> Text:
    """Return place and attitude of a ball in a hand, with standard deviations."""
    words = f"{ball.get('name', '')} {ball.get('state', '')}"
    place, angles, sigma, turned = (ball.get(k) for k in ("position_m", "angles_deg", "sigma_mm", "sigma_deg"))
    if place and angles and sigma and turned:
        words += f": x {place[0]:+.3f}, y {place[1]:+.3f}, z {place[2]:.3f} m ±{max(sigma):.0f} mm"
        words += f"; yaw {angles[0]:+.0f}°, pitch {angles[1]:+.0f}°, roll {angles[2]:+.0f}° ±{max(turned):.1f}°"
    return _text(words)


def _pose(pose: Any) -> str:
    if not pose:
        return "not known"
    sigma = pose.get("sigma_mm")
    return f"{_span(pose.get('age_s'))} old" + (f", within {max(sigma):.1f} mm (1 sigma)" if sigma else "")


def _output(output: Any, reason: Any) -> Text:
    if not output:
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
    if output.get("left_out"):
        text.append(f"\n{printable(output['left_out'])}", style="dim")
    return text


def _recording(r: dict[str, Any]) -> Text:
    dropped = f", {r['dropped']} dropped" if r.get("dropped") else ""
    megabytes = 1e-6 * (r.get("bytes") or 0)
    return _text(f"{r.get('folder')}: {_n(r, 'frames')} frames, {_span(r.get('seconds'))}, {megabytes:.0f} MB{dropped}")


def _span(seconds: float | None) -> str:
    """Return a time in a convenient unit."""
    if seconds is None:
        return "-"
    for size, limit, unit in ((1.0, 120.0, "s"), (60.0, 120.0, "min"), (3600.0, 48.0, "h")):
        if seconds / size < limit:
            return f"{seconds / size:.1f} {unit}" if seconds < 10.0 else f"{seconds / size:.0f} {unit}"
    return f"{seconds / 86400.0:.0f} days"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _n(s: dict[str, Any], key: str) -> str:
    value = s.get(key)
    return "-" if value is None else printable(value)


def _text(value: Any) -> Text:
    return Text(printable(value))
