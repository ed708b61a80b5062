"""`spheremouse calibrate rolling`: calibration by a minute of rolling, without photos and tape."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spheremouse.calibrate.outputs import check_outputs
from spheremouse.commands.calibrate.options import Force, Json
from spheremouse.errors import CalibrationError, ConfigurationError
from spheremouse.files.safe_files import write_json

if TYPE_CHECKING:
    from spheremouse.ball.rig import Rig
    from spheremouse.calibrate.rolling.calibrate import Solution, Views
    from spheremouse.calibrate.rolling.footage import Footage
    from spheremouse.calibrate.rolling.problem import RollingAdjustment
    from spheremouse.calibrate.rolling.rig import AxesFrom, Lengths, RollingCalibration

EXAMPLE = "Example: spheremouse calibrate rolling --source video:roll.mkv --camera camera.yaml --device device.yaml"

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
        str | None, typer.Option(metavar="A:B", help="From A to B s the ball rolls forward, away from the player.")
    ] = None,
    right: Annotated[str | None, typer.Option(metavar="A:B", help="From A to B s the ball rolls to the right.")] = None,
    radius: Annotated[str | None, typer.Option(metavar="LENGTH", help="Radius of the ball, as in 0.6m.")] = None,
    circumference: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Circumference by a tape around the ball, as in 3770mm.")
    ] = None,
    disc_radius: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Radius of a disc, as in 20mm; needs a radius of the ball.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="The rig file to write.")] = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Calibrate by a minute of rolling the ball before a fixed camera, without photos and tape measure.

    Roll it slowly in all directions, so that all sides come into view. Targets in view give the axes (--rig, --device,
    or a dataset's own). Without targets, roll it forward, then to the right: a live session shows when, for a recording
    give --forward and --right. Without a length the scale is free: all works, and counts are per radian.
    """
    from spheremouse.calibrate.board import parse_length
    from spheremouse.calibrate.rolling.rig import Lengths
    from spheremouse.capture import full_spec

    lengths = [None if text is None else parse_length(text) for text in (radius, circumference, disc_radius)]
    if radius is not None and circumference is not None:
        raise ConfigurationError("--radius and --circumference: give one of the two")
    if (forward is None) != (right is None):
        raise ConfigurationError("--forward and --right: give both, or none")
    ball = lengths[0] if lengths[1] is None else lengths[1] / 6.283185307179586
    given = _Given(
        full_spec(source),
        camera,
        device,
        rig,
        seconds,
        None if forward is None or right is None else (_span(forward, "--forward"), _span(right, "--right")),
        Lengths(ball, lengths[2]),
        out,
        json_file,
        force,
    )
    _calibrate(given)


@dataclass(frozen=True, slots=True)
class _Given:
    source: str
    camera: Path | None
    device: Path | None
    rig: Path | None
    seconds: float | None
    gestures: tuple[tuple[float, float], tuple[float, float]] | None
    lengths: "Lengths"
    out: Path | None
    json_file: Path | None
    force: bool


def _span(text: str, name: str) -> tuple[float, float]:
    first, colon, last = text.partition(":")
    try:
        span = float(first), float(last)
    except ValueError:
        span = (0.0, 0.0)
    if not colon or not 0.0 <= span[0] < span[1] < float("inf"):
        raise ConfigurationError(f"{name}: {text!r} is no span of time; write seconds as in 45:50")
    return span


def _calibrate(given: _Given) -> None:
    from spheremouse.ball.settings import Settings
    from spheremouse.calibrate.rolling.rig import AxesFrom, build_rig
    from spheremouse.capture import open_source
    from spheremouse.files.device import load_device
    from spheremouse.files.disc_map import map_path
    from spheremouse.files.rig import load_camera, load_rig, with_camera
    from spheremouse.session.offline import make_ready

    maps = None if given.out is None else map_path(given.out)
    source = Path(given.source.partition(":")[2]) if given.source.partition(":")[2] else None
    check_outputs([given.out, maps, given.json_file], [given.camera, given.device, given.rig, source], given.force)
    interior = None if given.camera is None else load_camera(given.camera)
    known = None if given.rig is None else load_rig(given.rig)
    device = None if given.device is None else load_device(given.device)
    with open_source(given.source) as stream:
        live, count = stream.live, stream.count
        known = known or stream.rig
    if interior is None and known is not None:
        interior = known.camera
    if interior is None:
        raise ConfigurationError(
            "the lens must be known: give --camera camera.yaml (`spheremouse calibrate camera` makes it)"
        )
    aligning = with_camera(known, interior) if known is not None and known.targets.ids else None
    axes = AxesFrom(aligning, device, given.gestures, interior)
    if not live:
        axes.check()
    make_ready(Settings())
    footage, gestures = _footage(given, live, ask=live and not axes.known)
    if gestures is not None:
        axes = replace(axes, gestures=gestures)
    with _Bar(count, given.seconds, stream.fps) as bar:
        solution = _solved(given.lengths, footage, axes, known, bar)
    exposure = 0.0 if known is None else known.exposure_s
    _write(given, solution, build_rig(solution, axes, given.lengths.radius, exposure))


def _solved(lengths: "Lengths", footage: "Footage", axes: "AxesFrom", known: "Rig | None", bar: "_Bar") -> "Solution":
    """Find ball, camera and discs; the message of a failure names wrong lengths as a cause."""
    from spheremouse.ball.rig import UNKNOWN_READOUT
    from spheremouse.calibrate.rolling.calibrate import solve
    from spheremouse.calibrate.rolling.rig import disc_angle

    by_lengths: float | None = None  # rad, of a disc

    def angle(rolled: "RollingAdjustment", views: "Views") -> float | None:
        nonlocal by_lengths
        by_lengths = disc_angle(lengths, axes, rolled, views)
        return by_lengths

    readout = (known.readout_s, known.readout_sigma_s) if known is not None else (0.0, UNKNOWN_READOUT)
    try:
        return solve(footage, axes.camera, readout, angle, bar.frames)
    except CalibrationError as e:
        if lengths.radius is None or by_lengths is None:
            raise
        raise CalibrationError(
            f"{e}. If it did turn: are the lengths right? {1e3 * by_lengths * lengths.radius:.3g} mm for a disc's "
            f"radius and {lengths.radius:.4g} m for the ball's, not a diameter"
        ) from None


class _Bar:
    """A progress bar for each pass through the frames."""

    def __init__(self, count: int | None, seconds: float | None, fps: float | None) -> None:
        from spheremouse.commands.terminal import progress_bar

        self._progress = progress_bar()
        self._total = count
        if seconds is not None and fps:
            self._total = min(count or 10**9, round(seconds * fps))

    def __enter__(self) -> "_Bar":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def frames(self, what: str, frames: Iterator[Any]) -> Iterator[Any]:
        """Yield the frames, and count them."""
        task = self._progress.add_task(what, total=self._total)
        for frame in frames:
            yield frame
            self._progress.advance(task)
        self._progress.remove_task(task)


def _footage(given: _Given, live: bool, ask: bool) -> Any:
    from spheremouse.calibrate.rolling.footage import BufferedFootage, RecordedFootage
    from spheremouse.capture import open_source
    from spheremouse.capture.signals import SignalHandler

    if not live:
        return RecordedFootage(given.source, given.seconds), None
    buffer, spans = BufferedFootage(), []
    parts = [("roll the ball slowly in all directions, so that all sides come by", given.seconds or 60.0)]
    if ask:
        parts += [("now FORWARD: roll the ball straight away from you, on and on", _GESTURE_SECONDS)]
        parts += [("now RIGHT: roll the ball straight to the right, on and on", _GESTURE_SECONDS)]
    with SignalHandler() as stopping, open_source(given.source) as stream:
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
            if stopping.asked:
                break
    if not buffer.stored:
        raise CalibrationError("the camera gave no frame")
    if ask and len(spans) < 2:
        raise CalibrationError("stopped before the ball was rolled forward and right: the axes are open; begin again")
    # spans in s from the first frame
    first = buffer.stored[0][1]
    return buffer, None if not ask else tuple((a - first, b - first) for a, b in spans)


def _write(given: _Given, solution: "Solution", made: "RollingCalibration") -> None:
    """Write rig, map and figures, and print the report."""
    from spheremouse.calibrate.guide.suggestions import axes_command
    from spheremouse.calibrate.report.rolling import advise, rolling_json, rolling_text
    from spheremouse.files.disc_map import map_path, save_map, saved_now
    from spheremouse.files.rig import save_rig
    from spheremouse.session.cameras import is_camera

    result = rolling_json(solution, made.axes, made.source, made.rig)
    if given.out is not None:
        saved = saved_now(made.disc_map, made.rig)
        provenance = {
            "made_by": "spheremouse calibrate rolling",
            "date": saved.saved.isoformat(),
            "version": saved.version,
            "source": given.source,
            "seconds": round(solution.seconds, 1),
            "frames": result["frames"],
            "axes": made.source,
        }
        save_rig(given.out, made.rig, provenance)
        save_map(map_path(given.out), saved)
    printed = given.json_file is not None and write_json(given.json_file, result)
    typer.echo(rolling_text(solution, made.axes, made.source, made.rig), err=printed)
    for line in advise(solution.rolled):
        typer.echo(f"advice: {line}", err=printed)
    if given.out is None:
        typer.echo("nothing written: keep it with --out rig.yaml", err=printed)
    else:
        typer.echo(f"{given.out}: written, and the map of the discs beside it: {map_path(given.out)}", err=printed)
        follows = axes_command(given.out, given.source if is_camera(given.source) else None)
        typer.echo(f"next: {follows}", err=printed)
