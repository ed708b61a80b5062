"""The folder of a ball without a calibration: rig, camera and configuration, and a picture to confirm."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from spheremouse import __version__
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.rig import Rig
from spheremouse.calibrate.guide.folder import CAMERA_FILE, CONFIG_FILE, RIG_FILE
from spheremouse.calibrate.outline.fit import Outline
from spheremouse.calibrate.outputs import check_outputs, copyable
from spheremouse.errors import CalibrationError, os_errors_as
from spheremouse.files.config import to_yaml
from spheremouse.files.rig import save_camera, save_rig
from spheremouse.files.safe_files import write, write_atomically
from spheremouse.files.yaml import SCHEMAS
from spheremouse.geometry.rotation import Array
from spheremouse.session.overlay.pen import BLUE, GREEN, RED, canvas_of

PICTURE = "outline.png"
_PICTURE_WIDTH_PX = 1280  # px, of the picture

Polygon = Sequence[float]  # x, y, x, y, ... px


def check_folder(folder: Path, inputs: Iterable[Path | None], force: bool) -> None:
    """Raise CalibrationError if the files of the folder may not be written."""
    if folder.is_dir():
        names = (RIG_FILE, CAMERA_FILE, CONFIG_FILE, PICTURE)
        check_outputs([folder / name for name in names], inputs, force=force)
    elif folder.exists():
        raise CalibrationError(f"{folder}: is a file; name a folder")


def write_folder(folder: Path, rig: Rig, picture: Image, spec: str, settings: Sequence[str], made_by: str) -> None:
    """Write the folder: source `spec`, further lines of the configuration `settings`, and the command `made_by`."""
    provenance = {"made_by": f"spheremouse {__version__}, {made_by}", "source": spec}
    lines = [f"# Made by {made_by}.", f"schema: {SCHEMAS['configuration']}", f"source: {to_yaml(spec)}"]
    lines += [f"rig: {RIG_FILE}", *settings]
    png = cv2.imencode(".png", picture)[1].tobytes()
    with os_errors_as(CalibrationError, f"{folder}: cannot be written"):
        folder.mkdir(parents=True, exist_ok=True)
        write(folder / PICTURE, png)
    save_rig(folder / RIG_FILE, rig, provenance)
    save_camera(folder / CAMERA_FILE, rig.camera, provenance)
    write_atomically(folder / CONFIG_FILE, "\n".join(lines) + "\n")


def draw_outline(image: Image, outline: Array, marks: Iterable[Array], masks: Sequence[Polygon] = ()) -> Image:
    """Return a picture with the outline of the ball, points that it fits, and masks, (n, 2) px."""
    scale = max(1, round(_PICTURE_WIDTH_PX / image.shape[1]))
    canvas = canvas_of(image, scale)
    for lines, colour in (([np.reshape(mask, (-1, 2)) for mask in masks], BLUE), ([outline], GREEN)):
        fixed = [np.rint(((line + 0.5) * scale - 0.5) * 16.0).astype(np.int32) for line in lines]
        cv2.polylines(canvas, fixed, isClosed=True, color=colour, lineType=cv2.LINE_AA, shift=4)
    for mark in marks:
        x, y = np.rint((mark + 0.5) * scale - 0.5).astype(int).tolist()
        cv2.drawMarker(canvas, (x, y), RED, cv2.MARKER_CROSS, 7)
    return canvas


def describe(outline: Outline, rig: Rig) -> str:
    """Return the outline in words, with standard deviations."""
    camera, (across, radius) = rig.camera, np.degrees(outline.sigma)
    px = np.sqrt(camera.fx * camera.fy) * np.pi / 180.0  # of a degree
    x, y = np.mean(outline.pixels(camera), axis=0)
    return (
        f"ball: centre at {x:.1f}, {y:.1f} px, direction ± {across:.2g}° ({across * px:.2f} px), angular radius "
        f"{np.degrees(outline.angle):.5g} ± {radius:.2g}° ({radius * px:.2f} px)"
    )


def next_steps(folder: Path, output: str) -> str:
    """Return the lines about the files that were written, and a command with an output."""
    return (
        f"{folder}: written: {RIG_FILE}, {CAMERA_FILE}, {CONFIG_FILE}, {PICTURE}\n"
        f"look at {folder / PICTURE}: the green line must lie on the ball's edge\n"
        f"next: spheremouse {copyable('run', '--config', folder / CONFIG_FILE, '--output', output)}"
    )
