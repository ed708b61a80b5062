"""`spheremouse run`: frames from a source, tracked, motion to an output; the one visible loop of the program."""

import json
import sys
from contextlib import ExitStack, nullcontext
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from spheremouse.errors import ConfigurationError, PoseError, SpheremouseError

if TYPE_CHECKING:
    from spheremouse.capture import Source
    from spheremouse.capture.stopping import Stopping
    from spheremouse.session.overlay.file import OverlayFile
    from spheremouse.session.plan import Plan, Request
    from spheremouse.session.screen import Board, Tally
    from spheremouse.session.worker import Step


def run(
    source: Annotated[
        str | None,
        typer.Option(
            metavar="KIND:ARG",
            help="Where frames come from: v4l2:DEVICE or opencv:INDEX (cameras), video:PATH, dataset:DIR or "
            "synthetic[:KEY=VALUE,...].  [default: `source` of the configuration]",
        ),
    ] = None,
    output: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND:ARG",
            help="Where motion goes: auto, uinput, serial:auto, serial:PORT, desktop, text:-, text:FILE or null.  "
            "[default: `output` of the configuration]",
        ),
    ] = None,
    tracker: Annotated[
        Literal["so3", "ekf1", "ekf2", "wand"] | None,
        typer.Option(
            help="so3, ekf1, ekf2: a ball in its frame; wand: balls in a hand.  [default: `tracker` of the "
            "configuration, so3]",
        ),
    ] = None,
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
            "or a picture of the last one (.png, .jpg). An earlier one is replaced.",
        ),
    ] = None,
    frames: Annotated[int | None, typer.Option(metavar="N", min=1, help="Stop after N tracked frames.")] = None,
    balls: Annotated[
        list[Path] | None,
        typer.Option(
            "--ball",
            metavar="FILE",
            help="Wand: a ball's wand file; may be repeated.  [default: the recording's own, or Grzonka's ball]",
        ),
    ] = None,
    axes: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|-", help="Wand: the six axes as text besides the pointer; --output text: has them anyway."
        ),
    ] = None,
) -> None:
    """Track the ball and send its motion.

    First the camera's pose is found from the ring targets, unless the rig knows it; then every frame is tracked.
    With a rig file, what is learnt of the ball's discs is saved beside it: the next run knows the attitude from its
    first frame.

    With a camera, or --realtime, this is the service: nothing that becomes of camera or output ends it, the pointer
    moves at a steady rate between frames, and `spheremouse ctl` asks and tells it. Other recordings are tracked frame
    by frame, as fast as it goes. What changes goes to standard error. Ctrl-C ends the run.

    A ball in a hand is tracked with --tracker wand: it needs a camera file and no rig, moves the pointer as the ball
    turns, and writes position and attitude as text. It cannot be asked by `spheremouse ctl`.
    """
    from spheremouse.capture import open_source
    from spheremouse.capture.stopping import Stopping
    from spheremouse.session.cameras import is_camera
    from spheremouse.session.overlay.file import OverlayFile
    from spheremouse.session.plan import Request, check_kinds, read_plan, without_map
    from spheremouse.session.process.standard_error import unhurried
    from spheremouse.session.screen import Board, Tally

    if output is not None and len(output) > 1:
        raise ConfigurationError(f"--output: given {len(output)} times; motion goes to one place, choose one")
    to = output[0] if output else None
    said = [] if tracker is None else [f"tracker={tracker}"]
    said += [] if axes is None else [f"wand.axes={json.dumps(axes)}"]
    request = Request(config, (*(assignments or ()), *said), source, to, rig, camera, map_file, no_map)
    plan = read_plan(request)
    check_kinds(plan)
    if overlay is not None:
        _refuse_loss(overlay, plan, (config, rig, camera, map_file, *(balls or ())))
    with unhurried() if is_camera(plan.source) or realtime else nullcontext():
        of_wand = plan.configuration.tracker == "wand"
        shared = plan.output in ("text:-", "text:", "text") or (of_wand and plan.configuration.wand.axes == "-")
        wanted = sys.stderr.isatty() and not (shared and sys.stdout.isatty()) if table is None else table
        if of_wand:
            from spheremouse.commands.run.wand import WandOptions, run_wand

            run_wand(request, plan, WandOptions(tuple(balls or ()), realtime, wanted, overlay, frames))
            return
        for name, value in (("--ball", balls), ("--axes", axes)):
            if value:
                raise ConfigurationError(f"{name}: goes with --tracker wand; add that, or leave it out")
        tally = Tally()
        failure: SpheremouseError | None = None
        picture = None
        with ExitStack() as stack:
            stopping = stack.enter_context(Stopping())
            given = None if is_camera(plan.source) else open_source(plan.source, realtime=realtime)
            board = stack.enter_context(Board(plan.source, wanted, tally))
            if given is not None and given.rig is not None and map_file is None and plan.configuration.map is None:
                plan = without_map(plan)
            if overlay is not None:
                picture = stack.enter_context(OverlayFile(overlay, None if given is None else given.fps))
            try:
                if given is None or realtime:
                    _serve(request, plan, given, stopping, board, tally, picture, frames)
                else:
                    _follow(plan, stack.enter_context(given), stopping, board, tally, picture, frames)
            except PoseError as e:
                failure = None if stopping.asked else e  # asked to stop: no frame came any more
            except SpheremouseError as e:
                failure = e
        if picture is not None and picture.written:
            print(f"overlay: {overlay}", file=sys.stderr)
        if tally.frames or failure is None:
            print(tally, file=sys.stderr)
        if failure is not None:
            raise failure


def _refuse_loss(overlay: Path, plan: "Plan", given: tuple[Path | None, ...]) -> None:
    """ConfigurationError where the overlay would replace what the run reads, or writes besides."""
    _, _, source = plan.source.partition(":")
    kind, _, output = plan.output.partition(":")
    others = [path for path in (*given, plan.rig_path, plan.camera_path, plan.map_path) if path is not None]
    others += [Path(name) for name in (source, output if kind == "text" else "", plan.configuration.wand.axes) if name]
    here = overlay.resolve()
    if any(here == other.resolve() for other in others):
        raise ConfigurationError(f"--overlay: {overlay} is read or written by this run besides; name another file")
    if source and overlay.exists() and Path(source).resolve() in here.parents:
        raise ConfigurationError(f"--overlay: {overlay} belongs to the recording; name another file")


def _serve(
    request: "Request",
    plan: "Plan",
    given: "Source | None",
    stopping: "Stopping",
    board: "Board",
    tally: "Tally",
    picture: "OverlayFile | None",
    frames: int | None,
) -> None:
    """As a service: frames are taken when they come, and a device that fails is waited for."""
    from spheremouse.session.cameras import opener, refuse_if_taken
    from spheremouse.session.overlay.ball import target_marks
    from spheremouse.session.service import Daemon

    rig = None if given is None else given.rig
    device = plan.device(rig)
    refuse_if_taken(plan)

    def show(made: "Step") -> None:
        tally.add(made.epoch)
        board.show(made.epoch)
        if picture is not None:
            tracker = daemon.tracker
            if tally.frames == 1 and tracker is not None:
                picture.begin(tracker, target_marks(device, tracker.pose, None))
            picture.add(made.epoch, tally.counts)

    daemon = Daemon(request, plan, rig, opener(plan, given), opener, say=board.say, show=show, frames=frames)
    daemon.run(stopping)
    if daemon.never_posed and not (stopping.asked or daemon.told_to_stop):
        raise PoseError(daemon.never_posed)


def _follow(
    plan: "Plan",
    given: "Source",
    stopping: "Stopping",
    board: "Board",
    tally: "Tally",
    picture: "OverlayFile | None",
    frames: int | None,
) -> None:
    """A recording: every frame, one after the other."""
    from spheremouse.ball.build import build
    from spheremouse.ball.pose import describe
    from spheremouse.output import open_output
    from spheremouse.session.map_keeper import MapKeeper
    from spheremouse.session.offline import initialise, track
    from spheremouse.session.overlay.ball import target_marks

    device, settings = plan.device(given.rig), plan.configuration
    with ExitStack() as stack:
        keeper = None
        if plan.map_path is not None:
            keeper = stack.enter_context(MapKeeper(plan.map_path, device, board.say))
        sink = stack.enter_context(open_output(plan.output))  # its reader may go away: a quiet end
        said: list[str] = []
        start = initialise(stopping.frames(iter(given)), device, settings, report=said.append)
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
