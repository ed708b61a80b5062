"""`spheremouse calibrate rolling`: calibration by a minute of rolling, without photos and tape."""

import math
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spheremouse.calibrate.outputs import check_outputs, sha256
from spheremouse.commands.options import Force, JsonFile
from spheremouse.errors import CalibrationError, ConfigurationError
from spheremouse.files.safe_files import write_json

if TYPE_CHECKING:
    from spheremouse.calibrate.rolling.calibrate import Solution
    from spheremouse.calibrate.rolling.footage import FrameBuffer
    from spheremouse.calibrate.rolling.rig import RollingCalibration

_GESTURE_SECONDS = 5.0
_PAUSE_SECONDS = 3.0  # before each gesture


def rolling(
    source: Annotated[
        str, typer.Option(metavar="KIND:ARG", help="Where frames come from, as `run --source` takes it.")
    ],
    camera: Annotated[Path | None, typer.Option(metavar="FILE", help="Interior orientation (camera.yaml).")] = None,
    device: Annotated[
        Path | None, typer.Option(metavar="FILE", help="device.yaml: its targets' sizes give the axes.")
    ] = None,
    rig: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A rig: its targets' positions give axes and scale.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", min=3.0, help="Use the first S seconds.  [default: all; live: 60]")
    ] = None,
    forward: Annotated[
        str | None, typer.Option(metavar="A:B", help="From A to B s the ball's top rolls away from the camera.")
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="A:B", help="From A to B s its top rolls to the right, seen from the camera.")
    ] = None,
    radius: Annotated[str | None, typer.Option(metavar="LENGTH", help="Radius of the ball, as in 0.6m.")] = None,
    circumference: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Circumference by a tape around the ball, as in 3770mm.")
    ] = None,
    disc_radius: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Radius of a disc, as in 20mm; needs a radius of the ball.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="The rig file to write.")] = None,
    json_file: JsonFile = None,
    force: Force = False,
) -> None:
    """Calibrate by a minute of rolling the ball before a fixed camera, without photos and tape measure.

    Roll it slowly in all directions, so that all sides come into view. Targets in view give the axes (--rig, --device,
    or a dataset's own). Without targets, roll it forward, then to the right: a live session shows when, for a recording
    give --forward and --right. Without a length the scale is free: all works, and counts are per radian.
    """
    from spheremouse.ball.rig import UNKNOWN_READOUT
    from spheremouse.calibrate.board import parse_length
    from spheremouse.calibrate.report.rolling import rolling_json
    from spheremouse.calibrate.rolling.calibrate import solve
    from spheremouse.calibrate.rolling.footage import footage_of
    from spheremouse.calibrate.rolling.rig import AxesFrom, Lengths, build_rig, disc_angle
    from spheremouse.capture import full_spec, open_source
    from spheremouse.commands.terminal import progress_bar
    from spheremouse.files.ball_map import map_path
    from spheremouse.files.device import load_device
    from spheremouse.files.rig import load_camera, load_rig

    ball, around, disc = (None if text is None else parse_length(text) for text in (radius, circumference, disc_radius))
    if ball is not None and around is not None:
        raise ConfigurationError("--radius and --circumference: give one of the two")
    lengths = Lengths(ball if around is None else around / math.tau, disc)
    gestures = _gestures(forward, right)
    source = full_spec(source)
    argument = source.partition(":")[2]
    json_file = json_file or (None if out is None else out.with_suffix(".json"))
    inputs = [camera, device, rig, Path(argument) if argument else None]
    check_outputs([out, None if out is None else map_path(out), json_file], inputs, force=force)
    interior = None if camera is None else load_camera(camera)
    known = None if rig is None else load_rig(rig)
    targets = None if device is None else load_device(device)
    with open_source(source) as stream:
        live, total = stream.live, stream.count
        known = known or stream.rig
        if known is not None and known.disc_radius is None and lengths.disc_radius is None:
            raise ConfigurationError("the rig's ball has no discs, and their paths are measured", "give --disc-radius")
        if seconds is not None and stream.fps:
            total = min(total or 10**9, round(seconds * stream.fps))
    if interior is None and known is not None:
        interior = known.camera
    if interior is None:
        raise ConfigurationError(
            "the lens must be known: give --camera camera.yaml (`spheremouse calibrate camera` makes it)"
        )
    aligning = replace(known, camera=interior) if known is not None and known.targets.ids else None
    axes = AxesFrom(aligning, targets, gestures, interior)
    if not live:
        axes.check()
    footage = footage_of(source, seconds)
    if live:
        buffer, shown = _film(source, seconds or 60.0, ask=not axes.known)
        footage, axes = buffer.frames, axes if shown is None else replace(axes, gestures=shown)
    readout = (0.0, UNKNOWN_READOUT) if known is None else (known.readout_s, known.readout_sigma_s)
    with progress_bar() as bar:
        solution = solve(
            footage,
            interior,
            readout,
            lambda rolled, views: disc_angle(lengths, axes, rolled, views),
            lambda what, frames: iter(bar.track(frames, total=total, description=what)),
        )
    made = build_rig(solution, axes, lengths.radius, 0.0 if known is None else known.exposure_s)
    figures = rolling_json(solution, made.source, made.rig)
    printed = json_file is not None and write_json(json_file, figures)
    if out is not None:
        _save(out, source, solution, made, {"camera": camera, "device": device})
    _print(source, solution, figures, out, err=printed)


def _gestures(forward: str | None, right: str | None) -> tuple[tuple[float, float], tuple[float, float]] | None:
    if forward is None and right is None:
        return None
    if forward is None or right is None:
        raise ConfigurationError("--forward and --right: give both, or none")
    return _span(forward, "--forward"), _span(right, "--right")


def _span(text: str, name: str) -> tuple[float, float]:
    """Return begin and end in s of a text such as 45:50. Raise ConfigurationError with the option's name."""
    first, colon, last = text.partition(":")
    try:
        span = float(first), float(last)
    except ValueError:
        span = (0.0, 0.0)
    if not colon or not 0.0 <= span[0] < span[1] < float("inf"):
        raise ConfigurationError(f"{name}: {text!r} is no span of time; write seconds as in 45:50")
    return span


def _film(source: str, seconds: float, ask: bool) -> tuple["FrameBuffer", Any]:
    """Film the rolling, and both gestures if `ask`; return the frames, and the spans of the gestures in s."""
    from spheremouse.calibrate.rolling.footage import FrameBuffer
    from spheremouse.capture import open_source
    from spheremouse.capture.signals import SignalHandler

    buffer, spans = FrameBuffer(), []
    parts = [("roll the ball slowly in all directions, so that all sides come by", seconds)]
    if ask:
        parts += [("now FORWARD: roll the ball's top straight away from the camera, on and on", _GESTURE_SECONDS)]
        parts += [("now RIGHT: roll its top straight to the right, seen from the camera, on and on", _GESTURE_SECONDS)]
    with SignalHandler() as stopping, open_source(source) as stream:
        frames = stopping.frames(iter(stream))
        for k, (text, length) in enumerate(parts):
            begin: float | None = None
            shown = -1
            for frame in frames:
                begin = frame.stamp if begin is None else begin
                past = frame.stamp - begin - _PAUSE_SECONDS
                buffer.append(frame)
                if k and len(spans) < k and past >= 0.0:
                    spans.append((frame.stamp, frame.stamp + length))
                left = int(-past) + 1 if past < 0.0 else int(length - past)
                if left != shown and (past < 0.0 or left % 5 == 0):
                    shown = left
                    print(f"{text}: {'in ' if past < 0.0 else ''}{left} s", file=sys.stderr, flush=True)
                if past >= length:
                    break
            if stopping.stop_requested:
                break
    if not buffer.stored:
        raise CalibrationError("the camera gave no frame")
    if ask and len(spans) < 2:
        raise CalibrationError("stopped before the ball was rolled forward and right: the axes are open; begin again")
    first = buffer.stored[0][1]
    return buffer, tuple((a - first, b - first) for a, b in spans) if ask else None


def _save(
    out: Path, source: str, solution: "Solution", made: "RollingCalibration", files: Mapping[str, Path | None]
) -> None:
    """Write rig and map; `files` are those it was made from, by their part of the provenance."""
    from spheremouse.files.ball_map import map_path, save_map, saved_now
    from spheremouse.files.rig import save_rig

    saved = saved_now(made.disc_map, made.rig)
    provenance = {
        "made_by": "spheremouse calibrate rolling",
        "date": saved.saved.isoformat(),
        "version": saved.version,
        "source": source,
        "seconds": round(solution.seconds, 1),
        "frames": len(solution.rolled.rolling.stamp),
        "axes": made.source,
        **{part: {"file": path.name, "sha256": sha256(path)} for part, path in files.items() if path is not None},
    }
    save_map(map_path(out), saved)
    save_rig(out, made.rig, provenance)  # last: it shows that all files are complete


def _print(source: str, solution: "Solution", figures: dict[str, Any], out: Path | None, err: bool) -> None:
    from spheremouse.calibrate.guide.folder import axes_command
    from spheremouse.calibrate.report.rolling import advise, rolling_text
    from spheremouse.files.ball_map import map_path
    from spheremouse.session.cameras import is_camera

    typer.echo(rolling_text(figures), err=err)
    for line in advise(solution.rolled):
        typer.echo(f"advice: {line}", err=err)
    if out is None:
        typer.echo("nothing written: keep it with --out rig.yaml", err=err)
        return
    typer.echo(f"{out}: written, and the map of the discs beside it: {map_path(out)}", err=err)
    typer.echo(f"next: {axes_command(out, source if is_camera(source) else None)}", err=err)
