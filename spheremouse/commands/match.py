"""`spheremouse match`: how well the log of an old trackball and a recording of the ball agree, and its scale."""

import re
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from spheremouse.errors import ConfigurationError, DatasetError, PoseError, SourceError

if TYPE_CHECKING:
    from spheremouse.ball.rig import Rig
    from spheremouse.evaluate.metrics import Run
    from spheremouse.evaluate.trackball.lag import Turning
    from spheremouse.evaluate.trackball.match import Match
    from spheremouse.evaluate.trackball.match_verdict import Verdict
    from spheremouse.files.mouse_log import MouseLog
    from spheremouse.output.counts import MotionSettings
    from spheremouse.session.plan import Plan
    from spheremouse.tracker import Frame

_NO_MATCH = 1  # exit code
_LEAST = 3.0  # s, of tracked ball
_KEYS = ("player", "counts_per_mm", "counts_per_radian", "scale_x", "scale_y", "scale_z", "invert_x", "invert_y")


def match(
    recording: Annotated[
        str, typer.Argument(metavar="RECORDING", show_default=False, help="A dataset folder, or a video with --rig.")
    ],
    log: Annotated[
        Path, typer.Argument(metavar="TRACKBALL_LOG", show_default=False, help="Of `spheremouse log-mouse`.")
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write scale and axes as a configuration file.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    tracker: Annotated[Literal["so3", "ekf1", "ekf2"] | None, typer.Option(help="Filter.")] = None,
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="Configuration file.")] = None,
    rig: Annotated[Path | None, typer.Option(metavar="FILE", help="The device, in place of the recording's.")] = None,
    camera: Annotated[Path | None, typer.Option(metavar="FILE", help="Interior orientation.")] = None,
    stamps: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Times of a video's frames: columns frame, t (s).")
    ] = None,
    assignments: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One parameter.")] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures; - prints.")
    ] = None,
) -> None:
    """Compare the log of a trackball with a recording of the ball on it, and find the scale.

    The recording is tracked; lag, scale and axes of the trackball are estimated. Clocks may differ, reports may be
    missing. Says how well the two agree, and the settings with which the pointer moves as the trackball moved it.
    Exit codes: 0 they agree, 1 they do not, or the ball was not moved enough; 2 unusable input.
    """
    from spheremouse.evaluate.trackball.match_verdict import judge, settings_of
    from spheremouse.files.atomic import write_atomically, write_json
    from spheremouse.files.mouse_log import read_log

    _check_outputs(out, force, json_file)
    trackball = read_log(log)
    if not trackball.counts.any():
        raise DatasetError(f"{log}: no motion in it; log the mouse that lies under the ball, while the ball moves")
    said = [] if tracker is None else [f"tracker={tracker}"]
    plan = _plan(recording, (*(assignments or ()), *said), config, rig, camera)
    run, device, frames = _tracked(recording, plan, stamps)
    ball, found = _matched(recording, run, frames, log, trackball)
    verdict = judge(found)
    radius, before = device.radius_m, plan.configuration.motion
    after = settings_of(found, radius, before) if verdict.usable else None
    quiet = json_file == Path("-")
    if not quiet:
        _print(found, verdict, radius, f"{len(run.tracked)} of {frames} frames tracked, {len(trackball)} reports")
        if after is not None:
            _print_settings(found, ball, trackball, after, before, radius)
    if json_file is not None:
        write_json(json_file, figures(found, verdict, after))
    if after is None:
        raise typer.Exit(_NO_MATCH)
    if out is not None:
        write_atomically(out, fragment(after, f"{recording} and {log}", verdict.text))
        if not quiet:
            print(f"{out}: written; next: spheremouse run --config {out} ..., or copy its section into your own file")
    elif not quiet:
        print("next: put these lines into your configuration, or let --out FILE write them:")
        print(section(after), end="")


# ---- input ----


def _check_outputs(out: Path | None, force: bool, json_file: Path | None) -> None:
    for name, path in (("--out", out), ("--json", json_file)):
        if path is not None and not path.absolute().parent.is_dir():
            raise ConfigurationError(f"{name}: {path.parent}: no such folder")
        if path is not None and path.is_dir():
            raise ConfigurationError(f"{name}: {path}: is a directory; name a file in it")
    if out is not None and out.exists() and not force:
        raise ConfigurationError(f"--out: {out}: exists already; choose another name, or replace it with --force")


def _plan(
    recording: str, assignments: tuple[str, ...], config: Path | None, rig: Path | None, camera: Path | None
) -> "Plan":
    from spheremouse.session.plan import Request, read_plan

    plan = read_plan(Request(config, assignments, _spec(recording), "null", rig, camera, no_map=True))
    if plan.configuration.tracker == "wand":
        raise ConfigurationError("tracker: wand is for balls in a hand; --tracker so3 is for one on a trackball")
    return plan


def _spec(recording: str) -> str:
    """As sources are named; a folder is a dataset, a file a video."""
    if re.match(r"(dataset|video|synthetic)(:|$)", recording) and not Path(recording).exists():
        return recording
    path = Path(recording)
    if not path.exists():
        raise SourceError(f"{recording}: no such recording; name a dataset folder or a video")
    return f"{'dataset' if path.is_dir() else 'video'}:{recording}"


def _tracked(recording: str, plan: "Plan", stamps: Path | None) -> tuple["Run", "Rig", int]:
    """The run, the device, and how many frames there were; a recording that is cut short gives what is there."""
    from spheremouse.ball.build import build
    from spheremouse.capture import open_source
    from spheremouse.commands.terminal import progress_bar
    from spheremouse.evaluate.history import History
    from spheremouse.session.offline import initialise, track

    history = History()
    with ExitStack() as stack:
        given = stack.enter_context(open_source(plan.source))
        device, settings = plan.device(given.rig), plan.configuration
        progress = stack.enter_context(progress_bar())
        task = progress.add_task("tracking", total=given.count)
        frames = iter(given) if stamps is None else _stamped(iter(given), stamps)
        try:
            start = initialise(frames, device, settings)
        except PoseError as e:
            raise PoseError(f"{recording}: {e}") from None
        try:
            for epoch in track(start.frames, build(device, start.pose, settings)):
                history.add(epoch)
                progress.update(task, completed=len(history.epochs))
        except (DatasetError, SourceError) as e:
            if not history.epochs:
                raise
            print(f"{e}; what is there is used", file=sys.stderr)
    return history.run(), device, len(history.epochs)


def _stamped(frames: Iterator["Frame"], file: Path) -> Iterator["Frame"]:
    """The frames with the times of a table, one line per frame."""
    from spheremouse.files.tables import read_columns

    number, stamp = read_columns(file, ("frame", "t")).values()
    for k, frame in enumerate(frames):
        if k >= len(number):
            raise DatasetError(f"{file}:{len(number) + 1}: {len(number)} frames, but the recording has more")
        if number[k] != k:
            raise DatasetError(f"{file}:{k + 2}: frame {number[k]:g} where {k} is due")
        yield replace(frame, stamp=float(stamp[k]))


def _matched(recording: str, run: "Run", frames: int, log: Path, trackball: "MouseLog") -> "tuple[Turning, Match]":
    """How the ball turned, and how the trackball goes with that; DatasetError where there is too little of either."""
    from spheremouse.evaluate.trackball.match import match, turning

    ball = turning(run)
    seconds = float((ball.end - ball.begin).sum())
    if seconds < _LEAST:
        raise DatasetError(
            f"{recording}: the ball was tracked for {seconds:.1f} s of {frames} frames, {_LEAST:g} s are needed; "
            "see what `spheremouse run --overlay` shows"
        )
    found = match(ball, trackball)
    if found is None:
        raise DatasetError(
            f"{log}: has less than {_LEAST:g} s of motion in common with {recording} whatever the lag; "
            "record both at once, for half a minute"
        )
    return ball, found


# ---- output ----


def section(settings: "MotionSettings") -> str:
    """Scale and axes as a section of the configuration."""
    from spheremouse.files.config import to_yaml

    keys = (*_KEYS, "invert_z") if settings.invert_z else _KEYS
    if settings.counts_per_radian is not None:
        keys = tuple(k for k in keys if k != "counts_per_mm")
    return "motion:\n" + "".join(f"  {key}: {to_yaml(getattr(settings, key))}\n" for key in keys)


def fragment(settings: "MotionSettings", source: str, verdict: str) -> str:
    """A configuration file with scale and axes of a trackball, and nothing else."""
    from spheremouse.files.config import KIND
    from spheremouse.files.yaml import SCHEMAS

    lines = [f"# {' '.join(text.split())}" for text in (f"Scale and axes of the trackball in {source}.", verdict)]
    return "\n".join([*lines, f"schema: {SCHEMAS[KIND]}", section(settings)])


def _print(found: "Match", verdict: "Verdict", radius: float | None, title: str) -> None:
    """What was found; `radius` of the ball, m."""
    if verdict.kind != "another time":
        _print_figures(found, radius, title)
    print(f"verdict: {verdict.text}")
    for note in verdict.notes:
        print(f"  note: {note}")


def _print_figures(found: "Match", radius: float | None, title: str) -> None:
    from rich.table import Table

    from spheremouse.commands.terminal import table_console

    console = table_console()
    table = Table(title_justify="left", title=title)
    for name in ("", "x", "y"):
        table.add_column(name, justify="left" if not name else "right")
    for k, axis in enumerate("XYZ"):
        unknown = "" if found.known[k] else ", moved too little"
        cells = [f"{a:.2f} ± {s:.2f}" for a, s in zip(found.matrix[:, k], found.sigma[:, k], strict=True)]
        table.add_row(f"counts/rad about {axis} of obj{unknown}", *cells)
    table.add_row("Pearson's r of the rates, frame by frame", *("–" if r is None else f"{r:.4f}" for r in found.r))
    table.add_row("RMSE, counts/s", *(f"{v:.1f}" for v in found.rmse))
    if radius is not None:
        mm = found.scale / (1000.0 * radius)  # counts per mm
        table.add_row("RMSE, mm/s of ball surface", *(f"{v / mm:.1f}" for v in found.rmse))
    console.print(table)
    late = "later" if found.lag >= 0.0 else "earlier"
    print(
        f"lag: the log is {1e3 * abs(found.lag):.2f} ± {1e3 * found.lag_sigma:.2f} ms {late} than the frames; "
        f"drift {1e6 * found.drift:+.0f} ± {1e6 * found.drift_sigma:.0f} ppm; {found.seconds:.1f} s compared, "
        f"{found.cut} of {found.intervals} intervals left out"
    )
    moved = ", ".join(f"{v:.2f} about {axis}" for v, axis in zip(found.rate, "XYZ", strict=True))
    print(f"the ball turned at (RMS, rad/s): {moved}; condition {found.condition:.0f}")


def _print_settings(
    found: "Match",
    ball: "Turning",
    trackball: "MouseLog",
    after: "MotionSettings",
    before: "MotionSettings",
    radius: float | None,
) -> None:
    from spheremouse.evaluate.trackball.match import reproduced

    r, _ = reproduced(ball, trackball, found, after.matrix(radius)[:2])
    print(f"with the settings below the pointer follows the trackball with r = {r:.4f} over 0.1 s")
    now = _assignments(after, before)
    print(f"as options: {' '.join(f'--set {a}' for a in now) if now else 'none, the settings are right already'}")


def _assignments(after: "MotionSettings", before: "MotionSettings") -> list[str]:
    from spheremouse.files.config import to_yaml

    changed = [k for k in _KEYS if getattr(after, k) != getattr(before, k)]
    return [f"motion.{k}={to_yaml(getattr(after, k))}" for k in changed]


def figures(found: "Match", verdict: "Verdict", after: "MotionSettings | None") -> dict[str, Any]:
    """Figures that --json writes."""
    return {
        "verdict": str(verdict.kind),
        "text": verdict.text,
        "notes": list(verdict.notes),
        "lag_s": found.lag,
        "lag_sigma_s": found.lag_sigma,
        "drift": found.drift,
        "drift_sigma": found.drift_sigma,
        "matrix_counts_per_rad": found.matrix.tolist(),
        "sigma_counts_per_rad": found.sigma.tolist(),
        "known": [bool(k) for k in found.known],
        "condition": found.condition,
        "r": {"x": found.r[0], "y": found.r[1]},
        "r_interval": found.r_interval,
        "rmse_counts_s": {"x": float(found.rmse[0]), "y": float(found.rmse[1])},
        "rate_rms_rad_s": found.rate.tolist(),
        "seconds": found.seconds,
        "intervals": found.intervals,
        "left_out": found.cut,
        "motion": None if after is None else {k: getattr(after, k) for k in _KEYS},
    }
