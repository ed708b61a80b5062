"""`spheremouse calibrate camera`: the interior orientation from photos of a board."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.calibrate.lengths import parse_board, parse_length
from spheremouse.calibrate.outputs import check_outputs, copyable, note
from spheremouse.commands.calibrate.options import Force, Json, Report
from spheremouse.commands.terminal import progress_bar
from spheremouse.errors import CalibrationError
from spheremouse.files.atomic import write_json
from spheremouse.files.report.style import has_matplotlib, require_matplotlib

if TYPE_CHECKING:
    from spheremouse.calibrate.camera.corners import Pattern

EXAMPLE = "Example: spheremouse calibrate camera board/ --board 11x8 --square 86mm --out camera.yaml"
_TERMS = (0, 2, 4, 5)


def camera(
    photos: Annotated[
        list[Path] | None, typer.Argument(metavar="PHOTOS...", help="Photos of the board, or their folder.")
    ] = None,
    board: Annotated[
        str, typer.Option(metavar="CxR", help="Inner corners along and down: one less than squares.")
    ] = "11x8",
    square: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Side of a square, measured on the print, as in 86mm.")
    ] = None,
    marker: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Side of a marker, as in 60mm: it is a ChArUco board.")
    ] = None,
    dictionary: Annotated[
        str, typer.Option(metavar="NAME", help="ChArUco markers, as printed on the board.")
    ] = "DICT_5X5_100",
    source: Annotated[
        str | None, typer.Option(metavar="KIND:ARG", help="Take views live, as `run --source` names a camera.")
    ] = None,
    keep: Annotated[Path, typer.Option(metavar="FOLDER", help="Where a live session keeps its views.")] = Path("board"),
    distortion: Annotated[
        int, typer.Option(metavar="0|2|4|5", help="Terms of the lens: k1 k2, also p1 p2, also k3.")
    ] = 5,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The camera file to write.")] = Path("camera.yaml"),
    report: Report = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Find focal lengths, principal point and lens distortion from photos of a chessboard or ChArUco board.

    10 to 20 photos in the mode (size, zoom, focus) that will be used, the whole board in each, tilted to all sides,
    reaching into all corners of the picture. With --source it watches the camera and takes the views that are wanted.
    """
    from spheremouse.calibrate.camera.calibrate import calibrate, provenance
    from spheremouse.calibrate.camera.report import camera_json, write_camera_report
    from spheremouse.calibrate.photos import read_photos
    from spheremouse.commands.calibrate.camera.text import camera_text
    from spheremouse.files.rig import save_camera

    pattern = _pattern(board, square, marker, dictionary)
    if distortion not in _TERMS:
        raise CalibrationError(f"--distortion {distortion}: must be one of {', '.join(map(str, _TERMS))}")
    if source is None and not photos:
        raise CalibrationError("no photos; name photos or a folder with photos, or a camera with --source opencv:0")
    if source is not None and photos:
        raise CalibrationError("photos and --source: give one of the two; a live session keeps its views in --keep")
    page = _page(report, out)
    check_outputs([out, page, json_file], photos or [], force)
    if source is not None:
        from spheremouse.calibrate.camera.live import take_views

        take_views(source, pattern, keep)
        photos = [keep]
    found = read_photos(photos or [], note)
    with progress_bar() as bar:
        task = bar.add_task("", total=2 * len(found))
        done = calibrate(found, pattern, distortion, lambda what: bar.update(task, description=what, advance=1))
    made_from = provenance(done)
    figures = camera_json(done)
    if page is not None:
        write_camera_report(page, done, made_from)
    save_camera(out, done.found.camera, made_from)
    if json_file is not None and write_json(json_file, figures):
        return
    camera_text(done)
    typer.echo(f"{out}: the camera" + (f"; {page}: the report" if page else ""))
    folder = out.parent
    words = ("calibrate", "device", folder / "device", "--device", folder / "device.yaml", "--camera", out)
    typer.echo(f"next: {copyable('spheremouse', *words, '--out', folder / 'rig.yaml')}")


def _pattern(board: str, square: str | None, marker: str | None, dictionary: str) -> "Pattern":
    from spheremouse.calibrate.camera.corners import DICTIONARIES, Pattern, markers_in, markers_of

    columns, rows = parse_board(board)
    if square is None:
        raise CalibrationError("--square: measure the side of a square on the print, and give it, as in --square 86mm")
    side = parse_length(square)
    if marker is None:
        return Pattern(columns, rows, side)
    inner = parse_length(marker)
    if inner >= side:
        raise CalibrationError(f"--marker {marker}: must be smaller than the square around it, which is {square}")
    name = dictionary.upper()
    name = name if name.startswith("DICT_") else f"DICT_{name}"
    if name not in DICTIONARIES:
        raise CalibrationError(f"--dictionary {dictionary}: not known; one of {', '.join(DICTIONARIES)}")
    pattern = Pattern(columns, rows, side, inner, name)
    if markers_of(pattern) > markers_in(name):
        raise CalibrationError(
            f"--dictionary {name}: has {markers_in(name)} markers, and a board of {columns}x{rows} inner corners "
            f"carries {markers_of(pattern)}; name the dictionary that is printed on the board"
        )
    return pattern


def _page(report: Path | None, out: Path) -> Path | None:
    if report is not None:
        require_matplotlib()
        return report
    if not has_matplotlib():
        note("no report with pictures without matplotlib: pip install 'spheremouse[plot]'")
        return None
    return out.with_suffix(".html")
