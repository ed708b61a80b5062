"""Where an evening of calibration stands: a folder in, a checklist out whose first open step is the next thing to do.

The folder is all there is: photos, the files made from them, their times and the hashes in their provenance. So a
session can be left at any time and continued by somebody else.
"""

import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from spheremouse.calibrate.board_file import options_made_of, options_of
from spheremouse.calibrate.outputs import sha256
from spheremouse.calibrate.photos import Photo, check_size, read_photos
from spheremouse.capture.usual import in_size, usual_camera
from spheremouse.errors import CalibrationError, ConfigurationError
from spheremouse.files.device import UNTOUCHED, load_device, untouched
from spheremouse.files.migrate import without_schema
from spheremouse.files.rig import load_camera, load_rig
from spheremouse.files.yaml import read_document, shown

DEFAULT = Path("cabinet")
# Photos, as in the printed recipe. Three views of a plane fix a lens (Zhang 2000); four tilts and near and far and four
# corners of the picture want more. Of the device: front, both sides, above, below, and one between.
BOARD_ENOUGH, BOARD_MOST = 10, 20  # as coverage.VIEWS
DEVICE_ENOUGH, DEVICE_MOST = 6, 12
_BOARD, _DEVICE, _CAMERA_FILE, _DEVICE_FILE, _RIG_FILE = "board", "device", "camera.yaml", "device.yaml", "rig.yaml"
_CONFIG_FILE = "config.yaml"
FILM = "film"  # in a practice set: a dataset of three gestures

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


@dataclass(frozen=True, slots=True)
class _Photos:
    """Content of a folder of photos."""

    folder: Path
    photos: tuple[Photo, ...] = ()
    problem: tuple[str, ...] = ()  # why they cannot be used

    @property
    def found(self) -> str:
        if self.problem:
            return "cannot be used as they are"
        if not self.photos:
            return "none yet"
        width, height = self.photos[0].size
        return f"{_count(len(self.photos), 'photo')} of {width}x{height} in {self.folder}"


@dataclass(frozen=True, slots=True)
class _Result:
    """A file made from others, and what it says of its making."""

    path: Path
    found: str  # in words
    problem: tuple[str, ...] = ()  # why it cannot be used
    hashes: frozenset[str] = frozenset()  # of all it was made from
    photo_hashes: frozenset[str] = frozenset()
    left_out: frozenset[str] = frozenset()  # hashes of photos
    board: tuple[str, ...] = ()  # options of the camera command
    size: tuple[int, int] | None = None  # px, of a camera
    doubts: tuple[str, ...] = ()  # what the calibration itself warned of

    def precedes(self, path: Path, sha256: str) -> bool:
        """Whether a file came later than this result, and is not what it was made from."""
        if sha256 in self.hashes:
            return False
        state = path.stat()
        return max(state.st_mtime_ns, state.st_ctime_ns) > self.path.stat().st_mtime_ns  # ctime: when it was copied


def default_folder() -> Path:
    """The folder meant where none is named: the one we are in where that has begun, else `cabinet`."""
    begun = any(Path(name).exists() for name in (_DEVICE_FILE, _CAMERA_FILE, _BOARD))
    return Path() if begun and not DEFAULT.exists() else DEFAULT


def checklist(folder: Path) -> list[Step]:
    """All steps from nothing to a running mouse; exactly one is next."""
    camera, rig = _camera(folder / _CAMERA_FILE), _rig(folder / _RIG_FILE)
    have_rig = rig is not None and not rig.problem
    have_camera = camera is not None and not camera.problem
    board = _photos(folder / _BOARD)
    shots = _photos(folder / _DEVICE, folder / _CAMERA_FILE if have_camera else None)
    rolling = (("Without photos of the device, roll the ball for a minute:", rolling_command(folder)),)
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


def photos_command(folder: Path, what: Literal["camera", "device"], more: Sequence[str] = ()) -> str:
    """Command that takes photos into the folder."""
    return _command("photos", *_folder(folder), "--for", what, *more)


def camera_command(folder: Path, board: Sequence[str] = (), *, again: bool = False) -> str:
    """Command that makes camera.yaml of the photos in the folder."""
    given = board or options_of(folder)
    return _command("camera", folder / _BOARD, *given, "--out", folder / _CAMERA_FILE, again=again)


def device_command(folder: Path, *, again: bool = False) -> str:
    """Command that makes rig.yaml of the photos in the folder."""
    given = ("--device", folder / _DEVICE_FILE, "--camera", folder / _CAMERA_FILE)
    return _command("device", folder / _DEVICE, *given, "--out", folder / _RIG_FILE, again=again)


def rolling_command(folder: Path, *, again: bool = False) -> str:
    """Command that makes rig.yaml without photos of the device."""
    given: list[str | Path] = ["--source", _source(folder), "--camera", folder / _CAMERA_FILE]
    if (folder / _DEVICE_FILE).exists() and not untouched(folder / _DEVICE_FILE):  # its targets give the axes
        given += ["--device", folder / _DEVICE_FILE]
    return _command("rolling", *given, "--out", folder / _RIG_FILE, again=again)


def axes_command(rig: Path, source: str | None = None) -> str:
    """Command that asks which way is right, and keeps it beside a rig; by default with the usual camera."""
    folder = rig.parent
    config = folder / _CONFIG_FILE
    given = ["--rig", str(rig), "--source", source or _film(folder) or _source(folder)]
    known = config.exists() and rig.name == _RIG_FILE and _film(folder) is None
    return shlex.join(["spheremouse", "axes", "--config", str(config), *([] if known else given)])


def init_command(folder: Path) -> str:
    """Command that makes the folder."""
    return _command("init", folder)


def next_command(folder: Path) -> str:
    """Command that tells what comes next."""
    return _command("next", *_folder(folder))


def _folder(folder: Path) -> list[Path]:
    """As a command needs it."""
    return [] if folder == default_folder() else [folder]


def _source(folder: Path) -> str:
    """The camera in the mode that was calibrated."""
    camera = _camera(folder / _CAMERA_FILE)
    return in_size(usual_camera(), None if camera is None else camera.size)


def _film(folder: Path) -> str | None:
    """The film of a practice set as a source."""
    film = folder / FILM
    return f"dataset:{film}" if (film / "scene.json").is_file() else None


def _command(*words: str | Path, again: bool = False) -> str:
    return shlex.join(["spheremouse", "calibrate", *map(str, words), *(["--force"] if again else [])])


# ---- the steps; one that something made later has overtaken is not needed ----


def _folder_step(folder: Path, overtaken: bool) -> Step:
    name = "folder"
    if not folder.is_dir():
        todo = ("Make a folder for all that belongs to this device:",)
        return Step(name, "next", f"{folder}: no such folder", todo, init_command(folder))
    if (folder / _DEVICE_FILE).exists():
        return Step(name, "done", str(folder))
    todo = ("Add the file that describes the device; what is there already is kept:",)
    return Step(name, _open(overtaken), f"{folder}, without {_DEVICE_FILE}", todo, init_command(folder))


def _board_step(folder: Path, board: _Photos, overtaken: bool, left_out: frozenset[str]) -> Step:
    """`left_out`: hashes of photos in which the calibration found no board, or one that does not fit."""
    name, n = "photos of the board", len(board.photos)
    if board.problem:
        return Step(name, _open(overtaken), board.found, board.problem)
    if n and overtaken:
        good = sum(p.sha256 not in left_out for p in board.photos)
        if good < BOARD_ENOUGH:
            few = "" if good == n else f", {good} of use"
            wanted = f"; {BOARD_ENOUGH} to {BOARD_MOST} make a lens reliable: {photos_command(folder, 'camera')}"
            return Step(name, "too few", board.found + few + wanted)
    if n >= BOARD_ENOUGH:
        return Step(name, "done", board.found)
    todo = (
        "Fix the board to something flat (to print one: `spheremouse calibrate print`) and stand before the camera. "
        "Change neither its zoom nor its focus from now on.",
        "Tilt the board by 30 to 45 degrees to every side, come near and go far, and reach all corners of the picture; "
        "each photo is taken by itself, and you are told what is missing:",
    )
    take = photos_command(folder, "camera")
    own = ((f"Or put {BOARD_ENOUGH} to {BOARD_MOST} sharp photos of the whole board into {board.folder}.", ""),)
    if n < 3:
        return Step(name, _open(overtaken), board.found, todo, take, own)
    so_far = (f"{n} so far, of {BOARD_ENOUGH} to {BOARD_MOST} sharp ones with the whole board in each. Go on:",)
    return Step(name, "next", board.found, so_far, take, (("Or go on with these:", camera_command(folder)),))


def _camera_step(folder: Path, camera: _Result | None, board: _Photos, overtaken: bool) -> Step:
    name = _CAMERA_FILE
    if camera is None:
        todo = ("Is --square as measured on the print, and --board its inner corners, one less than squares each way?",)
        return Step(name, _open(overtaken), "not there yet", todo, camera_command(folder))
    again = camera_command(folder, camera.board, again=True)
    if camera.problem:
        return Step(name, "next", camera.found, (*camera.problem, "Mend the file, or make it anew:"), again)
    if changed := _changed(camera, board.photos):
        return Step(name, "next", changed, ("Calibrate the camera again:",), again)
    return Step(name, "done", camera.found)


def _device_file_step(folder: Path, overtaken: bool, otherwise: tuple[tuple[str, str], ...]) -> Step:
    name, path = _DEVICE_FILE, folder / _DEVICE_FILE
    if not path.exists():
        return Step(name, _open(overtaken), "not there yet", ("It describes the device:",), init_command(folder))
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
    measured = _count(n, "distance") if n else "no distances: the scale is free"
    return Step(name, "done", f"{len(device.ids)} targets, {measured}")


def _shots_step(folder: Path, shots: _Photos, overtaken: bool, otherwise: tuple[tuple[str, str], ...]) -> Step:
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
    take = photos_command(folder, "device")
    if n < 2:
        own = f"Or put {DEVICE_ENOUGH} to {DEVICE_MOST} sharp photos into {shots.folder}."
        return Step(name, _open(overtaken), shots.found, todo, take, ((own, ""), *otherwise))
    so_far = (f"{n} so far, of {DEVICE_ENOUGH} to {DEVICE_MOST}: from the front, both sides, above and below. Go on:",)
    return Step(name, "next", shots.found, so_far, take, (("Or go on with these:", device_command(folder)),))


def _rig_step(folder: Path, rig: _Result | None, shots: _Photos) -> Step:
    name = _RIG_FILE
    if rig is None:
        return Step(name, "next", "not there yet", ("Put it all together:",), device_command(folder))
    again = (device_command if shots.photos else rolling_command)(folder, again=True)
    if rig.problem:
        return Step(name, "next", rig.found, (*rig.problem, "Mend the file, or make it anew:"), again)
    changed = [_changed(rig, shots.photos)]
    for path in (folder / _CAMERA_FILE, *([folder / _DEVICE_FILE] if shots.photos else [])):
        if path.is_file() and rig.precedes(path, sha256(path)):
            changed.append(f"{path.name} is newer")
    if found := "; ".join(filter(None, changed)):
        return Step(name, "next", found, ("Calibrate the device again:",), again)
    return Step(name, "done", rig.found, tuple(f"But it warned: {text}" for text in rig.doubts))


def _axes_step(folder: Path) -> Step:
    path = folder / _CONFIG_FILE
    show = (
        "The film shows it:" if _film(folder) else "Stand where the player stands, and show it, asked for one by one:"
    )
    todo = (f"Which way is right? {show}",)
    command = axes_command(folder / _RIG_FILE)
    if not path.exists():
        return Step("axes", "next", "not asked yet", todo, command)
    try:
        motion = without_schema(read_document(path), "configuration").data.get("motion")
        player = (motion or {}).get("player")
    except ConfigurationError as e:
        return Step("axes", "next", f"{path.name} cannot be used", (*str(e).splitlines(), "Mend the file."), "")
    except AttributeError:
        return Step("axes", "next", f"{path.name} cannot be used", (f"{path}: motion is no section.", "Mend the file."))
    if player is None:
        return Step("axes", "next", f"{path.name} does not say where the player stands", todo, command)
    return Step("axes", "done", f"player: {shown(player)}")


def _run_step(folder: Path) -> Step:
    command = ["spheremouse", "run", "--config", str(folder / _CONFIG_FILE)]
    watch = ["--output", "null", "--table"]
    if film := _film(folder):
        todo = ("All is calibrated. Watch what the ball of the practice set does:",)
        return Step("run", "next", "", todo, shlex.join([*command, "--source", film, "--realtime", *watch]))
    todo = ("All is calibrated. Play; `spheremouse ctl watch` in another terminal says what the ball does:",)
    told = (("Or only watch what the ball does:", shlex.join([*command, *watch])),)
    return Step("run", "next", "", todo, shlex.join([*command, "--output", "auto"]), told)


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


# ---- what is there ----


def _photos(folder: Path, camera_path: Path | None = None) -> _Photos:
    """The photos in a folder, and whether they are of the mode of a camera file."""
    try:
        there = any(p.is_file() and not p.name.startswith(".") for p in folder.iterdir())
        photos = read_photos([folder], note=lambda _: None) if there else []
        if photos and camera_path is not None:
            check_size(photos, load_camera(camera_path), camera_path)
    except OSError:
        return _Photos(folder)
    except CalibrationError as e:
        return _Photos(folder, problem=tuple(str(e).splitlines()))
    return _Photos(folder, tuple(photos))


def _camera(path: Path) -> _Result | None:
    if not path.exists():
        return None
    try:
        camera = load_camera(path)
    except ConfigurationError as e:
        return _Result(path, "cannot be used", tuple(str(e).splitlines()))
    made = _provenance(path)
    words = f"{camera.width}x{camera.height}, focal length {camera.fx:.1f} px"
    size = camera.width, camera.height
    used, left_out = _hashes(made.get("photos")), _hashes(made.get("left_out"))
    return _Result(path, words, (), _hashes(made), used, left_out, options_made_of(made), size)


def _rig(path: Path) -> _Result | None:
    if not path.exists():
        return None
    try:
        rig = load_rig(path)
    except ConfigurationError as e:
        return _Result(path, "cannot be used", tuple(str(e).splitlines()))
    made = _provenance(path)
    size = "scale free" if rig.scale_free else f"ball of {rig.ball.radius:.3f} m radius"
    words = f"{size}, {_count(len(rig.targets.ids), 'target')}"
    said = made.get("warnings")
    doubts = tuple(str(w) for w in said) if isinstance(said, tuple | list) else ()
    return _Result(path, words, (), _hashes(made), _hashes(made.get("photos")), doubts=doubts)


def _provenance(path: Path) -> dict[str, Any]:
    data = read_document(path).data
    made = data.get("provenance") if isinstance(data, dict) else None
    return made if isinstance(made, dict) else {}


def _hashes(part: Any) -> frozenset[str]:
    """All SHA-256 in a part of a file, wherever they stand."""

    def walk(value: Any) -> Iterator[str]:
        if isinstance(value, str) and re.fullmatch(r"[0-9a-f]{64}", value):
            yield value
        for inner in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
            yield from walk(inner)

    return frozenset(walk(part))


def _changed(result: _Result, photos: Sequence[Photo]) -> str:
    """Difference of the photos from those a result was made from; nothing where there is none, or none are left."""
    new = sum(result.precedes(p.path, p.sha256) for p in photos)
    here = {p.sha256 for p in photos}
    gone = len(result.photo_hashes - here) if result.photo_hashes & here else 0
    words = [f"{_count(new, 'photo')} came later"] if new else []
    words += [f"{_count(gone, 'photo')} it was made from {'is' if gone == 1 else 'are'} gone"] if gone else []
    return ", ".join(words)


def _count(n: int, thing: str) -> str:
    return f"{n} {thing}{'' if n == 1 else 's'}"
