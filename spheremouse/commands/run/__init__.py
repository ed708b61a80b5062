"""`spheremouse run`: track the frames of a source and send the motion to an output."""

import gc
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from spheremouse.commands.options import Assignments, Balls, CameraFile, ConfigFile, one_or_all, settings_given
from spheremouse.errors import ConfigurationError, PoseError, SpheremouseError

if TYPE_CHECKING:
    from spheremouse.capture.signals import SignalHandler
    from spheremouse.commands.run.view import Counting
    from spheremouse.session.run_config import CommandLineOverrides, RunConfig
    from spheremouse.session.setup import Setup


def run(
    source: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND:ARG",
            help="Source of the frames: v4l2:DEVICE or opencv:INDEX (cameras), video:PATH, dataset:DIR or "
            "synthetic[:KEY=VALUE,...]. Give two for two cameras of one ball.  "
            "[default: `source` of the configuration]",
        ),
    ] = None,
    output: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND:ARG",
            help="Target of the motion, for example uinput, serial:auto, text:-, csv:FILE, osc:HOST:PORT or null "
            "(docs/outputs.md has all). `gain=`, `axes=`, `dead=` and `curve=` change its response: uinput:gain=2. "
            "Repeat it for several; the first is the main one.  "
            "[default: `output` of the configuration]",
        ),
    ] = None,
    tracker: Annotated[
        Literal["so3", "ekf1", "ekf2", "wand"] | None,
        typer.Option(
            help="so3, ekf1, ekf2: a ball in its frame; wand: balls in a hand.  [default: `tracker` of the "
            "configuration, so3]"
        ),
    ] = None,
    config: ConfigFile = None,
    rig: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="The device as calibrated, in place of the recording's. With two sources, give one for each.",
        ),
    ] = None,
    camera: CameraFile = None,
    map_file: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="FILE",
            help="File of the map of the ball, kept from run to run. [default: beside the rig file, rig.map.yaml "
            "or rig.pattern.yaml for rig.yaml; none for sources that bring their own rig]",
        ),
    ] = None,
    no_map: Annotated[bool, typer.Option("--no-map", help="Begin without a saved map, and save none.")] = False,
    assignments: Assignments = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Play recordings and the simulation at the pace of their stamps.")
    ] = False,
    replay: Annotated[
        bool,
        typer.Option(
            "--replay",
            help="Play a recording with its own device, every frame, again and again; `spheremouse ctl replay` and "
            "`pause` control it.",
        ),
    ] = False,
    status: Annotated[
        bool | None,
        typer.Option(
            "--status/--no-status",
            help="Show a status line on standard error, once a second if that is no terminal. "
            "[default: if standard error is a terminal to which no output writes]",
        ),
    ] = None,
    overlay: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Draw the results into a video of all frames (.mkv, .mp4, .avi) or into a picture of the last one "
            "(.png, .jpg). An earlier file is replaced.",
        ),
    ] = None,
    frames: Annotated[int | None, typer.Option(metavar="N", min=1, help="Stop after N tracked frames.")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", help="Also print the correlations of the camera pose.")] = False,
    balls: Balls = None,
) -> None:
    """Track the ball and send its motion.

    First the program finds the camera's pose from the ring targets, unless the rig contains it. Then it tracks every
    frame. With a rig file it saves the map of the discs beside it, so the next run knows the attitude from its first
    frame.

    With a camera, or with --realtime, it runs as a daemon: it survives failures of camera and output, moves the
    pointer at a steady rate between frames, and takes the requests of `spheremouse ctl`. It tracks other recordings
    frame by frame as fast as possible. It logs changes on standard error. Ctrl-C ends the run.

    --tracker wand tracks a ball in a hand. It needs a camera file and no rig, moves the pointer as the ball turns, and
    writes position and attitude as text.
    """
    with _without_collection():
        from spheremouse.session.run_config import CommandLineOverrides, check_kinds, read_run_config, saved_file

    if map_file is not None and no_map:
        raise ConfigurationError("--map and --no-map: give one of the two")
    options = {"tracker": tracker, "source": one_or_all(source), "output": output, "rig": one_or_all(rig)}
    options |= {"camera_file": camera, "map": map_file, "wand.balls": balls}
    given = settings_given(assignments, config, options)
    saved = None if replay else saved_file(config)
    overrides = CommandLineOverrides(config, (*(_SETTINGS_OF_REPLAY if replay else ()), *given), no_map, saved=saved)
    plan = read_run_config(overrides)
    check_kinds(plan)
    if overlay is not None:
        _refuse_loss(overlay, plan, (config, camera, map_file, *(rig or ()), *(balls or ())))
    if balls and plan.configuration.tracker != "wand":
        raise ConfigurationError("--ball: goes with --tracker wand; add that, or leave it out")
    pace: Pace = "replay" if replay else "realtime" if realtime else "fast"
    run_plan(overrides, plan, pace, _has_terminal(plan) if status is None else status, overlay, frames, verbose)


Pace = Literal["fast", "realtime", "replay"]  # of the frames of a recording


@contextmanager
def _without_collection() -> Iterator[None]:
    """Pause garbage collection while modules are imported: nothing of them is garbage, and the search takes 40 ms."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


# Settings of the configuration file that a replay leaves to the recording.
_SETTINGS_OF_REPLAY = ("rig=null", "camera_file=null", "map=null", "wand.balls=[]", "metrics.port=null", "realtime=off")


def _has_terminal(plan: "RunConfig") -> bool:
    from spheremouse.output import file_of

    shared = any(spec.partition(":")[0] == "text" and file_of(spec) is None for spec in plan.outputs)
    return sys.stderr.isatty() and not (shared and sys.stdout.isatty())


def run_plan(
    overrides: "CommandLineOverrides",
    plan: "RunConfig",
    pace: Pace = "fast",
    status: bool = False,
    overlay: Path | None = None,
    frames: int | None = None,
    verbose: bool = False,
    smooth: bool = False,
) -> None:
    """Run from the first frame to the summary, then raise the error that ended the run."""
    with _without_collection():
        from spheremouse.capture.signals import SignalHandler
        from spheremouse.commands.run.view import RunView
        from spheremouse.session.cameras import is_camera
        from spheremouse.session.process.standard_error import nonblocking_stderr
        from spheremouse.session.setup import open_replay, open_setup

    live = is_camera(plan.source) or pace != "fast"
    failure: SpheremouseError | None = None
    words: tuple[str, ...] = ()
    with nonblocking_stderr() if live else nullcontext():
        with ExitStack() as stack:
            stopping = stack.enter_context(SignalHandler())
            setup = open_replay(plan) if pace == "replay" else open_setup(plan, pace == "realtime")
            plan = setup.planned(plan)
            fps = None if setup.source is None else setup.source.fps
            shown = RunView(stack, overlay, fps, status=status, verbose=verbose)
            try:
                work = serve if live else partial(follow, smooth=smooth)
                failure, words = work(overrides, plan, setup, stopping, shown, frames)
            except SpheremouseError as e:  # before the first frame
                failure = e
        if shown.overlay is not None and shown.overlay.written:
            print(f"overlay: {overlay}", file=sys.stderr)
        if shown.tally.frames or failure is None:
            print(shown.tally, file=sys.stderr)
        for line in words:
            print(line, file=sys.stderr)
        if failure is not None:
            raise failure


def _refuse_loss(overlay: Path, plan: "RunConfig", given: tuple[Path | None, ...]) -> None:
    """Raise CalibrationError if the overlay would replace another file that the run reads or writes."""
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.output import file_of

    sources = [Path(path) for each in plan.cameras if (path := each.source.partition(":")[2])]
    inputs = [*given, *(each.rig_path for each in plan.cameras), plan.camera_path, plan.map_path]
    inputs += [*map(file_of, plan.outputs), *sources, *(source / "frames" for source in sources)]
    check_outputs([overlay], inputs, force=True)


def serve(
    overrides: "CommandLineOverrides",
    plan: "RunConfig",
    setup: "Setup",
    stopping: "SignalHandler",
    view: "Counting",
    frames: int | None,
) -> tuple[SpheremouseError | None, tuple[str, ...]]:
    """Run as a daemon, which takes frames when they come, and waits until a failed device works again.

    `plan` has the settings, with the `overrides` of the command line. A reload reads it again. `stopping` is the
    handler of signals, and `frames` the largest number of frames. Return the error that ended the run, None if there is
    none, and the last lines to print. Raises SpheremouseError if the camera is in use.
    """
    from spheremouse.session.cameras import refuse_if_taken
    from spheremouse.session.live_run import LiveRun
    from spheremouse.session.service import Daemon
    from spheremouse.session.setup import opener

    for each in plan.cameras:
        refuse_if_taken(each.source)
    opened = [source for source in (setup.source, setup.second) if source is not None]
    parts = LiveRun(
        overrides,
        plan,
        setup,
        lambda new_plan: opener(new_plan, opened, setup.replay),  # the first call takes the open source
        view.log,
    )
    daemon = Daemon(parts, show=view.show, frames=frames)
    view.tally.unsent = lambda: parts.outputs.unsent
    failure: SpheremouseError | None = None
    try:
        daemon.run(stopping)
    except SpheremouseError as e:
        failure = e
    view.tally.left_out = parts.left_out
    if parts.latency is not None:
        median, slow = (1e3 * seconds for seconds in parts.latency)
        view.tally.words = f"from stamp to output {median:.1f} ms (99 %: {slow:.1f} ms)"
    if daemon.finished and failure is None and not stopping.stop_requested:
        failure = parts.adapter.failure(parts.worker.trouble)
    return failure, parts.adapter.final_messages(failed=failure is not None)


def follow(
    overrides: "CommandLineOverrides",
    plan: "RunConfig",
    setup: "Setup",
    stopping: "SignalHandler",
    view: "Counting",
    frames: int | None,
    smooth: bool = False,
) -> tuple[SpheremouseError | None, tuple[str, ...]]:
    """Track every frame of a recording, one after the other. Parameters and result are those of `serve`."""
    from spheremouse.output.third_axis import left_out
    from spheremouse.session import offline
    from spheremouse.session.run_description import describe_run
    from spheremouse.session.tracker_adapter import here

    if smooth and plan.second is not None:
        raise ConfigurationError("--smooth: takes the recording of one camera; leave it out, or give one")
    failure: SpheremouseError | None = None
    with ExitStack() as stack:  # also closed if the reader of an output has gone
        sources = [stack.enter_context(each) for each in (setup.source, setup.second) if each is not None]
        adapter = setup.adapter(plan, view.log, here)
        stack.callback(adapter.close)
        targets = offline.open_outputs(plan.outputs, stack, view)
        for output in targets.values():
            output.begin(lambda: describe_run(plan) | {"smoothed": smooth})
        for notice in filter(None, map(left_out, plan.outputs)):
            view.log(str(notice))
        try:
            chosen = islice(adapter.begin(*(stopping.frames(iter(source)) for source in sources)), frames)
            tracked = offline.results(stopping.frames(chosen), adapter)
            if smooth:
                tracked = offline.smoothed(tracked, adapter, plan.configuration.so3)
            offline.follow(tracked, adapter, targets, view)
            failure = None if stopping.stop_requested else adapter.failure("")
        except PoseError as e:
            failure = None if stopping.stop_requested else e  # a signal ended the frames
        except SpheremouseError as e:
            failure = e
    view.tally.left_out = {"before anything could be tracked": adapter.untracked}
    troubles = enumerate(map(adapter.trouble_of, range(len(sources))), 1)
    of_cameras = [f"camera {number}: {trouble}" for number, trouble in troubles if trouble and len(sources) > 1]
    return failure, (*of_cameras, *adapter.final_messages(failed=failure is not None))
