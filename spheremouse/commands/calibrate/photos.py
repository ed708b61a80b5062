"""`spheremouse calibrate photos`: photos of board or device, taken by the camera that will watch the ball."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from spheremouse.commands.options import Cabinet, Corners, Dictionary, Marker, Square
from spheremouse.errors import CalibrationError, format_count

if TYPE_CHECKING:
    from spheremouse.calibrate.photographing.selector import Selector
    from spheremouse.calibrate.photographing.session import Outcome, Screen
    from spheremouse.capture import Source
    from spheremouse.files.pictures import Size
    from spheremouse.session.settings import Configuration

_MAX_SIZE = (1920, 1080)  # px; larger pictures cost time in every frame of play, and their edges are no sharper
_MIN_PHOTOS = {"camera": 3, "device": 2}  # for the next command


def photos(
    what: Annotated[
        Literal["camera", "device"],
        typer.Option("--for", help="Photos of the board, for the camera; or of the device.", show_default=False),
    ],
    folder: Cabinet = None,
    source: Annotated[
        str | None,
        typer.Option(metavar="KIND:ARG", help="The camera, as `run --source`.  [default: as configured; the first]"),
    ] = None,
    board: Corners = None,
    square: Square = None,
    marker: Marker = None,
    dictionary: Dictionary = None,
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Camera's controls, colours of targets.  [default: FOLDER/config.yaml]"),
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One parameter, as camera.focus=30.")
    ] = None,
    sound: Annotated[bool, typer.Option("--sound/--no-sound", help="Ring the terminal's bell for every photo.")] = True,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print all as JSON lines, with the check of each frame.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.jpg", help="With --json: replace this picture at each check.")
    ] = None,
) -> None:
    """Take photos with the camera that will watch the ball: each by itself, when the picture is sharp, still and new.

    It shows what is missing, ends when there are enough photos, and continues an earlier session. Photos go to
    FOLDER/board or FOLDER/device, where `calibrate next` finds them.
    """
    from spheremouse.calibrate.board import NAME, chosen_board, save_board
    from spheremouse.calibrate.guide.folder import camera_command, default_folder, device_command, photos_command
    from spheremouse.calibrate.photographing.board import BoardSelector
    from spheremouse.calibrate.photographing.session import JsonScreen, open_screen, take_photos
    from spheremouse.capture import full_spec
    from spheremouse.capture.signals import SignalHandler
    from spheremouse.files.config import in_force
    from spheremouse.session.settings import Configuration

    if picture is not None and (not as_json or picture.suffix != ".jpg"):
        raise CalibrationError(f"--picture {picture}: needs --json, and a name that ends in .jpg")
    source = None if source is None else full_spec(source)
    folder = default_folder() if folder is None else folder
    if folder.exists() and not folder.is_dir():
        raise CalibrationError(f"{folder}: is a file; name the folder that `spheremouse calibrate init` made")
    known = chosen_board(folder, board, square, marker, dictionary)
    own = folder / "config.yaml"
    configured = in_force(config or (own if own.exists() else None), settings or (), Configuration)
    place = folder / ("board" if what == "camera" else "device")
    begin = _device_selector(folder, configured) if what == "device" else lambda size: BoardSelector(known, size)
    with nullcontext(JsonScreen(picture)) if as_json else open_screen(sound) as screen:
        with _open(source, configured, folder, place, screen) as stream, SignalHandler() as stopping:
            outcome = take_photos(stopping.frames(iter(stream)), begin, place, screen)
        selector = outcome.selector
        if what == "camera" and selector is not None and selector.count:
            save_board(folder / NAME, known)
        if config is None and selector is not None and selector.count:
            _save_settings(own, source, configured, settings or ())
        if selector is not None and selector.enough:
            screen.ring()
    repeat_command = photos_command(folder, what, () if source is None else ("--source", source))
    follows = (camera_command if what == "camera" else device_command)(folder)
    for line in _conclusion(outcome, place, (follows, repeat_command), _MIN_PHOTOS[what], stopping.stop_requested):
        screen.conclude(line)


def _save_settings(config: Path, source: str | None, configured: "Configuration", settings: Sequence[str]) -> None:
    """Write the camera and its controls into the folder's configuration, for the commands that follow."""
    from spheremouse.files.config import assigned_values
    from spheremouse.files.edit import save_settings
    from spheremouse.session.cameras import is_camera
    from spheremouse.session.settings import Configuration

    given = assigned_values(configured, settings)
    if source is not None and is_camera(source):
        given["source",] = source
    if given:
        save_settings(config, given, Configuration)


def _device_selector(folder: Path, configured: "Configuration") -> "Callable[[Size], Selector]":
    from spheremouse.calibrate.guide.folder import init_command, photos_command
    from spheremouse.calibrate.outputs import note
    from spheremouse.calibrate.photographing.device import DeviceSelector
    from spheremouse.files.device import is_untouched, load_device
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
    if is_untouched(known):
        note(f"{known}: still as `calibrate init` wrote it; are these your targets?")

    def begin(size: "Size") -> "Selector":
        if size != (camera.width, camera.height):
            mode = px((camera.width, camera.height))
            raise CalibrationError(
                f"{lens} is for the mode {mode}, the camera gives {px(size)}: take the same mode for all photos"
            )
        return DeviceSelector(device, camera, configured.rings)

    return begin


@contextmanager
def _open(
    source: str | None, configured: "Configuration", folder: Path, place: Path, screen: "Screen"
) -> Iterator["Source"]:
    """Open the camera in the mode of the existing photos."""
    from spheremouse.capture import full_spec
    from spheremouse.capture.nodes import default_camera, in_size
    from spheremouse.commands.doctor.camera import read_controls
    from spheremouse.session.cameras import looked_through, node_of

    spec = full_spec(source or next(iter(configured.sources), None) or default_camera())
    kind, _, argument = spec.partition(":")
    size = _known_size(place, folder / "camera.yaml") or configured.camera.size
    if kind == "v4l2" and size is None and "width=" not in spec:
        from spheremouse.capture import v4l2

        size = v4l2.largest_size(argument, _MAX_SIZE)
    spec = in_size(spec, size)
    with looked_through(spec, configured.camera) as stream:
        node = node_of(spec) if kind == "v4l2" else None
        controls = None if node is None else read_controls(node)
        if controls is not None and controls.automatic_focus:
            screen.print(
                "note: the focus is automatic: each time it moves, the calibration no longer holds; "
                "give --set camera.focus=N here and camera.focus in the configuration"
            )
        screen.print(f"{spec}: photos go to {place}")
        yield stream


def _known_size(place: Path, lens: Path) -> "Size | None":
    from spheremouse.calibrate.photos import has_photos, read_photos
    from spheremouse.files.rig import load_camera

    if has_photos(place):
        return read_photos([place], lambda _: None)[0].size
    if place.name == "device" and lens.exists():
        camera = load_camera(lens)
        return camera.width, camera.height
    return None


def _conclusion(
    outcome: "Outcome", place: Path, commands: tuple[str, str], min_photos: int, stopped: bool
) -> Iterator[str]:
    """Yield number, missing views and the next of the `commands` (go on, more photos). Raise the camera's failure."""
    (next_command, repeat_command), selector = commands, outcome.selector
    count = 0 if selector is None else selector.count
    photos = format_count(count, "photo")
    if selector is not None and selector.enough:
        yield f"{place}: {photos}, which is enough"
        yield f"next: {next_command}"
        return
    if outcome.failure is not None:
        kept = f"{photos} in {place} {'is' if count == 1 else 'are'} kept, and the same command goes on"
        raise type(outcome.failure)(f"{outcome.failure}; {kept}")
    if count == 0 and not stopped:
        reason = f": most often {outcome.hindrance}" if outcome.hindrance else ""
        raise CalibrationError(f"no photo in {outcome.frames} frames{reason}")
    wanted = [] if selector is None else selector.wanted()
    yield f"{place}: {photos} so far{''.join(f'; {text}' for text in wanted[:3])}"
    yield f"go on: {repeat_command}"
    if count >= min_photos:
        yield f"or go on with these: {next_command}"
