"""`spheremouse calibrate practice`: a folder of simulated calibration photos with the truth, to try calibration on.

The folder has board/*.jpg, device/*.jpg, device.yaml (what a person would know and measure) and truth.json.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from spheremouse.calibrate.outputs import copyable
from spheremouse.commands.options import with_fields
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import CalibrationError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.folders import NewFolder
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.stills import DeviceShape, Stills, StillsOptions, photos, prepare_stills, truth_of

EXAMPLE = "Example: spheremouse calibrate practice evening --photos 8 --seed 1"

_PARTS = ("board", "device", "device.yaml", "truth.json")
_TAPE = 0.001  # m, standard deviation of a tape measure held by hand
# as in the reference sets: at half the resolution the colours of narrow rings mix
_FULL_COLOUR = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)


@with_fields()
def practice(
    folder: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of the photos; made, or empty.")],
    *,
    like: Annotated[
        Path | None,
        typer.Option(metavar="DATASET", help="Photograph this dataset's device: ball, discs and targets as there."),
    ] = None,
    options: StillsOptions,
    jpeg: Annotated[int, typer.Option(metavar="Q", min=50, max=100, help="Quality of the JPEG files.")] = 95,
    force: Annotated[bool, typer.Option("--force", help="Replace a practice set that is there.")] = False,
) -> None:
    """Photograph a simulated device and board, with the truth: to try calibration before the real evening.

    Six photos are from front, left, right, high, low and turned by 90 degrees; more stand between and beside them.
    """
    if like is not None and options.discs is not None:
        raise CalibrationError(
            f"--discs {options.discs}: the discs are those of --like {like}; leave one of the two out"
        )
    if options.photos + options.boards == 0:
        raise CalibrationError("--photos 0 --boards 0: nothing to photograph; ask for one or more of a kind")
    if options.focal is not None and not 10.0 <= options.focal <= 100_000.0:
        raise CalibrationError(f"--focal {options.focal:g}: must be from 10 to 100000 px")
    stills = prepare_stills(options, None if like is None else device_of(like))
    with _new_folder(folder, force) as made, progress_bar() as bar:
        task = bar.add_task(f"photographing into {folder}", total=options.photos + options.boards)
        for _ in write_stills(made, stills, jpeg):
            bar.advance(task)
    what = "a practice device" if like is None else f"the device of {like}"
    many = "photo" if options.photos == 1 else "photos"
    print(f"{folder}: {options.photos} {many} of {what}, {options.boards} of the board, device.yaml, truth.json")
    lens, given = folder / "camera.yaml", folder / "device.yaml"
    camera = ("camera", folder / "board", "--board", "11x8", "--square", "86mm", "--out", lens)
    device = ("device", folder / "device", "--device", given, "--camera", lens, "--out", folder / "rig.yaml")
    print(f"next: {copyable('spheremouse', 'calibrate', *camera)}")
    print(f"then: {copyable('spheremouse', 'calibrate', *device)}")


def device_of(dataset: Path) -> DeviceShape:
    """Ball, targets and discs of a dataset, the ball lying as in its first frame."""
    recording = open_dataset(dataset)
    rig, directions = recording.rig, recording.truth_directions
    if directions is None:
        raise CalibrationError(f"{dataset}: scene.json says nothing of the discs' places (truth_disc_directions)")
    if len(rig.targets.ids) < 3:
        raise CalibrationError(
            f"{dataset}: {len(rig.targets.ids)} ring targets in scene.json; photos of a device need 3 or more"
        )
    attitude = np.eye(3) if recording.truth is None else recording.truth.attitude[0]
    return DeviceShape(rig.ball.radius, rig.disc_radius, rig.targets, directions @ attitude.T)


def write_stills(folder: Path, stills: Stills, quality: int) -> Iterator[Path]:
    """Write everything into a folder that is there and empty, giving each photo's path when it is done."""
    (folder / "board").mkdir()
    (folder / "device").mkdir()
    for photo in photos(stills):
        path = folder / f"{photo.name}.jpg"
        if not cv2.imwrite(str(path), photo.image, [*_FULL_COLOUR, cv2.IMWRITE_JPEG_QUALITY, quality]):
            raise CalibrationError(f"{path.name}: cannot be written; is the disk full?")
        yield path
    (folder / "truth.json").write_text(json.dumps(truth_of(stills), indent=1) + "\n", encoding="utf-8")
    (folder / "device.yaml").write_text(device_yaml(stills), encoding="utf-8")


# ---- device.yaml ----


def device_yaml(stills: Stills) -> str:
    """A device.yaml as a person knows the device and measures it with a tape, whose errors are drawn."""
    scene, targets = stills.scene, stills.scene.targets
    rng = np.random.default_rng([stills.seed, 5])
    lines = ["# what a person knows of the device and measured with a tape", "targets:"]
    lines += [f"  - {{id: {i}, code: {code}}}" for i, code in zip(targets.ids, targets.codes, strict=True)]
    inner, middle, outer = targets.radii
    lines.append(f"target_radii: [{inner:g}, {middle:g}, {outer:g}]  # m, inner disc, middle ring, outer ring")
    lines.append(f"disc_radius: {scene.disc_radius:g}  # m, along the ball's surface")
    origin, up, plane = (targets.ids[k] for k in axes_of(targets.position))
    lines.append(
        f"axes: {{origin: {origin}, up: {up}, plane: {plane}}}  # Y from target {origin} to target {up}; "
        f"X in the plane with target {plane}; Z towards the camera; origin moved to the ball's centre"
    )
    lines.append("distances:")
    for a, b in sides(targets.position):
        true = float(np.linalg.norm(targets.position[a] - targets.position[b]))
        lines.append(
            f"  - {{from: {targets.ids[a]}, to: {targets.ids[b]}, metres: {true + rng.normal(0.0, _TAPE):.4f}, "
            f"sigma: {_TAPE:g}}}"
        )
    return "\n".join(lines) + "\n"


def axes_of(position: Array) -> tuple[int, int, int]:
    """Targets, of those at (n, 3) m in obj, that give its axes best: origin, up, and one in the plane."""
    best, chosen = np.inf, (0, 1, 2)
    for a in range(len(position)):
        for b in range(len(position)):
            for c in range(len(position)):
                if len({a, b, c}) == 3:
                    y, x = position[b] - position[a], position[c] - position[a]
                    z = np.cross(x, y)
                    area = np.linalg.norm(z)
                    if area > 1e-3 * np.linalg.norm(x) * np.linalg.norm(y):
                        # off by the turn of Y, and by that of the plane, which may face either way
                        off = 2.0 - y[1] / np.linalg.norm(y) - abs(z[2]) / area
                        if off < best - 1e-9:
                            best, chosen = float(off), (a, b, c)
    return chosen


def sides(position: Array) -> list[tuple[int, int]]:
    """Pairs of neighbours going round the targets, (n, 3) m, as one would hold a tape."""
    away = position - position.mean(axis=0)
    order = [int(k) for k in np.argsort(np.arctan2(away[:, 1], away[:, 0]))]
    pairs = zip(order, order[1:] + order[:1], strict=True)
    return sorted((min(a, b), max(a, b)) for a, b in pairs)


# ---- the folder ----


@contextmanager
def _new_folder(path: Path, replace: bool) -> Iterator[Path]:
    """A folder beside `path` that takes its name at the end, or vanishes after an exception."""
    path = path.absolute()
    _refuse(path, replace)
    made = NewFolder(path, CalibrationError)
    try:
        made.path.chmod(0o755)
        yield made.path
        _refuse(path, replace)  # once more: somebody may have come first
        made.finish()
    except OSError as e:
        raise CalibrationError(f"{path}: cannot be written ({e.strerror})") from None
    finally:
        made.discard()


def _refuse(path: Path, replace: bool) -> None:
    if not path.exists():
        return
    if not path.is_dir():
        raise CalibrationError(f"{path}: is a file; name a folder to write to")
    content = {p.name for p in path.iterdir()}
    if content and not replace:
        raise CalibrationError(f"{path}: is not empty; name another folder or use --force to replace it")
    if odd := sorted(content - set(_PARTS)):
        raise CalibrationError(f"{path}: holds {odd[0]}, which is no part of a practice set; it will not be replaced")
    if content and not (path / "truth.json").is_file():
        raise CalibrationError(f"{path}: holds no truth.json, so these are real photos; they will not be replaced")
