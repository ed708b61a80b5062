"""`spheremouse calibrate device`: photos of a device in, rig.yaml with its map of discs and a report out."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from spheremouse import __version__
from spheremouse.ball.device import Device, DistanceError
from spheremouse.calibrate.device.adjust import DOUBTFUL_RMS, DeviceCalibration
from spheremouse.calibrate.device.advice import advise
from spheremouse.calibrate.device.plans import Advice
from spheremouse.calibrate.device.report import AXES, MARKS, write_device_report
from spheremouse.calibrate.device.results import (
    advice_or_made,
    device_json,
    distance_rows,
    per_photo,
    points,
    px,
    rms_of,
    sigma_of,
    unit_of,
)
from spheremouse.calibrate.outputs import check_outputs, copyable, note, sha256
from spheremouse.calibrate.photos import Photo, check_size, image, read_photos
from spheremouse.capture.usual import usual_camera
from spheremouse.commands.calibrate.options import Force, Json, Report
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import CalibrationError
from spheremouse.files.atomic import write_json
from spheremouse.files.device import load_device, untouched
from spheremouse.files.report.style import has_matplotlib
from spheremouse.files.rig import load_camera, save_rig
from spheremouse.files.yaml import read_document
from spheremouse.geometry.camera import InteriorOrientation

if TYPE_CHECKING:
    from spheremouse.ball.settings import Settings

EXAMPLE = "Example: spheremouse calibrate device device/ --device device.yaml --camera camera.yaml --out rig.yaml"

_STEPS = 100


def device(
    photos: Annotated[list[Path], typer.Argument(metavar="PHOTOS...", help="Photos of the device, or their folder.")],
    device_file: Annotated[
        Path, typer.Option("--device", metavar="FILE", help="What is known of it; `calibrate init` writes one.")
    ] = Path("device.yaml"),
    camera_file: Annotated[
        Path, typer.Option("--camera", metavar="FILE", help="The photos' camera, from `calibrate camera`.")
    ] = Path("camera.yaml"),
    out: Annotated[Path, typer.Option(metavar="FILE", help="The rig file to write; its map goes beside it.")] = Path(
        "rig.yaml"
    ),
    report: Report = None,
    json_file: Json = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Configuration: colours of targets (rings), discs.")
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One parameter, as rings.* or discs.*.")
    ] = None,
    force: Force = False,
) -> None:
    """Find targets, ball and discs from photos of the device, with covariances, and write rig.yaml.

    Six to twelve photos from as many sides as targets allow; the ball must not turn between them. Tape distances in
    the device file give metres; without any the scale is free and counts are per radian.
    """
    from spheremouse.commands.config import root
    from spheremouse.files.config import in_force
    from spheremouse.files.disc_map import map_path, save_map, saved_now

    page, the_map = report or out.with_suffix(".html"), map_path(out)
    check_outputs([out, the_map, page, json_file], [*photos, device_file, camera_file, config], force)
    _check_inputs(device_file, camera_file)
    if not has_matplotlib():
        note("the report has no pictures without matplotlib: pip install 'spheremouse[plot]'")
    known, camera = load_device(device_file), load_camera(camera_file)
    chosen = in_force(config, settings or (), root())
    found = read_photos(photos, note=note)
    check_size(found, camera, camera_file)
    if untouched(device_file):
        note(f"{device_file}: still as `calibrate init` wrote it; check every line, then delete its first")
    calibration = _calibrated(found, known, camera, device_file, chosen)
    names = [p.path.name for p in found]
    advice = advise(calibration, names)
    if calibration.rms_px > DOUBTFUL_RMS:
        note(
            f"the photos are {calibration.rms_px:.2f} px off, ten times what sharp ones are: is {camera_file} of this "
            "camera, mode and focus?"
        )
    rig = calibration.rig()
    provenance = _provenance(found, calibration, device_file, camera_file, advice)
    write_device_report(page, calibration, found, provenance, advice)
    save_map(the_map, saved_now(calibration.disc_map(), rig))
    save_rig(out, rig, provenance)  # last: where it is, the rest is
    figures = device_json(calibration, names, advice)
    if json_file is not None and write_json(json_file, figures):
        return
    device_text(calibration, names, advice)
    typer.echo(f"{out}: the rig; {the_map}: where its discs are; {page}: the report")
    typer.echo(f"next: {copyable('spheremouse', 'axes', '--rig', out, '--source', usual_camera())}")
    typer.echo(
        "      with --camera FILE where the camera runs in another mode than the photos'; --output uinput is the mouse"
    )


def _check_inputs(device_file: Path, camera_file: Path) -> None:
    for file, option, how in (
        (device_file, "--device", "`spheremouse calibrate init` writes one to fill in"),
        (camera_file, "--camera", "`spheremouse calibrate camera` makes it"),
    ):
        if not file.exists():
            raise CalibrationError(f"{file}: no such file; give {option} FILE: {how}")


def _calibrated(
    photos: Sequence[Photo], known: Device, camera: InteriorOrientation, device_file: Path, settings: "Settings"
) -> DeviceCalibration:
    from spheremouse.calibrate.device.calibrate import calibrate_device

    with progress_bar() as bar:
        task = bar.add_task("reading", total=_STEPS)
        try:
            return calibrate_device(
                [lambda photo=photo: image(photo) for photo in photos],
                known,
                camera,
                settings.rings,
                settings.discs,
                [p.path.name for p in photos],
                lambda what, part: bar.update(task, description=what, completed=round(_STEPS * part)),
            )
        except DistanceError as e:
            line = read_document(device_file).line(("distances", e.index))
            raise CalibrationError(f"{device_file}:{line}: {e}") from None


def _provenance(
    photos: Sequence[Photo],
    calibration: DeviceCalibration,
    device_file: Path,
    camera_file: Path,
    advice: Sequence[Advice],
) -> dict[str, Any]:
    used = [photos[k] for k in calibration.photos]
    return {
        "made_by": f"spheremouse {__version__}, calibrate device",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "device": {"file": device_file.name, "sha256": sha256(device_file)},
        "camera": {"file": camera_file.name, "sha256": sha256(camera_file)},
        "warnings": [a.text for a in advice if a.kind == "warning"],
        "photos": [{"file": p.path.name, "sha256": p.sha256} for p in used],
        "left_out": [{"file": photos[k].path.name, "why": why} for k, why in calibration.skipped],
    }


def device_text(
    calibration: DeviceCalibration,
    names: Sequence[str],
    advice: Sequence[Advice] | None = None,
    console: Console | None = None,
) -> None:
    """Print the figures that matter, and the advice; `names` of all photos."""
    c = calibration
    console = console or Console(highlight=False)
    unit, f, digits = unit_of(c)
    ball = np.sqrt(np.diag(c.ball_covariance))
    lines = Table(box=None, show_header=False, pad_edge=False, padding=(0, 3, 0, 0))
    if not c.scale_free:
        lines.add_row("radius", f"{f * c.radius:.{digits}f} ± {f * ball[3]:.{digits}f} {unit}")
    where = ", ".join(f"{a} ± {f * s:.{digits}f}" for a, s in zip(AXES, ball, strict=False))
    lines.add_row("ball's centre", f"{where} {unit} against the targets")
    lines.add_row("targets", f"{len(c.targets)}, ± {f * rms_of(sigma_of(c, 'targets')):.{digits}f} {unit}")
    often = int(np.count_nonzero(c.sightings >= 3))
    lines.add_row(
        "discs", f"{len(c.discs)}, ± {f * rms_of(sigma_of(c, 'discs')):.{digits}f} {unit}; {often} in 3 photos +"
    )
    lines.add_row("image points", f"{points(c)}; {c.rms_px:.3f} px RMS")
    console.print(Padding(lines, (0, 0, 1, 0)))
    photos = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for head in ("photo", "points", "not used", "px RMS", f"place ± {unit}", "attitude ± °"):
        photos.add_column(head, justify="left" if head == "photo" else "right")
    for k, pose, (used, rejected, rms) in zip(c.photos, c.poses, per_photo(c), strict=True):
        sigma = np.sqrt(np.diag(pose.covariance))
        photos.add_row(
            Text(names[k]), str(used), str(rejected or "-"), px(rms),
            f"{f * np.linalg.norm(sigma[:3]):.{digits}f}", f"{np.degrees(np.linalg.norm(sigma[3:])):.3f}",
        )  # fmt: skip
    console.print(Padding(photos, (0, 0, 1, 0)))
    if c.device.distances:
        tape = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
        for head in ("distance", "tape mm", "adjusted mm", "residual mm", "over sigma"):
            tape.add_column(head, justify="left" if head == "distance" else "right")
        for row in distance_rows(c):
            tape.add_row(*(row[i] for i in (0, 1, 3, 5, 6)))
        console.print(Padding(tape, (0, 0, 1, 0)))
    for a in advice_or_made(c, names, advice):
        mark, colour = MARKS[a.kind]
        line = Table.grid(padding=(0, 1, 0, 0))
        line.add_row(Text(mark, style=colour), Text(a.text))
        console.print(line)
