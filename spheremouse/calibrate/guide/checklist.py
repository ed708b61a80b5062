"""Where an evening of calibration stands: a folder in, a checklist out whose first open step is the next thing to do.

The folder is all there is: photos, the files made from them, their times and the hashes in their provenance. So a
session can be left at any time and continued by somebody else.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from spheremouse.calibrate.guide import suggested
from spheremouse.calibrate.guide.folder import (
    BOARD,
    CAMERA_FILE,
    CONFIG_FILE,
    DEVICE,
    DEVICE_FILE,
    RIG_FILE,
    Photos,
    Result,
    camera_in,
    configured,
    count,
    film_in,
    photos_in,
    rig_in,
)
from spheremouse.calibrate.outputs import sha256
from spheremouse.calibrate.photos import BOARD_ENOUGH, BOARD_MOST, DEVICE_ENOUGH, DEVICE_MOST
from spheremouse.errors import ConfigurationError
from spheremouse.files.device import UNTOUCHED, load_device, untouched
from spheremouse.files.yaml import shown

State = Literal["done", "too few", "not needed", "next", "later"]


@dataclass(frozen=True, slots=True)
class Step:
    """A line of the checklist; all but the first three are for whoever is at it."""

    name: str
    state: State
    found: str  # what is there
    todo: tuple[str, ...] = ()
    command: str = ""  # to copy into the terminal
    otherwise: tuple[tuple[str, str], ...] = ()  # other ways on: what, and its command


def checklist(folder: Path) -> list[Step]:
    """All steps from nothing to a running mouse; exactly one is next."""
    camera, rig = camera_in(folder), rig_in(folder)
    have_rig = rig is not None and not rig.problem
    have_camera = camera is not None and not camera.problem
    board = photos_in(folder / BOARD)
    shots = photos_in(folder / DEVICE, folder / CAMERA_FILE if have_camera else None)
    rolling: tuple[tuple[str, str], ...] = ()
    if not have_rig:
        rolling = (("Without photos of the device, roll the ball for a minute:", suggested.rolling_command(folder)),)
    return _in_turn(
        [
            _folder_step(folder, have_rig),
            _board_step(folder, board, have_camera or have_rig, camera.left_out if camera else frozenset()),
            _camera_step(folder, camera, board, have_rig),
            _device_file_step(folder, have_rig, rolling),
            _shots_step(folder, shots, have_rig, rolling),
            _rig_step(folder, rig, shots),
            _axes_step(folder),
            _run_step(folder),
        ]
    )


# ---- the steps; one that something made later has overtaken is not needed ----


def _folder_step(folder: Path, overtaken: bool) -> Step:
    name = "folder"
    if not folder.is_dir():
        todo = ("Make a folder for all that belongs to this device:",)
        return Step(name, "next", f"{folder}: no such folder", todo, suggested.init_command(folder))
    if (folder / DEVICE_FILE).exists():
        return Step(name, "done", str(folder))
    todo = ("Add the file that describes the device; what is there already is kept:",)
    return Step(name, _open(overtaken), f"{folder}, without {DEVICE_FILE}", todo, suggested.init_command(folder))


def _board_step(folder: Path, board: Photos, overtaken: bool, left_out: frozenset[str]) -> Step:
    """`left_out`: hashes of photos in which the calibration found no board, or one that does not fit."""
    name, n = "photos of the board", len(board.photos)
    if board.problem:
        return Step(name, _open(overtaken), board.found, board.problem)
    if n and overtaken:
        good = sum(p.sha256 not in left_out for p in board.photos)
        if good < BOARD_ENOUGH:
            few = "" if good == n else f", {good} of use"
            wanted = (
                f"; {BOARD_ENOUGH} to {BOARD_MOST} make a lens reliable: {suggested.photos_command(folder, 'camera')}"
            )
            return Step(name, "too few", board.found + few + wanted)
    if n >= BOARD_ENOUGH:
        return Step(name, "done", board.found)
    todo = (
        "Fix the board to something flat (to print one: `spheremouse calibrate print`) and stand before the camera. "
        "Change neither its zoom nor its focus from now on.",
        "Tilt the board by 30 to 45 degrees to every side, come near and go far, and reach all corners of the picture; "
        "each photo is taken by itself, and you are told what is missing:",
    )
    take = suggested.photos_command(folder, "camera")
    own = ((f"Or put {BOARD_ENOUGH} to {BOARD_MOST} sharp photos of the whole board into {board.folder}.", ""),)
    if n < 3:
        return Step(name, _open(overtaken), board.found, todo, take, own)
    so_far = (f"{n} so far, of {BOARD_ENOUGH} to {BOARD_MOST} sharp ones with the whole board in each. Go on:",)
    return Step(name, "next", board.found, so_far, take, (("Or go on with these:", suggested.camera_command(folder)),))


def _camera_step(folder: Path, camera: Result | None, board: Photos, overtaken: bool) -> Step:
    name = CAMERA_FILE
    if camera is None:
        todo = ("Is --square as measured on the print, and --board its inner corners, one less than squares each way?",)
        return Step(name, _open(overtaken), "not there yet", todo, suggested.camera_command(folder))
    again = suggested.camera_command(folder, camera.board, again=True)
    if camera.problem:
        return Step(name, "next", camera.found, (*camera.problem, "Mend the file, or make it anew:"), again)
    if changed := camera.changed(board.photos):
        return Step(name, "next", changed, ("Calibrate the camera again:",), again)
    return Step(name, "done", camera.found)


def _device_file_step(folder: Path, overtaken: bool, otherwise: tuple[tuple[str, str], ...]) -> Step:
    name, path = DEVICE_FILE, folder / DEVICE_FILE
    if not path.exists():
        return Step(
            name, _open(overtaken), "not there yet", ("It describes the device:",), suggested.init_command(folder)
        )
    try:
        device = load_device(path)
    except ConfigurationError as e:
        return Step(name, "next", "has mistakes", (*str(e).splitlines(), f"Correct this in {path}."))
    if untouched(path):
        todo = (
            "Hang up the targets and put the discs on the ball (to print them: `spheremouse calibrate print`).",
            f"Open {path} in an editor and go through it: codes, sizes, and distances between targets by tape.",
            f"At last delete its first line ({UNTOUCHED.partition(':')[0]} ...).",
        )
        return Step(name, _open(overtaken), "not filled in yet", todo, otherwise=otherwise)
    n = len(device.distances)
    measured = count(n, "distance") if n else "no distances: the scale is free"
    return Step(name, "done", f"{len(device.ids)} targets, {measured}")


def _shots_step(folder: Path, shots: Photos, overtaken: bool, otherwise: tuple[tuple[str, str], ...]) -> Step:
    name, n = "photos of the device", len(shots.photos)
    if shots.problem:
        return Step(name, _open(overtaken), shots.found, shots.problem, otherwise=otherwise)
    if n >= DEVICE_ENOUGH or (n and overtaken):
        return Step(name, "done", shots.found)
    todo = (
        "Wedge the ball so that it cannot turn, and touch nothing until the last photo. Zoom, focus: as before.",
        "Go round the device with the camera: front, both sides, above and below, three targets or more in view, and "
        "as much of the ball as possible; each photo is taken by itself, and you are told what is missing:",
    )
    take = suggested.photos_command(folder, "device")
    if n < 2:
        own = f"Or put {DEVICE_ENOUGH} to {DEVICE_MOST} sharp photos into {shots.folder}."
        return Step(name, _open(overtaken), shots.found, todo, take, ((own, ""), *otherwise))
    so_far = (f"{n} so far, of {DEVICE_ENOUGH} to {DEVICE_MOST}: from the front, both sides, above and below. Go on:",)
    return Step(name, "next", shots.found, so_far, take, (("Or go on with these:", suggested.device_command(folder)),))


def _rig_step(folder: Path, rig: Result | None, shots: Photos) -> Step:
    name = RIG_FILE
    if rig is None:
        return Step(name, "next", "not there yet", ("Put it all together:",), suggested.device_command(folder))
    again = (suggested.device_command if shots.photos else suggested.rolling_command)(folder, again=True)
    if rig.problem:
        return Step(name, "next", rig.found, (*rig.problem, "Mend the file, or make it anew:"), again)
    changed = [rig.changed(shots.photos)]
    for path in (folder / CAMERA_FILE, *([folder / DEVICE_FILE] if shots.photos else [])):
        if path.is_file() and rig.precedes(path, sha256(path)):
            changed.append(f"{path.name} is newer")
    if found := "; ".join(filter(None, changed)):
        return Step(name, "next", found, ("Calibrate the device again:",), again)
    return Step(name, "done", rig.found, tuple(f"But it warned: {text}" for text in rig.doubts))


def _axes_step(folder: Path) -> Step:
    path = folder / CONFIG_FILE
    try:
        player = (configured(folder).get("motion") or {}).get("player")
    except ConfigurationError as e:
        return Step("axes", "next", f"{path.name} cannot be used", (*str(e).splitlines(), "Mend the file."))
    except AttributeError:
        return Step("axes", "next", f"{path.name} cannot be used", (f"{path}: motion is no section.", "Mend the file."))
    if player is not None:
        return Step("axes", "done", f"player: {shown(player)}")
    show = "The film shows it:" if film_in(folder) else "Stand where the player stands, and show it, asked one by one:"
    found = f"{path.name} does not say where the player stands" if path.exists() else "not asked yet"
    return Step("axes", "next", found, (f"Which way is right? {show}",), suggested.axes_command(folder / RIG_FILE))


def _run_step(folder: Path) -> Step:
    watch = ["--output", "null", "--table"]
    if film := film_in(folder):
        todo = ("All is calibrated. Watch what the ball of the practice set does:",)
        return Step("run", "next", "", todo, suggested.run_command(folder, "--source", film, *watch))
    todo = ("All is calibrated. Play; `spheremouse ctl watch` in another terminal says what the ball does:",)
    told = (("Or only watch what the ball does:", suggested.run_command(folder, *watch)),)
    return Step("run", "next", "", todo, suggested.run_command(folder, "--output", "auto"), told)


def _open(overtaken: bool) -> State:
    return "not needed" if overtaken else "next"


def _in_turn(steps: Sequence[Step]) -> list[Step]:
    """The first open step stays next, those behind it are for later; only what is open says what to do."""
    found, waiting = [], False
    for step in steps:
        if step.state == "next":
            found.append(replace(step, state="later") if waiting else step)
            waiting = True
        else:
            found.append(Step(step.name, step.state, step.found))
    return found
