"""`spheremouse track`: track a recording once, and send its samples to outputs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from spheremouse.commands.options import Assignments, Balls, CameraFile, ConfigFile, one_or_all, settings_given
from spheremouse.errors import ConfigurationError

if TYPE_CHECKING:
    from spheremouse.session.run_config import CommandLineOverrides


def of_recording(
    recording: Path, config: Path | None, assignments: list[str] | None, options: dict[str, Any]
) -> "CommandLineOverrides":
    """Return the overrides that track a recording, or a film, with its own tracker, rig and camera.

    It has a map only if `options` name one. They are settings by their keys; the output is `null` unless they have one.
    """
    from spheremouse.files.dataset.wand import is_wand
    from spheremouse.session.run_config import CommandLineOverrides

    own = ("rig=null", "camera_file=null", "map=null", *(("tracker=wand",) if is_wand(recording) else ()))
    given = settings_given(assignments, config, {"source": _source(recording), "output": "null", **options})
    return CommandLineOverrides(config, (*own, *given), no_map=options.get("map") is None)


def _source(recording: Path) -> str:
    return f"{'video' if recording.is_file() else 'dataset'}:{recording}"


def track(
    recording: Annotated[
        Path,
        typer.Argument(metavar="RECORDING", show_default=False, help="Folder of a recording, or a film with --rig."),
    ],
    output: Annotated[
        list[str], typer.Option(metavar="KIND:ARG", help="Target of the samples, as of `run`; repeat it for several.")
    ],
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Estimate each state from all frames, also the later ones (so3).")
    ] = False,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Map of the ball, kept from run to run.")
    ] = None,
    rig: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="The device as calibrated, in place of the recording's; with --beside two."),
    ] = None,
    beside: Annotated[
        Path | None, typer.Option(metavar="RECORDING", help="Recording of a second camera, by the same clock.")
    ] = None,
    camera: CameraFile = None,
    config: ConfigFile = None,
    assignments: Assignments = None,
    balls: Balls = None,
) -> None:
    """Track a recording and send its samples to files or programs.

    It is `spheremouse run --source dataset:RECORDING` without a display, and with a map only by --map. The
    source, output, rig, camera and map of a configuration file do not count. The filter uses the frames up to the
    present one. --smooth uses all frames, also the later ones, so the angular velocity has about half the error.
    """
    from spheremouse.commands.run import run_plan
    from spheremouse.session.run_config import check_kinds, read_run_config

    options: dict[str, Any] = {"output": output, "map": map_file, "rig": one_or_all(rig)}
    options |= {"camera_file": camera, "wand.balls": balls}
    if beside is not None:
        options["source"] = [_source(recording), _source(beside)]
    overrides = of_recording(recording, config, assignments, options)
    plan = read_run_config(overrides)
    check_kinds(plan)
    if smooth and plan.configuration.tracker != "so3":
        raise ConfigurationError(
            f"--smooth: there is no smoother for {plan.configuration.tracker}; use so3, or leave it out"
        )
    run_plan(overrides, plan, smooth=smooth)
