"""`spheremouse calibrate photos`: the photos of an evening, taken by the camera that will watch the ball."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from spheremouse.errors import CalibrationError

if TYPE_CHECKING:
    from spheremouse.calibrate.board import BoardFile
    from spheremouse.calibrate.photographing.look import Judge
    from spheremouse.calibrate.photographing.screen import Screen
    from spheremouse.calibrate.photographing.session import Outcome
    from spheremouse.capture import Source
    from spheremouse.files.pictures import Size
    from spheremouse.session.settings import Configuration

EXAMPLE = "Example: spheremouse calibrate photos cabinet --for camera --source v4l2:/dev/video0"

_MOST = (1920, 1080)  # px: larger pictures cost time in every frame of play, and their edges are no sharper
_LEAST = {"camera": 3, "device": 2}  # photos that the next command takes


def photos(
    what: Annotated[
        Literal["camera", "device"],
        typer.Option("--for", help="Photos of the board, for the camera; or of the device.", show_default=False),
    ],
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="What `calibrate init` made.  [default: cabinet]")
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(metavar="KIND:ARG", help="The camera, as `run --source`.  [default: as configured; the first]"),
    ] = None,
    board: Annotated[
        str | None, typer.Option(metavar="CxR", help="Inner corners of the board.  [default: as printed]")
    ] = None,
    square: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Side of a square, measured.  [default: as printed]")
    ] = None,
    marker: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Side of a marker: it is a ChArUco board.")
    ] = None,
    dictionary: Annotated[str | None, typer.Option(metavar="NAME", help="ChArUco markers, as printed.")] = None,
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Camera's controls, colours of targets.  [default: FOLDER/config.yaml]"),
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One parameter, as camera.focus=30.")
    ] = None,
    sound: Annotated[bool, typer.Option("--sound/--no-sound", help="A tone for every photo.")] = True,
) -> None:
    """Take the photos with the camera that will watch the ball: each by itself, when it is sharp, still and new.

    It says what is missing, ends when there are enough, and goes on where it was left. Photos go to FOLDER/board or
    FOLDER/device, where `calibrate next` looks for them.
    """
    from spheremouse.calibrate.board import NAME, chosen_board, save_board
    from spheremouse.calibrate.guide.suggested import camera_command, default_folder, device_command, photos_command
    from spheremouse.calibrate.photographing.screen import ENOUGH, Screen
    from spheremouse.calibrate.photographing.session import take_photos
    from spheremouse.capture import full_spec
    from spheremouse.capture.signals import SignalHandler
    from spheremouse.commands.config import root
    from spheremouse.files.config import in_force

    source = None if source is None else full_spec(source)
    folder = default_folder() if folder is None else folder
    if folder.exists() and not folder.is_dir():
        raise CalibrationError(f"{folder}: is a file; name the folder that `spheremouse calibrate init` made")
    known = chosen_board(folder, board, square, marker, dictionary)
    usual = folder / "config.yaml"
    configured = in_force(config or (usual if usual.exists() else None), settings or (), root())
    place = folder / ("board" if what == "camera" else "device")
    begin = _board_judge(known) if what == "camera" else _device_judge(folder, configured)
    with Screen(sound) as screen:
        with _opened(source, configured, folder, place, screen) as stream, SignalHandler() as stopping:
            outcome = take_photos(stopping.frames(iter(stream)), begin, place, stream.live, screen)
        if what == "camera" and outcome.judge is not None and outcome.judge.count:
            save_board(folder / NAME, known)
        if config is None and outcome.judge is not None and outcome.judge.count:
            _keep(usual, source, configured, settings or ())
        if outcome.judge is not None and outcome.judge.enough:
            screen.ring(ENOUGH)
    again = photos_command(folder, what, () if source is None else ("--source", source))
    follows = (camera_command if what == "camera" else device_command)(folder)
    _conclude(outcome, place, follows, again, _LEAST[what], stopping.asked)


def _keep(config: Path, source: str | None, configured: "Configuration", settings: Sequence[str]) -> None:
    """Write the camera and its controls, as told, into the evening's configuration: all that follows takes the same."""
    from spheremouse.files.config import assigned
    from spheremouse.files.edit import save_settings
    from spheremouse.session.cameras import is_camera
    from spheremouse.session.settings import Configuration

    told = assigned(configured, settings)
    if source is not None and is_camera(source):
        told["source",] = source
    if told:
        save_settings(config, told, Configuration)


def _board_judge(known: "BoardFile") -> "Callable[[Size], Judge]":
    from spheremouse.calibrate.camera.corners import pattern_of
    from spheremouse.calibrate.photographing.board import BoardJudge

    pattern = pattern_of(known)
    return lambda size: BoardJudge(pattern, size)


def _device_judge(folder: Path, configured: "Configuration") -> "Callable[[Size], Judge]":
    from spheremouse.calibrate.guide.suggested import init_command, photos_command
    from spheremouse.calibrate.outputs import note
    from spheremouse.calibrate.photographing.device import DeviceJudge
    from spheremouse.files.device import load_device, untouched
    from spheremouse.files.pictures import px
    from spheremouse.files.rig import load_camera

    known, lens = folder / "device.yaml", folder / "camera.yaml"
    if not known.exists():
        raise CalibrationError(f"{known}: no such file; `{init_command(folder)}` writes one to fill in")
    if not lens.exists():
        raise CalibrationError(
            f"{lens}: no such file; photos of the board come first: {photos_command(folder, 'camera')}"
        )
    device, camera = load_device(known), load_camera(lens)
    if untouched(known):
        note(f"{known}: still as `calibrate init` wrote it; are these your targets?")

    def begin(size: "Size") -> "Judge":
        if size != (camera.width, camera.height):
            mode = px((camera.width, camera.height))
            raise CalibrationError(
                f"{lens} is for the mode {mode}, the camera gives {px(size)}: take the same mode for all photos"
            )
        return DeviceJudge(device, camera, configured.rings, configured.discs)

    return begin


@contextmanager
def _opened(
    source: str | None, configured: "Configuration", folder: Path, place: Path, screen: "Screen"
) -> Iterator["Source"]:
    """The camera, in the mode of the photos there are."""
    from spheremouse.capture import full_spec
    from spheremouse.capture.default_camera import default_camera, in_size
    from spheremouse.session.cameras import looked_through, node_of_source

    spec = full_spec(source or configured.source or default_camera())
    kind, _, argument = spec.partition(":")
    size = _size_there(place, folder / "camera.yaml") or configured.camera.size
    if kind == "v4l2" and size is None and "width=" not in spec:
        from spheremouse.capture import v4l2

        size = v4l2.full_size(argument, _MOST)
    spec = in_size(spec, size)
    with looked_through(spec, configured.camera) as stream:
        if kind == "v4l2":
            _say_focus(node_of_source(spec), screen)
        screen.say(f"{spec}: photos go to {place}")
        yield stream


def _say_focus(node: Path | None, screen: "Screen") -> None:
    """A lens that moves by itself is told, as the doctor tells it."""
    from spheremouse.commands.doctor.controls import read

    controls = None if node is None else read(node)
    if controls is not None and controls.automatic_focus:
        screen.say(
            "note: the focus is automatic: each time it moves, the calibration no longer holds; "
            "give --set camera.focus=N here and camera.focus in the configuration"
        )


def _size_there(place: Path, lens: Path) -> "Size | None":
    """Size of the photos there are, or of the camera file."""
    from spheremouse.calibrate.photos import has_photos, read_photos
    from spheremouse.files.rig import load_camera

    if has_photos(place):
        return read_photos([place], lambda _: None)[0].size
    if place.name == "device" and lens.exists():
        camera = load_camera(lens)
        return camera.width, camera.height
    return None


def _conclude(outcome: "Outcome", place: Path, follows: str, again: str, least: int, stopped: bool) -> None:
    """What there is, what is missing, and what to type; raises what ended the camera."""
    judge = outcome.judge
    count = 0 if judge is None else judge.count
    many = f"{count} photo{'' if count == 1 else 's'}"
    if judge is not None and judge.enough:
        print(f"{place}: {many}, which is enough")
        print(f"next: {follows}")
        return
    if outcome.failure is not None:
        kept = f"{many} in {place} {'is' if count == 1 else 'are'} kept, and the same command goes on"
        raise type(outcome.failure)(f"{outcome.failure}; {kept}")
    if count == 0 and not stopped:
        why = f": most often {outcome.hindered}" if outcome.hindered else ""
        raise CalibrationError(f"no photo in {outcome.frames} frames{why}")
    wanted = [] if judge is None else judge.wanted()
    print(f"{place}: {many} so far{''.join(f'; {text}' for text in wanted[:3])}")
    print(f"go on: {again}")
    if count >= least:
        print(f"or go on with these: {follows}")
