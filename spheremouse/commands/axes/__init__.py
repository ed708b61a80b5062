"""`spheremouse axes`: find the player's place from three gestures, so that the pointer goes where the hand goes."""

import os
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from spheremouse.commands.options import Assignments, Balls, CameraFile, RigFile, settings_given
from spheremouse.errors import ConfigurationError

if TYPE_CHECKING:
    from spheremouse.session.run_config import RunConfig


def axes(
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Save the result into it and keep its comments; made if missing."),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(
            metavar="KIND:ARG", help="Camera or recording, as of `run`.  [default: `source` of the configuration]"
        ),
    ] = None,
    rig: RigFile = None,
    camera: CameraFile = None,
    tracker: Annotated[
        Literal["so3", "wand"] | None, typer.Option(help="A ball in its frame, or in a hand.  [default: as configured]")
    ] = None,
    balls: Balls = None,
    assignments: Assignments = None,
    profile: Annotated[
        str | None, typer.Option(metavar="NAME", help="Save the directions into this profile, for `ctl profile NAME`.")
    ] = None,
    dry: Annotated[bool, typer.Option("--dry-run", help="Print the result, and save nothing.")] = False,
) -> None:
    """Set the pointer's directions by three gestures.

    Roll the ball to the right, roll it away from you, and spin it. Move one way each time, and let it rest. Then the
    pointer goes right and up with your hand. With a recording, the command searches the gestures in it.
    """
    from spheremouse.capture.nodes import default_camera
    from spheremouse.capture.signals import SignalHandler
    from spheremouse.commands.axes.dialogue import Dialogue
    from spheremouse.commands.run import follow, serve
    from spheremouse.files.config import PROFILE_NAME
    from spheremouse.files.edit import check_place
    from spheremouse.session.cameras import is_camera
    from spheremouse.session.process.standard_error import nonblocking_stderr
    from spheremouse.session.run_config import CommandLineOverrides, read_run_config
    from spheremouse.session.setup import open_setup, opener

    if profile is not None and (config is None or not PROFILE_NAME.fullmatch(profile)):
        raise ConfigurationError(
            f"--profile {profile}: needs --config FILE, and a name of letters, digits, '_' and '-'"
        )
    config_exists = config is not None and config.exists()
    if config is not None and not dry:
        check_place(config)
        if not os.access(config.parent, os.W_OK) or (config_exists and not os.access(config, os.W_OK)):
            raise ConfigurationError(f"{config}: this account may not write it; use sudo, or only look with --dry-run")
    options = {"tracker": tracker, "source": source, "output": "null"}
    options |= {"rig": rig, "camera_file": camera, "wand.balls": balls}
    given = settings_given(assignments, config, options)
    overrides = CommandLineOverrides(config if config_exists else None, given, no_map=True)
    plan = read_run_config(overrides)
    live = is_camera(plan.source)
    with nonblocking_stderr() if live else nullcontext(), SignalHandler() as stopping:
        setup = open_setup(plan)
        plan = setup.planned(plan)
        if plan.source.startswith("v4l2:"):  # a service waits for its camera; a person gets an error
            with opener(plan)():
                pass
        dialogue = Dialogue(plan.configuration, stopping, live)
        failure, _ = (serve if live else follow)(overrides, plan, setup, stopping, dialogue, frames=None)
    if dialogue.found is None and failure is not None:
        raise failure
    values = dialogue.conclusion()
    if dialogue.stopped:
        raise KeyboardInterrupt
    for key, value, before in values:
        print(f"{key}: {_format(value)} ({'as it was' if value == before else f'was {_format(before)}'})")
    kept = {} if config is None else _options_to_keep(plan, given, config)
    for key, value, _ in values:
        kept[tuple(key.split(".")) if profile is None else ("profiles", profile, key)] = value
    _keep(config, kept, dry)
    if config is not None and not (dry or config_exists or ("source",) in kept):
        print(f"it names no camera yet: add a line such as `source: {default_camera()}`")


def _format(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _options_to_keep(plan: "RunConfig", given: tuple[str, ...], config: Path) -> dict[tuple[str, ...], Any]:
    """Return the command line's values that the configuration lacks, so that `run --config` needs nothing else."""
    from spheremouse.files.config import assigned_values
    from spheremouse.files.yaml import read_document
    from spheremouse.session.cameras import is_camera

    def relative(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(map(relative, value))
        return os.path.relpath(value, config.parent) if isinstance(value, str) and os.path.isabs(value) else value

    kept = assigned_values(plan.configuration, given)
    kept |= {key: relative(kept[key]) for key in (("rig",), ("camera_file",), ("wand", "balls")) if key in kept}
    del kept["output",]
    kept.pop(("source",), None)
    if is_camera(plan.source):
        kept["source",] = plan.source
    lines = read_document(config).lines if config.exists() else {}
    return {key: value for key, value in kept.items() if key not in lines}


def _keep(config: Path | None, values: dict[tuple[str, ...], Any], dry: bool) -> None:
    from spheremouse.files.edit import save_settings
    from spheremouse.session.settings import Configuration

    if dry:
        print("nothing is saved")
    elif config is None:
        print("saved nowhere: name your configuration with --config FILE, or write it there yourself")
    else:
        save_settings(config, values, Configuration)
        print(f"{config}: saved")
