"""The checklist of a calibration: the first open step is the next one to do.

It reads only files: photos in the folder, files made from them, the hashes in their provenance, printed pages, and the
service's rig. So you can leave a calibration at any time, and another person can continue it.
"""

import os
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from spheremouse.calibrate.board import NAME as BOARD_FILE
from spheremouse.calibrate.board import PRINTED, options_from_provenance
from spheremouse.calibrate.guide import folder as cabinet
from spheremouse.calibrate.guide.folder import (
    CAMERA_FILE,
    CONFIG_FILE,
    DEVICE_FILE,
    RIG_FILE,
    Photos,
    Result,
)
from spheremouse.calibrate.outputs import sha256
from spheremouse.calibrate.photos import BOARD_ENOUGH, BOARD_MOST, DEVICE_ENOUGH, DEVICE_MOST
from spheremouse.errors import CalibrationError, ConfigurationError, format_count
from spheremouse.files.calibration_folder import DEFAULT
from spheremouse.files.device import UNTOUCHED, is_untouched, load_device
from spheremouse.files.rig import load_camera, load_rig
from spheremouse.files.yaml import shown

State = Literal["done", "too few", "not needed", "next", "later"]
Otherwise = tuple[tuple[str, str], ...]  # further text, each with its command

# Folders with a service's rig.yaml
SERVICES = (
    Path("/etc/spheremouse"),
    Path(os.environ.get("XDG_CONFIG_HOME") or Path("~/.config").expanduser()) / "spheremouse",
)

_USE_THESE = "Or go on with these:"
_MORE = "Or take more photos first:"
_BOARD_NUMBER, _DEVICE_NUMBER = f"{BOARD_ENOUGH} to {BOARD_MOST}", f"{DEVICE_ENOUGH} to {DEVICE_MOST}"
_TAKE_BOARD = (
    "Print the board at 100 %, glue it on something flat and stiff, and stand before the camera. From now on, change "
    "neither its zoom nor its focus.",
    "Tilt the board by 30 to 45 degrees to each side, come near and go far, and reach all corners of the picture. The "
    "program takes each photo by itself and lists the missing views. Give the measured square with --square:",
)
_TAKE_DEVICE = (
    "Wedge the ball so that it cannot turn, and touch nothing until the last photo. Keep zoom and focus.",
    "Carry the camera round the device: front, both sides, above and below. Keep three targets or more in view, and as "
    "much of the ball as possible. The program takes each photo by itself and lists the missing views:",
)


@dataclass(frozen=True, slots=True)
class Step:
    """A line of the checklist; only an open step has a task."""

    name: str
    state: State
    found: str  # in the folder
    todo: tuple[str, ...] = ()
    command: str = ""  # to copy into the terminal
    otherwise: Otherwise = ()


def checklist(folder: Path, services: Sequence[Path] | None = None) -> list[Step]:
    """Return all steps from nothing to a running mouse; at most one is next.

    The steps of a practice set end with a comparison with its truth. `services` are folders with a service's rig.yaml,
    by default SERVICES.
    """
    steps, waiting = [], False
    for step in _steps(folder, SERVICES if services is None else services):
        if step.state == "next":
            steps.append(replace(step, state="later") if waiting else step)
            waiting = True
        else:
            steps.append(Step(step.name, step.state, step.found))
    return steps


def _steps(folder: Path, services: Sequence[Path]) -> Iterator[Step]:
    """All steps with their tasks. One that a later file makes unnecessary is `overtaken`."""
    camera = cabinet.read_result(folder / CAMERA_FILE, load_camera)
    rig = cabinet.read_result(folder / RIG_FILE, load_rig)
    have_rig = rig is not None and not rig.problem
    have_camera = camera is not None and not camera.problem
    board = cabinet.read_photo_folder(folder / cabinet.BOARD)
    device = cabinet.read_photo_folder(folder / cabinet.DEVICE, folder / CAMERA_FILE if have_camera else None)
    rolling = (("Without photos of the device, roll the ball for a minute:", cabinet.rolling_command(folder)),)
    yield _folder_step(folder, have_rig)
    yield _pages_step(folder, bool(board.photos) or have_camera or have_rig)
    yield _board_step(folder, board, have_camera or have_rig, camera)
    yield _camera_step(folder, camera, board, have_rig)
    yield _device_file_step(folder, have_rig, rolling)
    yield _device_step(folder, device, have_rig, rolling)
    yield _rig_step(folder, rig, device)
    yield _axes_step(folder)
    if (folder / cabinet.TRUTH_FILE).is_file():
        compared = cabinet.compare_with_truth(folder) or f"{RIG_FILE} cannot be compared with {cabinet.TRUTH_FILE}"
        yield Step("truth", "done", compared) if (folder / RIG_FILE).exists() else Step("truth", "later", "")
        yield _own_cabinet_step(folder)
    else:
        yield _service_step(folder, services)


def _open_state(overtaken: bool) -> State:
    """Return the state of a step that is not done, and that a later file has `overtaken` or not."""
    return "not needed" if overtaken else "next"


def _folder_step(folder: Path, overtaken: bool) -> Step:
    if (folder / DEVICE_FILE).exists():
        return Step("folder", "done", str(folder))
    make = cabinet.init_command(folder)
    if not folder.is_dir():
        todo = ("Make a folder for all files of this device:",)
        return Step("folder", "next", f"{folder}: no such folder", todo, make)
    todo = ("Add the file that describes the device; existing files stay:",)
    return Step("folder", _open_state(overtaken), f"{folder}, without {DEVICE_FILE}", todo, make)


def _pages_step(folder: Path, overtaken: bool) -> Step:
    """Return the step of making the pages to print. It is done if a board file shows that they were made.

    A board file in `folder` itself is that of the photos. A folder that this account may not enter has no pages.
    """
    if pages := [place for place in (folder, folder / "print", PRINTED) if os.path.isfile(place / BOARD_FILE)]:
        found = f"the board in {folder / BOARD_FILE}" if pages[0] == folder else f"pages in {pages[0]}"
        return Step("print", "done", found)
    todo = ("Make the pages: ring targets, discs, two boards, and the instructions:",)
    after = (
        "Print them at 100 % (actual size): both rulers of a page must be 100 mm. Glue one board on something flat and "
        "stiff. Measure a whole row of its squares, and divide: that is the square size."
    )
    command = cabinet.calibrate_command("print", "--out", folder / "print")
    return Step("print", _open_state(overtaken), "no pages yet", todo, command, ((after, ""),))


def _board_step(folder: Path, board: Photos, overtaken: bool, camera: Result | None) -> Step:
    name, n = "photos of the board", len(board.photos)
    take = cabinet.photos_command(folder, "camera")
    if board.problem:
        return Step(name, _open_state(overtaken), board.found, board.problem)
    left_out = camera.hashes("left_out") if camera else frozenset()
    good = sum(p.sha256 not in left_out for p in board.photos)
    if n and overtaken and good < BOARD_ENOUGH:
        usable = "" if good == n else f", {good} of use"
        return Step(name, "too few", f"{board.found}{usable}; {_BOARD_NUMBER} make a lens reliable: {take}")
    if n >= BOARD_ENOUGH:
        return Step(name, "done", board.found)
    if n < 3:
        own = ((f"Or put {_BOARD_NUMBER} sharp photos of the whole board into {board.folder}.", ""),)
        return Step(name, _open_state(overtaken), board.found, _TAKE_BOARD, take, own)
    so_far = (f"{n} so far, of {_BOARD_NUMBER} sharp ones with the whole board in each. Go on:",)
    return Step(name, "next", board.found, so_far, take, ((_USE_THESE, cabinet.camera_command(folder)),))


def _camera_step(folder: Path, camera: Result | None, board: Photos, overtaken: bool) -> Step:
    if camera is None:
        todo = ("Is --square as measured on the print, and --board its inner corners, one less than squares each way?",)
        more = ((_MORE, cabinet.photos_command(folder, "camera")),) if board.photos else ()
        return Step(CAMERA_FILE, _open_state(overtaken), "not there yet", todo, cabinet.camera_command(folder), more)
    command = cabinet.camera_command(folder, options_from_provenance(camera.provenance), again=True)
    return _made_step(camera, camera.changes(board.photos), "camera", command)


def _made_step(made: Result, changes: str, what: str, command: str, remark: str = "") -> Step:
    """The step of a file that a calibration wrote, by the changes of its sources."""
    if made.problem:
        return Step(made.path.name, "next", made.found, (*made.problem, "Correct the file, or make it again:"), command)
    if changes:
        return Step(made.path.name, "next", changes, (f"Calibrate the {what} again:",), command)
    return Step(made.path.name, "done", made.found + remark)


def _device_file_step(folder: Path, overtaken: bool, otherwise: Otherwise) -> Step:
    path = folder / DEVICE_FILE
    if not path.exists():
        todo = ("It describes the device:",)
        return Step(DEVICE_FILE, _open_state(overtaken), "not there yet", todo, cabinet.init_command(folder))
    try:
        device = load_device(path)
    except ConfigurationError as e:
        return Step(DEVICE_FILE, "next", "has mistakes", (*str(e).splitlines(), f"Correct this in {path}."))
    if is_untouched(path):
        todo = (
            "Cut out the printed targets and discs. Glue three targets or more flat on the frame, in one plane and "
            "not in a line, and the discs all over the ball.",
            f"Open {path} in an editor. Enter codes, sizes, and distances between targets, measured by tape.",
            f"Then delete its first line ({UNTOUCHED.partition(':')[0]} ...).",
        )
        return Step(DEVICE_FILE, _open_state(overtaken), "not filled in yet", todo, otherwise=otherwise)
    n = len(device.distances)
    measured = format_count(n, "distance") if n else "no distances: the scale is free"
    return Step(DEVICE_FILE, "done", f"{len(device.ids)} targets, {measured}")


def _device_step(folder: Path, photos: Photos, overtaken: bool, otherwise: Otherwise) -> Step:
    name, n = "photos of the device", len(photos.photos)
    if photos.problem:
        return Step(name, _open_state(overtaken), photos.found, photos.problem, otherwise=otherwise)
    if n >= DEVICE_ENOUGH or (n and overtaken):
        return Step(name, "done", photos.found)
    take = cabinet.photos_command(folder, "device")
    if n < 2:
        own = f"Or put {_DEVICE_NUMBER} sharp photos into {photos.folder}."
        return Step(name, _open_state(overtaken), photos.found, _TAKE_DEVICE, take, ((own, ""), *otherwise))
    so_far = (f"{n} so far, of {_DEVICE_NUMBER}: from the front, both sides, above and below. Go on:",)
    return Step(name, "next", photos.found, so_far, take, ((_USE_THESE, cabinet.device_command(folder)),))


def _rig_step(folder: Path, rig: Result | None, photos: Photos) -> Step:
    if rig is None:
        todo = ("Calibrate the device:",)
        more = ((_MORE, cabinet.photos_command(folder, "device")),) if photos.photos else ()
        return Step(RIG_FILE, "next", "not there yet", todo, cabinet.device_command(folder), more)
    changes = [rig.changes(photos.photos)]
    for part, path in (("camera", folder / CAMERA_FILE), ("device", folder / DEVICE_FILE)):
        made_from = rig.hashes(part)
        if made_from and path.is_file() and sha256(path) not in made_from:
            changes.append(f"{path.name} has changed")
    command = (cabinet.device_command if photos.photos else cabinet.rolling_command)(folder, again=True)
    warnings = rig.provenance.get("warnings")
    n = len(warnings) if isinstance(warnings, tuple) else 0
    remark = f"; {format_count(n, 'warning')} in its report" if n else ""
    return _made_step(rig, "; ".join(filter(None, changes)), "device", command, remark)


def _axes_step(folder: Path) -> Step:
    path, problem = folder / CONFIG_FILE, ""
    try:
        motion = cabinet.read_config(folder).get("motion") or {}
        if not isinstance(motion, dict):
            problem = f"{path}: motion is no section."
        elif motion.get("player") is not None:
            return Step("axes", "done", f"player: {shown(motion['player'])}")
    except ConfigurationError as e:
        problem = str(e)
    if problem:
        return Step("axes", "next", f"{path.name} cannot be used", (*problem.splitlines(), "Correct the file."))
    filmed = cabinet.practice_film(folder)
    show = "The film shows it:" if filmed else "Stand where the player stands, and make three gestures:"
    found = f"{path.name} does not have the player's place" if path.exists() else "not asked yet"
    return Step("axes", "next", found, (f"Which way is right? {show}",), cabinet.axes_command(folder / RIG_FILE))


def _own_cabinet_step(folder: Path) -> Step:
    todo, usual = ("The practice is complete. Go on with your own cabinet:",), DEFAULT
    if folder.resolve() == usual.resolve():
        command = cabinet.init_command(Path("my-cabinet"))
    else:
        command = (cabinet.next_command if usual.is_dir() else cabinet.init_command)(usual)
    film = cabinet.practice_film(folder)
    watch = _run(folder, "--source", film, "--output", "null", "--status") if film else ""
    otherwise = (("To watch the tracker on the film of the practice:", watch),) if film else ()
    return Step("your cabinet", "next", "", todo, command, otherwise)


def _service_step(folder: Path, services: Sequence[Path]) -> Step:
    """Return the last step: done if the rig of one of the `services` has the contents of this folder's.

    Without a rig in the folder, an earlier step is next, and this one comes later.
    """
    own = _hash_or_none(folder / RIG_FILE)
    served = [place for place in services if own is not None and _hash_or_none(place / RIG_FILE) == own]
    if served:
        return Step("service", "done", f"{served[0] / RIG_FILE} is this calibration")
    config = services[0] / CONFIG_FILE
    todo = ("All is calibrated. Try it; `spheremouse ctl watch` in another terminal shows the ball's motion:",)
    try_first = "If the pointer goes where the ball goes, install the service, which starts with the computer:"
    copy_settings = (
        f"Copy the sections source, camera and motion from {folder / CONFIG_FILE} into {config}. Then start it:"
    )
    install = (
        (try_first, "sudo spheremouse service install"),
        ("Give it this calibration:", shlex.join(["sudo", "cp", str(folder / RIG_FILE), str(services[0] / RIG_FILE)])),
        (copy_settings, "sudo systemctl restart spheremouse.service"),
    )
    run = _run(folder, "--output", "auto")
    return Step("service", "next", "not installed with this calibration", todo, run, install)


def _hash_or_none(path: Path) -> str | None:
    """Return the hash of a file; None if it is missing, or if this account may not read it."""
    try:
        return sha256(path)
    except CalibrationError:
        return None


def _run(folder: Path, *more: str) -> str:
    return shlex.join(["spheremouse", "run", "--config", str(folder / CONFIG_FILE), *more])
