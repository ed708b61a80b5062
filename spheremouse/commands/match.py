"""`spheremouse match`: estimate scale, axes and lag of an old trackball from its log and a recording of the ball."""

import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.commands.options import Assignments, CameraFile, ConfigFile, RigFile, settings_given
from spheremouse.errors import ConfigurationError, DatasetError, PoseError, SourceError

if TYPE_CHECKING:
    from spheremouse.ball.rig import Rig
    from spheremouse.evaluation.run import Run
    from spheremouse.evaluation.trackball import Match, Verdict
    from spheremouse.output.counts import MotionSettings
    from spheremouse.session.run_config import RunConfig
    from spheremouse.tracker import Frame

_NO_MATCH = 1  # exit code
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
    config: ConfigFile = None,
    rig: RigFile = None,
    camera: CameraFile = None,
    assignments: Assignments = None,
) -> None:
    """Estimate scale, axes and lag of a trackball from its log and a recording of the ball on it.

    Prints them with standard deviations, and the settings that move the pointer as the trackball did. The clocks may
    differ, and reports may be missing.
    Exit codes: 0 the two agree, 1 they do not or the ball did not move enough, 2 unusable input.
    """
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.evaluation.trackball import judge, settings_of
    from spheremouse.files.safe_files import write_atomically

    check_outputs([out], [log, config, rig, camera], force=force)
    plan = _plan(recording, assignments or [], config, rig, camera)
    found, device = _track_and_match(recording, plan, log)
    verdict, before = judge(found), plan.configuration.motion
    settings = settings_of(found, device.radius_m, before) if verdict.usable else None
    _print_match(found, verdict)
    if settings is None:
        raise typer.Exit(_NO_MATCH)
    if out is not None:
        about = f"Scale and axes of the trackball in {recording} and {log}.", verdict.text
        write_atomically(out, "".join(f"# {' '.join(text.split())}\n" for text in about) + _configuration(settings))
        print(f"{out}: written; next: spheremouse run --config {out} ..., or copy its section into your own file")
    elif settings == before:
        print("the settings are right already")
    else:
        print("next: put these lines into your configuration, or let --out FILE write them:")
        print(_configuration(settings).partition("\n")[2], end="")  # without its schema


def _plan(
    recording: str, assignments: list[str], config: Path | None, rig: Path | None, camera: Path | None
) -> "RunConfig":
    """Return the run's configuration for a recording that is compared. Refuse a wand."""
    from spheremouse.session.run_config import CommandLineOverrides, read_run_config

    if not Path(recording).exists() and ":" not in recording:
        raise SourceError(f"{recording}: no such recording; name a dataset folder or a video")
    options = {"source": recording, "output": "null", "rig": rig, "camera_file": camera}
    given = settings_given(assignments, config, options)
    plan = read_run_config(CommandLineOverrides(config, given, no_map=True))
    if plan.configuration.tracker == "wand":
        raise ConfigurationError("tracker: wand is for balls in a hand; so3 is for one on a trackball")
    return plan


def _track_and_match(recording: str, plan: "RunConfig", log: Path) -> "tuple[Match, Rig]":
    """Track the recording and match it with the log; DatasetError if one of them has too little."""
    from spheremouse.evaluation.trackball import MIN_COMMON_S, RotationSteps, match
    from spheremouse.files.mouse_log import read_log

    trackball = read_log(log)
    if not trackball.counts.any():
        raise DatasetError(f"{log}: no motion in it; log the mouse that lies under the ball, while the ball moves")
    run, device = track_recording(recording, plan)
    steps = RotationSteps.from_run(run)
    seconds = float((steps.end - steps.begin).sum())
    if seconds < MIN_COMMON_S:
        raise DatasetError(
            f"{recording}: the ball was tracked for {seconds:.1f} s, less than {MIN_COMMON_S:g} s; watch it with "
            "`spheremouse run --overlay`"
        )
    found = match(steps, trackball)
    if found is None:
        raise DatasetError(
            f"{log}: has less than {MIN_COMMON_S:g} s of motion in common with {recording} at any lag; record both at "
            "once, for half a minute"
        )
    return found, device


def track_recording(recording: str, plan: "RunConfig") -> "tuple[Run, Rig]":
    """Track the recording up to its readable end. PoseError: no camera pose; DatasetError, SourceError: no frame."""
    from spheremouse.capture import open_source
    from spheremouse.commands.terminal import progress_bar
    from spheremouse.session.evaluate import run_ball

    with open_source(plan.source) as source, progress_bar() as progress:
        device = plan.device(source.rig)
        frames = progress.track(_readable(iter(source)), source.count, description="tracking")
        try:
            run = run_ball(iter(frames), device, plan.configuration)
        except PoseError as e:
            raise PoseError(f"{recording}: {e}") from None
    return run.history.run(), device


def _readable(frames: "Iterator[Frame]") -> "Iterator[Frame]":
    """Yield the frames before the first that cannot be read. Raise its error if it comes first."""
    yield from islice(frames, 1)
    try:
        yield from frames
    except (DatasetError, SourceError) as e:
        print(f"{e}; the frames before are used", file=sys.stderr)


def _configuration(settings: "MotionSettings") -> str:
    """Return scale and axes as the text of a configuration file."""
    from spheremouse.files.exchange import settings_text

    keys = [k for k in _KEYS if k != "counts_per_mm" or settings.counts_per_radian is None]
    keys += ["invert_z"] if settings.invert_z else []
    return settings_text({f"motion.{key}": getattr(settings, key) for key in keys})


def _print_match(found: "Match", verdict: "Verdict") -> None:
    from rich.table import Column, Table

    from spheremouse.commands.terminal import table_console

    table = Table("", *(Column(name, justify="right") for name in "xy"))
    for k, axis in enumerate("XYZ"):
        cells = [f"{a:.2f} ± {s:.2f}" for a, s in zip(found.matrix[:, k], found.sigma[:, k], strict=True)]
        table.add_row(f"counts/rad about {axis} of obj{'' if found.known[k] else ', rates too little'}", *cells)
    table.add_row("Pearson's r over 0.1 s", *(f"{r:.4f}" for r in found.r))
    table.add_row("RMSE over 0.1 s, counts/s", *(f"{v:.1f}" for v in found.rmse))
    table_console().print(table)
    order = "later" if found.lag >= 0.0 else "earlier"
    print(f"lag: the log is {1e3 * abs(found.lag):.2f} ± {1e3 * found.lag_sigma:.2f} ms {order} than the frames")
    rates = ", ".join(f"{v:.2f} about {axis}" for v, axis in zip(found.rate, "XYZ", strict=True))
    print(
        f"compared: {found.seconds:.1f} s, ball at {rates} rad/s; {found.outliers} of {found.intervals} intervals "
        "of 0.1 s do not fit"
    )
    print("\n  note: ".join((f"verdict: {verdict.text}", *verdict.notes)))
