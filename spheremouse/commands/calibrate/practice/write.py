"""The files of a practice set: photos, a film, the truth, and a device.yaml with simulated tape distances."""

import json
from collections.abc import Iterator
from itertools import permutations
from pathlib import Path

import cv2
import numpy as np

from spheremouse.ball.rig import Rig
from spheremouse.calibrate.board import NAME, Pattern, save_board
from spheremouse.errors import CalibrationError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball import board
from spheremouse.simulate.ball.film import Simulation
from spheremouse.simulate.ball.profile import shown_to_axes
from spheremouse.simulate.ball.render import RenderOptions
from spheremouse.simulate.ball.stills import Stills, photos, truth_of

_GESTURE_FPS = 10.0  # Hz, enough for gestures
_TAPE_SIGMA = 0.001  # m, standard deviation of a tape measure held by hand
# as in the reference sets: at half the resolution the colours of narrow rings mix
_FULL_COLOUR = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)


def device_of(dataset: Path) -> tuple[Rig, Array]:
    """Return the device of a dataset, and unit vectors to its discs, (n, 3) obj, in its first frame.

    Without a true attitude, that is the identity.
    Raises DatasetError if it is invalid, and CalibrationError without the true places of the discs, or with fewer than
    three targets.
    """
    recording = open_dataset(dataset)
    rig, directions = recording.rig, recording.truth_directions
    if directions is None or rig.disc_radius is None:
        raise CalibrationError(
            f"{dataset}: scene.json lacks the discs' places or size (truth_disc_directions, disc_radius)"
        )
    if len(rig.targets.ids) < 3:
        raise CalibrationError(
            f"{dataset}: {len(rig.targets.ids)} ring targets in scene.json; photos of a device need 3 or more"
        )
    attitude = np.eye(3) if recording.truth is None else recording.truth.attitude[0]
    return rig, directions @ attitude.T


def write_stills(folder: Path, stills: Stills, quality: int) -> Iterator[Path]:
    """Write all files into an empty folder; yield each photo's path. Raises CalibrationError if a photo fails."""
    (folder / "board").mkdir()
    (folder / "device").mkdir()
    for photo in photos(stills):
        path = folder / f"{photo.name}.jpg"
        if not cv2.imwrite(str(path), photo.image, [*_FULL_COLOUR, cv2.IMWRITE_JPEG_QUALITY, quality]):
            raise CalibrationError(f"{path.name}: cannot be written; is the disk full?")
        yield path
    (folder / "truth.json").write_text(json.dumps(truth_of(stills), indent=1) + "\n", encoding="utf-8")
    save_board(folder / NAME, Pattern(board.COLUMNS, board.ROWS, board.SQUARE))
    (folder / "device.yaml").write_text(device_yaml(stills), encoding="utf-8")


def film_of(stills: Stills) -> Simulation:
    """Return a film of the gestures for `spheremouse axes`, from the place of the first photo."""
    profile = shown_to_axes()
    return Simulation(stills.scene, profile, RenderOptions(), profile.seconds, _GESTURE_FPS, stills.seed)


def device_yaml(stills: Stills) -> str:
    """Return a device.yaml with tape distances that have random errors."""
    scene, targets = stills.scene, stills.scene.targets
    rng = np.random.default_rng([stills.seed, 5])
    lines = ["# measurements of the device with a tape", "targets:"]
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
            f"  - {{from: {targets.ids[a]}, to: {targets.ids[b]}, metres: {true + rng.normal(0.0, _TAPE_SIGMA):.4f}, "
            f"sigma: {_TAPE_SIGMA:g}}}"
        )
    return "\n".join(lines) + "\n"


def axes_of(position: Array) -> tuple[int, int, int]:
    """Return the best targets, of those at (n, 3) m in obj, for its axes: origin, up, and one in the plane."""
    best, chosen = np.inf, (0, 1, 2)
    for a, b, c in permutations(range(len(position)), 3):
        y, x = position[b] - position[a], position[c] - position[a]
        z = np.cross(x, y)
        area = np.linalg.norm(z)
        if area > 1e-3 * np.linalg.norm(x) * np.linalg.norm(y):
            # errors of Y and of the plane, which may face either way
            off = 2.0 - y[1] / np.linalg.norm(y) - abs(z[2]) / area
            if off < best - 1e-9:
                best, chosen = float(off), (a, b, c)
    return chosen


def sides(position: Array) -> list[tuple[int, int]]:
    """Return pairs of neighbours around the targets, (n, 3) m."""
    away = position - position.mean(axis=0)
    order = [int(k) for k in np.argsort(np.arctan2(away[:, 1], away[:, 0]))]
    pairs = zip(order, order[1:] + order[:1], strict=True)
    return sorted((min(a, b), max(a, b)) for a, b in pairs)
