"""`spheremouse calibrate camera`: the interior orientation from photos of a board."""

from pathlib import Path
from typing import Annotated

import typer

from spheremouse.calibrate.outputs import check_outputs, copyable, note, option_words
from spheremouse.commands.options import Corners, Dictionary, Force, JsonFile, Marker, Report, Square
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import CalibrationError
from spheremouse.files.safe_files import write_json

EXAMPLE = "board/ --board 11x8 --square 86mm --out camera.yaml"

_TERMS = (0, 2, 4, 5)
_ALL_TERMS = 5


def camera(
    photos: Annotated[
        list[Path] | None, typer.Argument(metavar="PHOTOS...", help="Photos of the board, or their folder.")
    ] = None,
    board: Corners = None,
    square: Square = None,
    marker: Marker = None,
    dictionary: Dictionary = None,
    distortion: Annotated[
        int, typer.Option(metavar="0|2|4|5", help="Terms of the lens: k1 k2, also p1 p2, also k3.")
    ] = _ALL_TERMS,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The camera file to write.")] = Path("camera.yaml"),
    report: Report = None,
    json_file: JsonFile = None,
    force: Force = False,
) -> None:
    """Find focal lengths, principal point and lens distortion from photos of a chessboard or ChArUco board.

    Take 10 to 20 photos in the mode (size, zoom, focus) of the later use. Show the whole board in each, tilt it to all
    sides, and reach all corners of the picture. `calibrate photos --for camera` takes them, and writes board.yaml.
    """
    from spheremouse.calibrate.board import NAME, chosen_board
    from spheremouse.calibrate.camera.calibrate import calibrate, provenance
    from spheremouse.calibrate.photos import read_photos
    from spheremouse.calibrate.report.camera import advise, camera_json, print_camera, write_camera_report
    from spheremouse.commands.terminal import table_console
    from spheremouse.files.rig import save_camera

    if not photos:
        raise CalibrationError(f"the command needs photos and a board. example: spheremouse calibrate camera {EXAMPLE}")
    folder = photos[0] if photos[0].is_dir() else photos[0].parent
    if square is None and not (folder.parent / NAME).is_file():
        raise CalibrationError(
            "--square: measure the side of a square on the print, and give it with the board's inner corners, as in "
            "--board 11x8 --square 86mm"
        )
    pattern = chosen_board(folder.parent, board, square, marker, dictionary)
    if distortion not in _TERMS:
        raise CalibrationError(f"--distortion {distortion}: must be one of {', '.join(map(str, _TERMS))}")
    report_file, figures_file = report or out.with_suffix(".html"), json_file or out.with_suffix(".json")
    check_outputs([out, report_file, figures_file], photos, force=force)
    if square is None:
        note(f"the board, from its board.yaml: {' '.join(pattern.options)}")
    found = read_photos(photos, note)
    with progress_bar() as bar:
        task = bar.add_task("", total=2 * len(found))
        done = calibrate(found, pattern, distortion, lambda what: bar.update(task, description=what, advance=1))
    made_from = provenance(done)
    write_camera_report(report_file, done, made_from)
    printed = write_json(figures_file, camera_json(done))
    save_camera(out, done.found.camera, made_from)  # last: it shows that all files are complete
    if printed:
        return
    print_camera(done, table_console())
    typer.echo(f"{out}: the camera; {report_file}: the report; {figures_file}: its figures")
    if any(kind != "good" for kind, _ in advise(done)):
        terms = None if distortion == _ALL_TERMS else str(distortion)
        words = option_words({"--distortion": terms, "--report": report, "--json": json_file, "--out": out})
        repeat_command = copyable("spheremouse", "calibrate", "camera", *photos, *pattern.options, *words, "--force")
        typer.echo(f"with more photos, again: {repeat_command}")
    typer.echo(f"next: {_next_command(out)}")


def _next_command(out: Path) -> str:
    from spheremouse.calibrate.guide.folder import init_command, photos_command
    from spheremouse.calibrate.photos import has_photos

    folder = out.parent
    if not (folder / "device.yaml").exists():
        return init_command(folder)
    if not has_photos(folder / "device") and out.name == "camera.yaml":
        return photos_command(folder, "device")
    words = ("calibrate", "device", folder / "device", "--device", folder / "device.yaml", "--camera", out)
    return copyable("spheremouse", *words, "--out", folder / "rig.yaml")
