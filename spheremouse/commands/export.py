"""`spheremouse export`: track a recording, and write pictures, marks and samples as an MCAP file."""

from pathlib import Path
from typing import Annotated

import typer

from spheremouse.commands.options import Assignments, Balls, CameraFile, ConfigFile, RigFile
from spheremouse.errors import ConfigurationError, format_count, os_errors_as


def export(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", show_default=False, help="Folder of a recording.")],
    out: Annotated[Path, typer.Argument(metavar="FILE.mcap", show_default=False, help="File to write.")],
    rig: RigFile = None,
    camera: CameraFile = None,
    config: ConfigFile = None,
    assignments: Assignments = None,
    balls: Balls = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Track a recording and write an MCAP file for Foxglove, Lichtblick and Rerun.

    It has the pictures with the tracker's marks, the camera's calibration, the transforms, the ball in 3-D, the log,
    and a sample for each ball and frame. The file appears when it is complete. The source, output, rig, camera and map
    of a configuration file do not count. The command needs the extra `mcap`.
    """
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.commands.terminal import progress_bar
    from spheremouse.commands.track import of_recording
    from spheremouse.files.safe_files import new_file
    from spheremouse.session import offline
    from spheremouse.session.mcap import McapWriter, sdk
    from spheremouse.session.run_config import read_run_config
    from spheremouse.session.run_description import describe_run
    from spheremouse.session.setup import open_setup
    from spheremouse.session.tracker_adapter import here

    sdk()
    check_outputs([out], [recording, config, rig, camera, *(balls or ())], force=force)
    options = {"rig": rig, "camera_file": camera, "wand.balls": balls}
    plan = read_run_config(of_recording(recording, config, assignments, options))
    setup = open_setup(plan)
    source = setup.source
    assert source is not None
    with os_errors_as(ConfigurationError, f"{out}: cannot be written"):
        with source, new_file(out) as file, progress_bar() as progress:
            writer = McapWriter(file, describe_run(plan))
            adapter = setup.adapter(plan, writer.log, here)
            frames = adapter.begin(iter(progress.track(source, source.count, description="exporting")))
            offline.follow(offline.results(frames, adapter), adapter, {}, writer)
            failure = adapter.failure("")
            if failure is not None:
                raise failure
            writer.close()
        size = out.stat().st_size
    print(f"{out}: {format_count(writer.frames, 'frame')}, {size / 1e6:.1f} MB")
