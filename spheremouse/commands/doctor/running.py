"""The running daemon, by its status."""

from pathlib import Path
from typing import Any

from spheremouse import __version__
from spheremouse.errors import ControlError
from spheremouse.finding import Finding, Verdict, classify, ok, unchecked, wrong
from spheremouse.session.control.client import Client, NoDaemonError

_MAX_LOST = 0.01  # of the frames; the filter bridges fewer
_MAX_INTERVALS = 2.0  # from mid-exposure to the event: one to read the frame out and carry it here, one to work on it
_MIN_DISCS = 3  # discs that hold the attitude and check it
_ADVICE = {
    "starting": "wait; the first start compiles for a minute",
    "no-camera": "see its cable and hub, and `ls -l /dev/v4l/by-id`",
    "searching-targets": "uncover and light the targets on the frame",
    "lost": "uncover the ball, or turn it; light on it",
    "failed-output": "see the section output",
    "paused": "spheremouse ctl resume",
}


def ask(socket: Path | None = None) -> tuple[dict[str, Any] | None, Finding]:
    """Return the daemon's status; None if none answers."""
    try:
        with Client(socket) as client:
            status = client.ask("status")
    except NoDaemonError:
        return None, ok("daemon", "none runs: the camera is free")
    except ControlError as e:
        return None, unchecked("daemon", str(e).partition("; ")[0], str(e).partition("; ")[2])
    age = _span(float(status.get("uptime_s") or 0.0))
    text = f"process {status.get('pid')}, version {status.get('version')}, for {age}"
    other, advice = status.get("version") != __version__, "restart it to run the installed version"
    return status, classify("daemon", text, (other, Verdict.WARNING, f"; this program is {__version__}", advice))


def check(status: dict[str, Any]) -> list[Finding]:
    """Return findings about a status; missing keys are left out."""
    checks = (_state, _frames, _latency, _discs, _motion, _output)
    return [found for each in checks if (found := each(status)) is not None]


def _state(s: dict[str, Any]) -> Finding:
    state = str(s.get("state"))
    verdict = {"tracking": Verdict.OK, "no-camera": Verdict.WRONG, "failed-output": Verdict.WRONG}
    text, advice = f"{state}: {s.get('reason')}", _ADVICE.get(state, "")
    return Finding("state", verdict.get(state, Verdict.WARNING), text, advice, {"state": state})


def _frames(s: dict[str, Any]) -> Finding | None:
    fps, frames = s.get("fps"), int(s.get("frames") or 0)
    dropped, skipped, damaged = (int(s.get(k) or 0) for k in ("dropped", "skipped", "damaged"))
    if fps is None or frames == 0:
        return None
    produced = frames + dropped + skipped + damaged
    described = (s.get("source") or {}).get("description")
    text = f"{fps:.1f} frames/s; of {produced} lost {dropped}, skipped {skipped}, damaged {damaged}"
    slow = "this computer is too slow for them: a smaller size or rate"
    cable = "a port of its own for the camera, a shorter cable, a lower rate"
    return classify(
        "frames",
        f"{text} ({described})" if described else text,
        (skipped > _MAX_LOST * produced, Verdict.WARNING, "", slow),
        (dropped + damaged > _MAX_LOST * produced, Verdict.WARNING, "", cable),
        fps=fps,
        frames=frames,
        dropped=dropped,
        skipped=skipped,
        damaged=damaged,
    )


def _latency(s: dict[str, Any]) -> Finding | None:
    told, fps = s.get("latency_ms") or {}, float(s.get("fps") or 0.0)
    if told.get("p50") is None or told.get("p99") is None or fps <= 0.0:
        return None
    slow, intervals = float(told["p99"]), float(told["p99"]) * fps / 1e3
    text = f"{float(told['p50']):.1f} ms from frame to event, 1 in 100 takes {slow:.1f} ms ({intervals:.1f} intervals)"
    text += f"; {s['scheduling']}" if s.get("scheduling") else ""
    advice = "real-time scheduling (the service has it), fewer programs, a faster computer"
    return classify("latency", text, (intervals > _MAX_INTERVALS, Verdict.WARNING, "", advice), **told)


def _discs(s: dict[str, Any]) -> Finding | None:
    used, pose = s.get("discs"), s.get("pose")
    if used is None or s.get("state") not in ("tracking", "lost", "failed-output"):
        return None
    text = f"{used} used, {s.get('discs_seen')} seen, {s.get('discs_known')} known"
    text += f"; camera pose {_span(float(pose.get('age_s') or 0.0))} old" if pose else ""
    few = s.get("state") == "tracking" and int(used) < _MIN_DISCS
    return classify("discs", text, (few, Verdict.WARNING, "", "uncover and light the ball"), used=used)


def _motion(s: dict[str, Any]) -> Finding | None:
    """Report the present direction of the ball, which a hand on it can compare."""
    told, counts = s.get("motion"), s.get("counts")
    if not told or not counts:
        return None
    x, y, third = counts
    return ok("motion", f"{told.get('words')}; counts so far x {x:+d}, y {y:+d}, third {third:+d}", **told)


def _output(s: dict[str, Any]) -> Finding | None:
    told = s.get("output")
    if not told:
        return None
    if told.get("failed"):
        spec = str(told.get("spec"))
        text, _, advice = str(told["failed"]).removeprefix(f"{spec}: ").partition("; ")
        return wrong("sending", f"{spec}: {text}", advice)
    return ok("sending", f"{told.get('spec')}: {told.get('reports')} reports sent")


def _span(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.0f} h"
