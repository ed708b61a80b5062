"""`spheremouse run`: frames from a source, tracked, motion to an output; the one visible loop of the program."""

import sys
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import Annotated

import typer

from spheremouse.errors import ConfigurationError, PoseError, SpheremouseError

EXAMPLE = "Example: spheremouse run --source dataset:demo/roll --output text:-"


def run(
    source: Annotated[
        str,
        typer.Option(
            metavar="KIND:ARG",
            help="Where frames come from: video:PATH, dataset:DIR, synthetic[:KEY=VALUE,...] or opencv:INDEX.",
        ),
    ],
    output: Annotated[
        str,
        typer.Option(
            metavar="KIND:ARG", help="Where motion goes: text:-, text:FILE, uinput, serial:auto, serial:PORT or null."
        ),
    ],
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Configuration file; see `spheremouse config`.")
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The device as calibrated; datasets and the simulation bring their own."),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Interior orientation in place of the rig's: another resolution or lens."),
    ] = None,
    map_file: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="FILE",
            help="Where the map of the discs is kept from run to run. [default: beside the rig file, rig.map.yaml "
            "for rig.yaml; none for sources that bring their own rig]",
        ),
    ] = None,
    no_map: Annotated[bool, typer.Option("--no-map", help="Begin without a saved map, and save none.")] = False,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One parameter of the configuration; may be repeated."),
    ] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Hold recordings and the simulation to their stamps.")
    ] = False,
    table: Annotated[
        bool | None,
        typer.Option(
            "--table/--no-table",
            help="A live table on standard error, or a line per second where that is no terminal. "
            "[default: where standard error is a terminal that the output does not share]",
        ),
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="What the tracker sees: a video of all frames (.mkv, .mp4, .avi) "
            "or a picture of the last one (.png, .jpg).",
        ),
    ] = None,
    frames: Annotated[int | None, typer.Option(metavar="N", min=1, help="Stop after N tracked frames.")] = None,
) -> None:
    """Track the ball and send its motion.

    First the camera's pose is found from the ring targets, unless the rig knows it; then every frame is tracked.
    With a rig file, what is learnt of the ball's discs is saved beside it: the next run knows the attitude from its
    first frame.
    Pose, what changes (tracking, lost, tracking again) and a closing line go to standard error. Ctrl-C ends the run.
    """
    from spheremouse.cli_config import settings_of
    from spheremouse.live import Board, Tally
    from spheremouse.map_file import map_path
    from spheremouse.output import open_output
    from spheremouse.overlay import OverlayFile, target_marks
    from spheremouse.resect import describe
    from spheremouse.rig_file import load_camera, load_rig, with_camera
    from spheremouse.session import initialise, track
    from spheremouse.session_map import MapKeeper
    from spheremouse.source import open_source
    from spheremouse.stopping import Stopping
    from spheremouse.track import Settings, build

    settings = settings_of(config, assignments, Settings)
    if map_file is not None and no_map:
        raise ConfigurationError("--map and --no-map: give one of the two")
    if map_file is not None and settings.tracker != "so3":
        raise ConfigurationError(f"--map: tracker {settings.tracker} keeps no map; use so3, or leave --map out")
    device = None if rig is None else load_rig(rig)
    interior = None if camera is None else load_camera(camera)
    shared = output in ("text:-", "text:", "text") and sys.stdout.isatty()
    wanted = sys.stderr.isatty() and not shared if table is None else table
    tally = Tally()
    failure: SpheremouseError | None = None
    with ExitStack() as stack:
        stopping = stack.enter_context(Stopping())
        given = stack.enter_context(open_source(source, realtime=realtime))
        device = device or given.rig
        if device is None:
            raise ConfigurationError(f"{source}: says nothing of the device; give its rig file with --rig FILE")
        if interior is not None:
            device = with_camera(device, interior)
        picture = None if overlay is None else stack.enter_context(OverlayFile(overlay, given.fps))
        board = stack.enter_context(Board(source, wanted, tally))
        if map_file is None and rig is not None and given.rig is None and settings.tracker == "so3" and not no_map:
            map_file = map_path(rig)
        keeper = None if map_file is None else stack.enter_context(MapKeeper(map_file, device, board.say))
        with open_output(output) as sink:  # a reader of the output that goes away ends this block, quietly
            try:
                said: list[str] = []
                start = initialise(
                    stopping.frames(iter(given)),
                    device,
                    settings,
                    live=given.live,
                    report=lambda text: board.say(f"waiting: {text}") if given.live else said.append(text),
                )
                for passed_over in said:
                    board.say(f"views passed over: {passed_over}")
                tracker = build(device, start.pose, settings)
                found = start.resection
                board.say(f"camera pose: {'as the rig says' if found is None else describe(found, device)}")
                if device.scale_free:
                    scale = settings.motion.scale(None)
                    board.say(f"the rig's scale is free: {scale:g} counts per radian (motion.counts_per_radian)")
                if picture is not None:
                    picture.begin(tracker, target_marks(device, start.pose, found))
                known = None if keeper is None else keeper.known
                for epoch in track(stopping.frames(islice(start.frames, frames)), tracker, known):
                    sink.send(epoch.motion)
                    tally.add(epoch)
                    if keeper is not None:
                        keeper.keep(epoch.state)
                    if epoch.state.event:
                        board.say(f"{epoch.frame.stamp:9.3f} s  {epoch.state.event}")
                    board.show(epoch)
                    if picture is not None:
                        picture.add(epoch, tally.counts)
            except PoseError as e:
                failure = None if stopping.asked else e  # asked to stop: no frame came any more
            except SpheremouseError as e:
                failure = e
    if tally.frames or failure is None:
        print(tally, file=sys.stderr)
    if failure is not None:
        raise failure
