"""`spheremouse calibrate rolling`: a minute of rolling, and the device is calibrated; no photos, no tape."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from spheremouse.calibrate.outputs import check_outputs
from spheremouse.commands.calibrate.options import Force, Json
from spheremouse.errors import CalibrationError, ConfigurationError
from spheremouse.files.atomic import write_json

EXAMPLE = "Example: spheremouse calibrate rolling --source video:roll.mkv --camera camera.yaml --device device.yaml"

_TAPE = 0.002  # part by which a length that a person measured on a ball is off: tape, and balls are not rounder
_DOUBT = 5.0  # standard deviations from which a radius contradicts what the targets tell
_FIRST = 0.1  # part by which the first look's radius may be off: its discs' size was only seen
_READOUT_KNOWN = 1e-3  # s, standard deviation from which a readout is told
_GESTURE = 5.0  # s for a guided gesture
_PAUSE = 3.0  # s before it


def rolling(
    source: Annotated[
        str,
        typer.Option(metavar="KIND:ARG", help="Where frames come from, as `run --source` takes it."),
    ],
    camera: Annotated[Path | None, typer.Option(metavar="FILE", help="Interior orientation (camera.yaml).")] = None,
    device: Annotated[
        Path | None, typer.Option(metavar="FILE", help="device.yaml: its targets' sizes give the axes.")
    ] = None,
    rig: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A rig: its targets' positions give axes and scale.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", min=3.0, help="Take so much, in s.  [default: all; live: 60]")
    ] = None,
    forward: Annotated[
        str | None, typer.Option(metavar="A:B", help="From A to B s the ball is rolled forward, away from the player.")
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="A:B", help="From A to B s the ball is rolled to the right.")
    ] = None,
    radius: Annotated[str | None, typer.Option(metavar="LENGTH", help="Radius of the ball, as in 0.6m.")] = None,
    circumference: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="A tape around the ball, as in 3770mm.")
    ] = None,
    disc_radius: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Radius of a disc, as in 20mm; taken with a radius.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="The rig file to write.")] = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Calibrate from a minute of rolling the ball before a fixed camera: no photos, no tape measure.

    Roll it slowly in all directions, so that all sides come by. Targets in view give the axes (--rig, --device, or a
    dataset's own); without any, roll it forward, then to the right: live you are told when, of a recording say when.
    Without a length the scale is free: all works, and counts are per radian.
    """
    from spheremouse.calibrate.lengths import parse_length

    lengths = [None if text is None else parse_length(text) for text in (radius, circumference, disc_radius)]
    if radius is not None and circumference is not None:
        raise ConfigurationError("--radius and --circumference: give one of the two")
    if (forward is None) != (right is None):
        raise ConfigurationError("--forward and --right: give both, or none")
    ball = lengths[0] if lengths[1] is None else lengths[1] / 6.283185307179586
    given = _Given(
        source,
        camera,
        device,
        rig,
        seconds,
        None if forward is None or right is None else (_span(forward, "--forward"), _span(right, "--right")),
        ball,
        lengths[2],
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
    radius: float | None  # m
    disc_radius: float | None  # m
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
    from spheremouse.calibrate.rolling.axes_choice import AxesFrom
    from spheremouse.calibrate.rolling.calibrate import solve
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
    readout = (known.readout_s, known.readout_sigma_s) if known is not None else (0.0, _unknown_readout())
    with _Bar(count, given.seconds, stream.fps) as bar:
        told: list[float] = []  # what lengths said of the discs' size
        try:
            solution = solve(footage, interior, readout, lambda r, v: _disc_angle(given, axes, r, v, told), bar.frames)
        except CalibrationError as e:
            if given.radius is None or not told:
                raise
            disc = told[0] * given.radius
            raise CalibrationError(
                f"{e}. If it did turn: are the lengths right? {1e3 * disc:.3g} mm for a disc's radius and "
                f"{given.radius:.4g} m for the ball's, not a diameter"
            ) from None
    _conclude(given, solution, axes, known, interior)


def _unknown_readout() -> float:
    from spheremouse.ball.rig import UNKNOWN_READOUT

    return UNKNOWN_READOUT


class _Bar:
    """One progress bar for each way through the frames."""

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
        """The frames, counted."""
        task = self._progress.add_task(what, total=self._total)
        for frame in frames:
            yield frame
            self._progress.advance(task)
        self._progress.remove_task(task)


def _disc_angle(given: _Given, axes: Any, rolled: Any, views: Any, told: list[float]) -> float | None:
    """Radius of a disc over the ball's where lengths tell it, which `told` keeps."""
    radius = given.radius
    if axes.rig is not None and axes.device is None and axes.gestures is None:
        from spheremouse.calibrate.rolling.placed import placed, with_rolled

        ball = placed(rolled, with_rolled(axes.find(rolled, views)[0], rolled))[1]
        if not axes.rig.scale_free:
            _check_radius(given.radius, ball, _FIRST)
        if radius is None or (axes.rig.scale_free and given.disc_radius is None):
            radius = ball.radius
    disc = given.disc_radius or axes.disc_radius
    if disc is None or radius is None:
        return None
    told.append(disc / radius)
    return told[-1]


def _check_radius(radius: float | None, ball: Any, rough: float) -> None:
    """CalibrationError where a length that was given contradicts the ball that the targets tell, beyond `rough`."""
    if radius is None:
        return
    sigma = float(ball.covariance[3, 3]) ** 0.5
    if abs(radius - ball.radius) <= max(rough * ball.radius, _DOUBT * ((_TAPE * radius) ** 2 + sigma**2) ** 0.5):
        return
    why = "measure again, or leave the length out: the targets tell it"
    for factor, what in ((2.0, "the diameter was given for the radius"), (0.5, "half the radius was given")):
        if abs(radius / ball.radius / factor - 1.0) < _FIRST:
            why = f"it seems that {what}; leave the length out, or correct it"
    raise CalibrationError(
        f"the ball's radius is given as {radius:.4g} m, but the targets of the rig put it at {ball.radius:.4g} m: {why}"
    )


def _footage(given: _Given, live: bool, ask: bool) -> Any:
    from spheremouse.calibrate.rolling.footage import Kept, Recorded
    from spheremouse.capture import open_source
    from spheremouse.capture.stopping import Stopping

    if not live:
        return Recorded(given.source, given.seconds), None
    kept, spans = Kept(), []
    parts = [("roll the ball slowly in all directions, so that all sides come by", given.seconds or 60.0)]
    if ask:
        parts += [("now FORWARD: roll the ball straight away from you, on and on", _GESTURE)]
        parts += [("now RIGHT: roll the ball straight to the right, on and on", _GESTURE)]
    with Stopping() as stopping, open_source(given.source) as stream:
        frames = stopping.frames(iter(stream))
        for k, (text, length) in enumerate(parts):
            begin: float | None = None
            said = -1
            for frame in frames:
                begin = frame.stamp if begin is None else begin
                past = frame.stamp - begin - _PAUSE
                kept.keep(frame)
                if k and len(spans) < k and past >= 0.0:
                    spans.append((frame.stamp, frame.stamp + length))
                left = int(-past) + 1 if past < 0.0 else int(length - past)
                if left != said and (past < 0.0 or left % 5 == 0):
                    said = left
                    print(f"{text}: {'in ' if past < 0.0 else ''}{left} s", file=sys.stderr, flush=True)
                if past >= length:
                    break
            if stopping.asked:
                break
    if not kept.stored:
        raise CalibrationError("the camera gave no frame")
    if ask and len(spans) < 2:
        raise CalibrationError("stopped before the ball was rolled forward and right: the axes are open; begin again")
    # spans in s from the first frame
    first = kept.stored[0][1]
    return kept, None if not ask else tuple((a - first, b - first) for a, b in spans)


def _conclude(given: _Given, solution: Any, axes: Any, known: Any, interior: Any) -> None:
    import numpy as np

    from spheremouse.ball.compare_maps import turned
    from spheremouse.ball.disc_map import DiscMap
    from spheremouse.ball.rig import Rig, Targets
    from spheremouse.calibrate.rolling.advice import advise
    from spheremouse.calibrate.rolling.placed import (
        known_with_ball,
        placed,
        placed_targets,
        rescaled_targets,
        with_rolled,
    )
    from spheremouse.calibrate.rolling.report import figures, text
    from spheremouse.files.disc_map import map_path, save_map, saved_now
    from spheremouse.files.rig import save_rig

    rolled = solution.rolled
    found, source = axes.find(rolled, solution.views)[:2]
    found = with_rolled(found, rolled)
    targets, cross = Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3)), None
    radius, sigma, free = 1.0, 0.0, True
    if given.radius is not None:
        radius, sigma, free = given.radius, _TAPE * given.radius, False
    pose, ball = placed(rolled, found, radius, sigma)
    if source == "targets":
        targets, told = axes.rig.targets, placed(rolled, found)
        if given.radius is None:
            (pose, ball), free = told, axes.rig.scale_free
            radius, cross = ball.radius, known_with_ball(found, ball.radius)
        elif axes.rig.scale_free:
            targets, cross = rescaled_targets(targets, told[1], ball)
        else:
            _check_radius(given.radius, told[1], 0.0)
    elif source == "device" and not free:
        targets, cross = placed_targets(found, axes.device, rolled, radius, sigma)
    at_first = found.rotation @ rolled.rolling.attitude[0]
    seen = np.bincount(rolled.sightings.disc, minlength=len(rolled.rolling.discs))
    disc_map = turned(DiscMap(rolled.rolling.discs, rolled.disc_covariance, seen), at_first)
    readout, readout_sigma = rolled.rolling.readout, rolled.readout_sigma
    told = readout_sigma < _READOUT_KNOWN and readout > -2.0 * readout_sigma
    rig = Rig(
        camera=interior,
        ball=ball,
        targets=targets,
        disc_radius=solution.disc_angle * radius,
        readout_s=(readout if readout > 2.0 * readout_sigma else 0.0) if told else 0.0,
        readout_sigma_s=0.0 if told else _unknown_readout(),
        exposure_s=0.0 if known is None else known.exposure_s,
        pose=pose,
        disc_directions=disc_map.directions,
        cross_covariance=cross,
        scale_free=free,
    )
    result = figures(solution, found, source, rig)
    if given.out is not None:
        provenance = {
            "made_by": "spheremouse calibrate rolling",
            "date": saved_now(disc_map, rig).saved.isoformat(),
            "version": saved_now(disc_map, rig).version,
            "source": given.source,
            "seconds": round(solution.seconds, 1),
            "frames": result["frames"],
            "axes": source,
        }
        save_rig(given.out, rig, provenance)
        save_map(map_path(given.out), saved_now(disc_map, rig))
    printed = given.json_file is not None and write_json(given.json_file, result)
    typer.echo(text(solution, found, source, rig), err=printed)
    for line in advise(rolled):
        typer.echo(f"advice: {line}", err=printed)
    if given.out is None:
        typer.echo("nothing written: keep it with --out rig.yaml", err=printed)
    else:
        typer.echo(f"{given.out}: written, and the map of the discs beside it: {map_path(given.out)}", err=printed)
        typer.echo(f"Next: spheremouse run --rig {given.out} --source {given.source} --output text:-", err=printed)
