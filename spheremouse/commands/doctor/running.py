"""The running daemon, by its status."""

from pathlib import Path

from spheremouse import __version__
from spheremouse.commands.ctl.words import span
from spheremouse.errors import ControlError
from spheremouse.finding import Finding, Verdict, classify, ok, unchecked, wrong
from spheremouse.session.control.client import Client, NoDaemonError
from spheremouse.session.control.status import CameraStatus, OutputStatus, StatusReport

_MAX_LOST = 0.01  # of the frames; the filter bridges fewer
_MAX_INTERVALS = 2.0  # from mid-exposure to the event: one to read the frame out and carry it here, one to work on it
_MIN_DISCS = 3  # discs that hold the attitude and check it
_ADVICE = {
    "starting": "wait",
    "no-camera": "see its cable and hub, and `ls -l /dev/v4l/by-id`",
    "searching-targets": "uncover and light the targets on the frame",
    "lost": "uncover the ball, or turn it; light on it",
    "failed-output": "see the section output",
    "paused": "spheremouse ctl resume",
}


def ask(socket: Path | None = None) -> tuple[StatusReport | None, Finding]:
    """Return the daemon's status; None if none answers."""
    try:
        with Client(socket) as client:
            status = client.status()
    except NoDaemonError:
        return None, ok("daemon", "none runs: the camera is free")
    except ControlError as e:
        return None, unchecked("daemon", str(e).partition("; ")[0], str(e).partition("; ")[2])
    text = f"process {status.pid}, version {status.version}, for {span(status.uptime_s)}"
    other, advice = status.version != __version__, "restart it to run the installed version"
    return status, classify("daemon", text, (other, Verdict.WARNING, f"; this program is {__version__}", advice))


def check(status: StatusReport) -> list[Finding]:
    """Return findings about a status; values that are not known yet are left out."""
    checks = (_state, _frames, _latency, _discs, _motion)
    found = [finding for each in checks if (finding := each(status)) is not None]
    found += [_camera(number, camera) for number, camera in enumerate(status.cameras, 1)]
    return found + [_output(output) for output in status.outputs]


def _camera(number: int, camera: CameraStatus) -> Finding:
    text = f"{camera.description or camera.spec}: {camera.trouble or f'{camera.frames} frames tracked'}"
    advice = "plug it in again, or remove what its trouble names; the other camera goes on"
    return classify(f"camera {number}", text, (bool(camera.trouble), Verdict.WARNING, "", advice))


def _state(s: StatusReport) -> Finding:
    verdict = {"tracking": Verdict.OK, "no-camera": Verdict.WRONG, "failed-output": Verdict.WRONG}
    advice = _ADVICE.get(s.state, "")
    return Finding("state", verdict.get(s.state, Verdict.WARNING), f"{s.state}: {s.reason}", advice, {"state": s.state})


def _frames(s: StatusReport) -> Finding | None:
    if s.frames == 0:
        return None
    produced, described = s.frames + s.dropped + s.skipped + s.damaged, s.source.description
    text = f"{s.fps:.1f} frames/s; of {produced} lost {s.dropped}, skipped {s.skipped}, damaged {s.damaged}"
    slow = "choose a smaller size or rate, since this computer is too slow for the frames"
    cable = "give the camera a port of its own or a shorter cable, or choose a lower rate"
    return classify(
        "frames",
        f"{text} ({described})" if described else text,
        (s.skipped > _MAX_LOST * produced, Verdict.WARNING, "", slow),
        (s.dropped + s.damaged > _MAX_LOST * produced, Verdict.WARNING, "", cable),
        fps=s.fps,
        frames=s.frames,
        dropped=s.dropped,
        skipped=s.skipped,
        damaged=s.damaged,
    )


def _latency(s: StatusReport) -> Finding | None:
    ms = s.latency_ms
    if ms is None or ms.p50 is None or ms.p99 is None or s.fps <= 0.0:
        return None
    intervals = ms.p99 * s.fps / 1e3
    text = f"{ms.p50:.1f} ms from frame to event, 1 in 100 takes {ms.p99:.1f} ms ({intervals:.1f} intervals)"
    advice = "use real-time scheduling, as the service does, run fewer programs, or take a faster computer"
    slow = (intervals > _MAX_INTERVALS, Verdict.WARNING, "", advice)
    return classify("latency", f"{text}; {s.scheduling}", slow, **ms.model_dump(exclude_unset=True))


def _discs(s: StatusReport) -> Finding | None:
    if s.discs is None or s.state not in ("tracking", "lost", "failed-output"):
        return None
    text = f"{s.discs} used, {s.discs_seen} seen, {s.discs_known} known"
    text += f"; camera pose {span(s.pose.age_s)} old" if s.pose else ""
    too_few = s.state == "tracking" and s.discs < _MIN_DISCS
    return classify("points", text, (too_few, Verdict.WARNING, "", "uncover and light the ball"), used=s.discs)


def _motion(s: StatusReport) -> Finding | None:
    """Report the present direction of the ball, which a hand on it can compare."""
    if s.motion is None:
        return None
    x, y, third = s.counts
    text = f"{s.motion.words}; counts so far x {x:+d}, y {y:+d}, third {third:+d}"
    return ok("motion", text, **s.motion.model_dump(exclude_unset=True))


def _output(output: OutputStatus) -> Finding:
    if output.failed:
        text, _, advice = output.failed.removeprefix(f"{output.spec}: ").partition("; ")
        return wrong("sending", f"{output.spec}: {text}", advice)
    return ok("sending", f"{output.spec}: {output.reports} reports sent")
