"""The checklist of a calibration: the first open step is the next one to do.

It reads the folder alone: photos, the files made from them, their times, and the hashes in their provenance. So you can
leave a calibration at any time, and another person can continue it.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from spheremouse.calibrate.board import NAME as BOARD_FILE
from spheremouse.calibrate.board import PRINTED
from spheremouse.calibrate.guide import suggestions
from spheremouse.calibrate.guide.folder import (
    BOARD,
    CAMERA_FILE,
    CONFIG_FILE,
    DEVICE,
    DEVICE_FILE,
    RIG_FILE,
    TRUTH_FILE,
    Photos,
    Result,
    compare_with_truth,
    count,
    practice_film,
    read_camera,
    read_config,
    read_photo_folder,
    read_rig,
)
from spheremouse.calibrate.outputs import sha256
from spheremouse.calibrate.photos import BOARD_ENOUGH, BOARD_MOST, DEVICE_ENOUGH, DEVICE_MOST
from spheremouse.errors import CalibrationError, ConfigurationError
from spheremouse.files.device import UNTOUCHED, load_device, untouched
from spheremouse.files.yaml import shown

State = Literal["done", "too few", "not needed", "next", "later"]

SERVICES = (
    Path("/etc/spheremouse"),
    Path(os.environ.get("XDG_CONFIG_HOME") or Path("~/.config").expanduser()) / "spheremouse",
)  # folders with a service's rig.yaml


@dataclass(frozen=True, slots=True)
class Step:
    """A line of the checklist; only an open step has a task."""

    name: str
    state: State
    found: str  # in the folder
    todo: tuple[str, ...] = ()
    command: str = ""  # to copy into the terminal
    otherwise: tuple[tuple[str, str], ...] = ()  # further text, each with its command


def checklist(folder: Path, services: Sequence[Path] | None = None) -> list[Step]:
    """Return all steps from nothing to a running mouse; at most one is next.

    The steps of a practice set end with a comparison with its truth. `services` are folders with a service's rig.yaml,
    by default SERVICES.
    """
    services = SERVICES if services is None else services
    camera, rig = read_camera(folder), read_rig(folder)
    have_rig = rig is not None and not rig.problem
    have_camera = camera is not None and not camera.problem
    board = read_photo_folder(folder / BOARD)
    device = read_photo_folder(folder / DEVICE, folder / CAMERA_FILE if have_camera else None)
    rolling: tuple[tuple[str, str], ...] = ()
    if not have_rig:
        rolling = (("Without photos of the device, roll the ball for a minute:", suggestions.rolling_command(folder)),)
    ending = [_truth_step(folder), _own_cabinet_step(folder)] if (folder / TRUTH_FILE).is_file() else []
    return _in_order(
        [
            _folder_step(folder, have_rig),
            _print_step(folder, bool(board.photos) or have_camera or have_rig),
            _board_step(folder, board, have_camera or have_rig, camera.left_out if camera else frozenset()),
            _camera_step(folder, camera, board, have_rig),
            _device_file_step(folder, have_rig, rolling),
            _device_step(folder, device, have_rig, rolling),
            _rig_step(folder, rig, device),
            _axes_step(folder),
            *(ending or [_service_step(folder, services)]),
        ]
    )


# ---- the steps; `overtaken` ones are not needed, as a later file exists ----


def _folder_step(folder: Path, overtaken: bool) -> Step:
    name = "folder"
    if not folder.is_dir():
        todo = ("Make a folder for all files of this device:",)
        return Step(name, "next", f"{folder}: no such folder", todo, suggestions.init_command(folder))
    if (folder / DEVICE_FILE).exists():
        return Step(name, "done", str(folder))
    todo = ("Add the file that describes the device; existing files stay:",)
    return Step(name, _open(overtaken), f"{folder}, without {DEVICE_FILE}", todo, suggestions.init_command(folder))


def _print_step(folder: Path, overtaken: bool) -> Step:
    name = "print"
    pages = [place for place in (folder, folder / "print", PRINTED) if (place / BOARD_FILE).is_file()]
    if pages:
        found = f"the board in {folder / BOARD_FILE}" if pages[0] == folder else f"pages in {pages[0]}"
        return Step(name, "done", found)
    todo = ("Make the pages: ring targets, discs, two boards, and the instructions:",)
    after = (
        "Print them at 100 % (actual size): both rulers of a page must be 100 mm. Glue one board on something flat and "
        "stiff. Measure a whole row of its squares, and divide: that is the square size.",
        "",
    )
    return Step(name, _open(overtaken), "no pages yet", todo, suggestions.print_command(folder), (after,))


def _board_step(folder: Path, board: Photos, overtaken: bool, left_out: frozenset[str]) -> Step:
    """`left_out`: hashes of photos in which the calibration found no board, or one that does not fit."""
    name, n = "photos of the board", len(board.photos)
    take = suggestions.photos_command(folder, "camera")
    if board.problem:
        return Step(name, _open(overtaken), board.found, board.problem)
    if n and overtaken:
        good = sum(p.sha256 not in left_out for p in board.photos)
        if good < BOARD_ENOUGH:
            few = "" if good == n else f", {good} of use"
            wanted = f"; {BOARD_ENOUGH} to {BOARD_MOST} make a lens reliable: {take}"
            return Step(name, "too few", board.found + few + wanted)
    if n >= BOARD_ENOUGH:
        return Step(name, "done", board.found)
    todo = (
        "Print the board at 100 %, glue it on something flat and stiff, and stand before the camera. From now on, "
        "change neither its zoom nor its focus.",
        "Tilt the board by 30 to 45 degrees to each side, come near and go far, and reach all corners of the picture. "
        "The program takes each photo by itself and lists the missing views. Give the measured square with --square:",
    )
    own = ((f"Or put {BOARD_ENOUGH} to {BOARD_MOST} sharp photos of the whole board into {board.folder}.", ""),)
    if n < 3:
        return Step(name, _open(overtaken), board.found, todo, take, own)
    so_far = (f"{n} so far, of {BOARD_ENOUGH} to {BOARD_MOST} sharp ones with the whole board in each. Go on:",)
    use_these = (("Or go on with these:", suggestions.camera_command(folder)),)
    return Step(name, "next", board.found, so_far, take, use_these)


def _camera_step(folder: Path, camera: Result | None, board: Photos, overtaken: bool) -> Step:
    name = CAMERA_FILE
    if camera is None:
        todo = ("Is --square as measured on the print, and --board its inner corners, one less than squares each way?",)
        return Step(name, _open(overtaken), "not there yet", todo, suggestions.camera_command(folder))
    again = suggestions.camera_command(folder, camera.board, again=True)
    if camera.problem:
        return Step(name, "next", camera.found, (*camera.problem, "Correct the file, or make it again:"), again)
    if changes := camera.changes(board.photos):
        return Step(name, "next", changes, ("Calibrate the camera again:",), again)
    return Step(name, "done", camera.found)


def _device_file_step(folder: Path, overtaken: bool, otherwise: tuple[tuple[str, str], ...]) -> Step:
    name, path = DEVICE_FILE, folder / DEVICE_FILE
    if not path.exists():
        make = suggestions.init_command(folder)
        return Step(name, _open(overtaken), "not there yet", ("It describes the device:",), make)
    try:
        device = load_device(path)
    except ConfigurationError as e:
        return Step(name, "next", "has mistakes", (*str(e).splitlines(), f"Correct this in {path}."))
    if untouched(path):
        todo = (
            "Cut out the printed targets and discs. Glue three targets or more flat on the frame, in one plane and "
            "not in a line, and the discs all over the ball.",
            f"Open {path} in an editor. Enter codes, sizes, and distances between targets, measured by tape.",
            f"Then delete its first line ({UNTOUCHED.partition(':')[0]} ...).",
        )
        return Step(name, _open(overtaken), "not filled in yet", todo, otherwise=otherwise)
    n = len(device.distances)
    measured = count(n, "distance") if n else "no distances: the scale is free"
    return Step(name, "done", f"{len(device.ids)} targets, {measured}")


def _device_step(folder: Path, photos: Photos, overtaken: bool, otherwise: tuple[tuple[str, str], ...]) -> Step:
    name, n = "photos of the device", len(photos.photos)
    if photos.problem:
        return Step(name, _open(overtaken), photos.found, photos.problem, otherwise=otherwise)
    if n >= DEVICE_ENOUGH or (n and overtaken):
        return Step(name, "done", photos.found)
    todo = (
        "Wedge the ball so that it cannot turn, and touch nothing until the last photo. Keep zoom and focus.",
        "Carry the camera round the device: front, both sides, above and below. Keep three targets or more in view, "
        "and as much of the ball as possible. The program takes each photo by itself and lists the missing views:",
    )
    take = suggestions.photos_command(folder, "device")
    if n < 2:
        own = f"Or put {DEVICE_ENOUGH} to {DEVICE_MOST} sharp photos into {photos.folder}."
        return Step(name, _open(overtaken), photos.found, todo, take, ((own, ""), *otherwise))
    so_far = (f"{n} so far, of {DEVICE_ENOUGH} to {DEVICE_MOST}: from the front, both sides, above and below. Go on:",)
    use_these = (("Or go on with these:", suggestions.device_command(folder)),)
    return Step(name, "next", photos.found, so_far, take, use_these)


def _rig_step(folder: Path, rig: Result | None, photos: Photos) -> Step:
    name = RIG_FILE
    if rig is None:
        return Step(name, "next", "not there yet", ("Calibrate the device:",), suggestions.device_command(folder))
    again = (suggestions.device_command if photos.photos else suggestions.rolling_command)(folder, again=True)
    if rig.problem:
        return Step(name, "next", rig.found, (*rig.problem, "Correct the file, or make it again:"), again)
    changes = [rig.changes(photos.photos)]
    for path in (folder / CAMERA_FILE, *([folder / DEVICE_FILE] if photos.photos else [])):
        if path.is_file() and rig.precedes(path, sha256(path)):
            changes.append(f"{path.name} is newer")
    if found := "; ".join(filter(None, changes)):
        return Step(name, "next", found, ("Calibrate the device again:",), again)
    warnings = f"; {count(len(rig.warnings), 'warning')} in its report" if rig.warnings else ""
    return Step(name, "done", rig.found + warnings)


def _axes_step(folder: Path) -> Step:
    path = folder / CONFIG_FILE
    try:
        player = (read_config(folder).get("motion") or {}).get("player")
    except ConfigurationError as e:
        return Step("axes", "next", f"{path.name} cannot be used", (*str(e).splitlines(), "Correct the file."))
    except AttributeError:
        problem = (f"{path}: motion is no section.", "Correct the file.")
        return Step("axes", "next", f"{path.name} cannot be used", problem)
    if player is not None:
        return Step("axes", "done", f"player: {shown(player)}")
    show = "The film shows it:" if practice_film(folder) else "Stand where the player stands, and make three gestures:"
    found = f"{path.name} does not have the player's place" if path.exists() else "not asked yet"
    return Step("axes", "next", found, (f"Which way is right? {show}",), suggestions.axes_command(folder / RIG_FILE))


def _truth_step(folder: Path) -> Step:
    if not (folder / RIG_FILE).exists():
        return Step("truth", "later", "")
    return Step("truth", "done", compare_with_truth(folder) or f"{RIG_FILE} cannot be compared with {TRUTH_FILE}")


def _own_cabinet_step(folder: Path) -> Step:
    todo = ("The practice is complete. Go on with your own cabinet:",)
    watch: tuple[tuple[str, str], ...] = ()
    if film := practice_film(folder):
        run = suggestions.run_command(folder, "--source", film, "--output", "null", "--table")
        watch = (("To watch the tracker on the film of the practice:", run),)
    return Step("your cabinet", "next", "", todo, suggestions.own_cabinet_command(folder), watch)


def _service_step(folder: Path, services: Sequence[Path]) -> Step:
    try:
        own = sha256(folder / RIG_FILE)
        served = [place for place in services if (place / RIG_FILE).is_file() and sha256(place / RIG_FILE) == own]
    except CalibrationError:  # no rig yet, or a service's file that this account may not read
        served = []
    if served:
        return Step("service", "done", f"{served[0] / RIG_FILE} is this calibration")
    config = services[0] / CONFIG_FILE
    todo = ("All is calibrated. Try it; `spheremouse ctl watch` in another terminal shows the ball's motion:",)
    try_first = "If the pointer goes where the ball goes, install the service, which starts with the computer:"
    copy_settings = f"Copy source, camera and motion from {folder / CONFIG_FILE} into {config}. Then start it:"
    install = (
        (try_first, suggestions.INSTALL),
        ("Give it this calibration:", suggestions.copy_command(folder, services[0])),
        (copy_settings, suggestions.START),
    )
    run = suggestions.run_command(folder, "--output", "auto")
    return Step("service", "next", "not installed with this calibration", todo, run, install)


def _open(overtaken: bool) -> State:
    return "not needed" if overtaken else "next"


def _in_order(steps: Sequence[Step]) -> list[Step]:
    """Keep the first open step as the next one, and put off those behind it; only open steps keep their task."""
    result, waiting = [], False
    for step in steps:
        if step.state == "next":
            result.append(replace(step, state="later") if waiting else step)
            waiting = True
        else:
            result.append(Step(step.name, step.state, step.found))
    return result
