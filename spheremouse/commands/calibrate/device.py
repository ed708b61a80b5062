"""`spheremouse calibrate device`: rig.yaml with its map of discs, and a report, from photos of a device."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.calibrate.outputs import check_outputs, copyable, note, option_words, sha256
from spheremouse.commands.options import Force, JsonFile, Report
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import CalibrationError
from spheremouse.files.safe_files import write_json

if TYPE_CHECKING:
    from spheremouse.ball.device import Device
    from spheremouse.ball.settings import Settings
    from spheremouse.calibrate.device.adjust import DeviceCalibration
    from spheremouse.calibrate.photos import Photo
    from spheremouse.geometry.camera import InteriorOrientation

_PROGRESS_STEPS = 100


def device(
    photos: Annotated[list[Path], typer.Argument(metavar="PHOTOS...", help="Photos of the device, or their folder.")],
    device_file: Annotated[
        Path,
        typer.Option("--device", metavar="FILE", help="Targets, sizes and distances; `calibrate init` writes one."),
    ] = Path("device.yaml"),
    camera_file: Annotated[
        Path, typer.Option("--camera", metavar="FILE", help="The photos' camera, from `calibrate camera`.")
    ] = Path("camera.yaml"),
    out: Annotated[Path, typer.Option(metavar="FILE", help="The rig file to write; its map goes beside it.")] = Path(
        "rig.yaml"
    ),
    report: Report = None,
    json_file: JsonFile = None,
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Configuration, for the colours of the targets and the detection of discs."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One setting of rings or discs, such as discs.contrast=0.3."),
    ] = None,
    force: Force = False,
) -> None:
    """Find targets, ball and discs from photos of the device, with covariances, and write rig.yaml.

    Take six to twelve photos from as many sides as the targets allow. The ball must not turn between them. Tape
    distances in the device file give metres; without any the scale is free, and counts are per radian.
    """
    from rich.console import Console

    from spheremouse.calibrate.device.adjust import DOUBTFUL_RMS
    from spheremouse.calibrate.device.advice import advise
    from spheremouse.calibrate.guide.folder import axes_command
    from spheremouse.calibrate.photos import check_size, provenance, read_photos
    from spheremouse.calibrate.report.device import device_json, print_device, write_device_report
    from spheremouse.files.ball_map import map_path, save_map, saved_now
    from spheremouse.files.config import in_force
    from spheremouse.files.device import UNTOUCHED, is_untouched, load_device
    from spheremouse.files.rig import load_camera, save_rig
    from spheremouse.session.settings import Configuration

    report_file, map_file = report or out.with_suffix(".html"), map_path(out)
    figures_file = json_file or out.with_suffix(".json")
    outputs = [out, map_file, report_file, figures_file]
    check_outputs(outputs, [*photos, device_file, camera_file, config], force=force)
    _check_inputs(device_file, camera_file)
    described, camera = load_device(device_file), load_camera(camera_file)
    if is_untouched(device_file):
        raise CalibrationError(
            f"{device_file}: not filled in yet; enter your targets and distances, then delete its first line "
            f"({UNTOUCHED.partition(':')[0]} ...); if it is all true of your device already, delete that line alone"
        )
    settings_used = in_force(config, settings or (), Configuration)
    photos_read = read_photos(photos, note=note)
    check_size(photos_read, camera, camera_file)
    calibration = _calibrate(photos_read, described, camera, device_file, settings_used)
    names = [p.path.name for p in photos_read]
    advice = advise(calibration, names)
    if calibration.rms_px > DOUBTFUL_RMS:
        note(
            f"the photos are {calibration.rms_px:.2f} px off, at least ten times more than sharp photos: is "
            f"{camera_file} of this camera, mode and focus?"
        )
    rig = calibration.rig()
    sources = {
        "device": {"file": device_file.name, "sha256": sha256(device_file)},
        "camera": {"file": camera_file.name, "sha256": sha256(camera_file)},
        "warnings": [a.text for a in advice if a.kind == "warning"],
    }
    made_from = provenance("calibrate device", photos_read, dict(calibration.skipped), sources)
    write_device_report(report_file, calibration, photos_read, made_from, advice)
    save_map(map_file, saved_now(calibration.disc_map(), rig))
    printed = write_json(figures_file, device_json(calibration, names, advice))
    save_rig(out, rig, made_from)  # last: it shows that all files are complete
    if printed:
        return
    print_device(calibration, advice, Console(highlight=False))
    typer.echo(
        f"{out}: the rig; {map_file}: the map of its discs; {report_file}: the report; {figures_file}: its figures"
    )
    if any(a.kind != "good" for a in advice):
        options = {"--device": device_file, "--camera": camera_file, "--config": config}
        words = option_words({**options, "--report": report, "--json": json_file, "--out": out})
        words += [word for one in settings or () for word in ("--set", one)]
        repeat_command = copyable("spheremouse", "calibrate", "device", *photos, *words, "--force")
        typer.echo(f"with more photos, again: {repeat_command}")
    typer.echo(f"next: {axes_command(out)}")
    typer.echo("      to `spheremouse axes`, add --camera FILE if the camera runs in another mode than in the photos")


def _check_inputs(device_file: Path, camera_file: Path) -> None:
    for file, option, hint in (
        (device_file, "--device", "`spheremouse calibrate init` writes one to fill in"),
        (camera_file, "--camera", "`spheremouse calibrate camera` makes it"),
    ):
        if not file.exists():
            raise CalibrationError(f"{file}: no such file; give {option} FILE: {hint}")


def _calibrate(
    photos: "Sequence[Photo]",
    described: "Device",
    camera: "InteriorOrientation",
    device_file: Path,
    settings: "Settings",
) -> "DeviceCalibration":
    """Run the calibration with a progress bar; an error of a distance names the line of the device file."""
    from spheremouse.ball.device import DistanceError
    from spheremouse.calibrate.device.calibrate import calibrate_device
    from spheremouse.calibrate.photos import image
    from spheremouse.files.yaml import read_document

    with progress_bar() as bar:
        task = bar.add_task("reading", total=_PROGRESS_STEPS)
        try:
            return calibrate_device(
                [lambda photo=photo: image(photo) for photo in photos],
                described,
                camera,
                settings.rings,
                settings.discs,
                [p.path.name for p in photos],
                lambda what, part: bar.update(task, description=what, completed=round(_PROGRESS_STEPS * part)),
            )
        except DistanceError as e:
            line = read_document(device_file).line(("distances", e.index))
            raise CalibrationError(f"{device_file}:{line}: {e}") from None
