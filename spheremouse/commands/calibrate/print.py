"""`spheremouse calibrate print`: the pages to print for a calibration, at true scale."""

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from spheremouse.errors import CalibrationError
from spheremouse.files.safe_files import read_bytes, replace

_MIN_LENGTH, _MAX_LENGTH = 0.5, 1000.0  # mm, of printed shapes


Kind = StrEnum("Kind", ["TARGETS", "BOARDS", "DISCS", "RECIPE"])


def print_(
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Where the files go.")] = Path("calibration/print"),
    only: Annotated[list[Kind] | None, typer.Option(help="Print this alone; may be given again.")] = None,
    paper: Annotated[
        Literal["a4", "letter", "a3", "a2", "a1", "a0"],
        typer.Option(help="Paper of printer or copy shop.", case_sensitive=False),
    ] = "a4",
    board: Annotated[str, typer.Option(metavar="NxM", help="Inner corners of the boards, along and down.")] = "11x8",
    square: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH", help="Square of the boards, as in 30mm.  [default: the largest that fits the paper]"
        ),
    ] = None,
    ring_radii: Annotated[
        str, typer.Option(metavar="R/R/R", help="Radii of a target's circles in mm, inside to outside.")
    ] = "12/24/36mm",
    discs: Annotated[int, typer.Option(metavar="N", min=1, max=500, help="Discs to cut out.")] = 26,
    disc_radius: Annotated[str, typer.Option(metavar="LENGTH", help="Radius of a disc along the surface.")] = "20mm",
    force: Annotated[bool, typer.Option("--force", help="Replace files that differ.")] = False,
) -> None:
    """Make the pages to print for a calibration: targets, boards, discs, and the recipe to follow.

    Vector PDFs at true scale, with rulers to check the print; the recipe is HTML. The same options give the same bytes.
    """
    from spheremouse.calibrate.board import NAME, Pattern, parse_board
    from spheremouse.calibrate.prints import sheets
    from spheremouse.calibrate.prints.page import pdf

    kinds, size = set(only or Kind), paper
    corners = parse_board(board)
    side = sheets.largest_square(corners, size) if square is None else _millimetres("--square", square)
    if side < _MIN_LENGTH:
        raise CalibrationError(f"--board {board}: too many corners for one page of {size}; give a --square")
    made: dict[str, bytes] = {}
    if Kind.TARGETS in kinds:
        radii = parse_radii(ring_radii)
        made[f"targets-{'-'.join(sheets.mm(r) for r in radii)}mm-{size}.pdf"] = pdf(
            sheets.target_pages(radii, size), "Ring targets"
        )
    if Kind.BOARDS in kinds:
        for pattern in (sheets.chessboard(corners, side), sheets.charuco(corners, side)):
            made[f"{pattern.file}-{size}.pdf"] = pdf([sheets.board_page(pattern, size)], pattern.name)
        made[NAME] = Pattern(corners.columns, corners.rows, side / 1000).text.encode()
    if Kind.DISCS in kinds:
        radius = _millimetres("--disc-radius", disc_radius)
        made[f"discs-{discs}-{sheets.mm(radius)}mm-{size}.pdf"] = pdf(sheets.disc_pages(discs, radius, size), "Discs")
    if Kind.RECIPE in kinds:
        made["recipe.html"] = sheets.recipe(corners, side, size).encode()
    _write(out, made, force)
    steps = ["print the PDF files at 100 % (actual size) and check the rulers"] if kinds != {Kind.RECIPE} else []
    steps += [f"print {out / 'recipe.html'} from a browser and follow it"] if Kind.RECIPE in kinds else []
    typer.echo(f"next: {'; '.join(steps)}")


def _millimetres(option: str, text: str) -> float:
    from spheremouse.calibrate.board import parse_length

    length = round(1e3 * parse_length(text), 6)
    if not _MIN_LENGTH <= length <= _MAX_LENGTH:
        raise CalibrationError(f"{option} {text}: must be from {_MIN_LENGTH:g} to {_MAX_LENGTH:g} mm")
    return length


def parse_radii(text: str) -> tuple[float, float, float]:
    """Return inner, middle and outer radius in mm of `12/24/36mm`; CalibrationError for anything else."""
    found = re.fullmatch(r"([\d.]+)(?:mm)?[/,]([\d.]+)(?:mm)?[/,]([\d.]+)(?:mm)?", re.sub(r"\s", "", text))
    if not found:
        raise CalibrationError(f"--ring-radii {text}: must be three radii in mm, as in 12/24/36mm")
    radii = [_millimetres("--ring-radii", f"{word}mm") for word in found.groups()]
    if not radii[0] < radii[1] < radii[2]:
        raise CalibrationError(f"--ring-radii {text}: must grow from the inside to the outside, as in 12/24/36mm")
    return radii[0], radii[1], radii[2]


def _write(folder: Path, made: dict[str, bytes], force: bool) -> None:
    """Write all files, or none if one of them exists and differs; board.yaml may differ."""
    from spheremouse.calibrate.board import NAME

    try:
        folder.mkdir(parents=True, exist_ok=True)
        there = [name for name in made if name != NAME and (folder / name).exists()]
        differ = [] if force else [name for name in there if not _holds(folder / name, made[name])]
        if differ:
            other = f" (and {len(differ) - 1} more)" if len(differ) > 1 else ""
            raise CalibrationError(
                f"{folder / differ[0]}{other}: exists with other contents; use --force or another --out"
            )
        for name, data in made.items():
            replace(folder / name, data)
            typer.echo(f"{folder / name}")
    except OSError as e:
        raise CalibrationError(f"{e.filename or folder}: cannot be written: {e.strerror or e}") from None


def _holds(path: Path, data: bytes) -> bool:
    """Return whether a file has these contents. A pipe has the size 0 and is not opened."""
    return path.stat().st_size == len(data) and read_bytes(path, len(data), "sheet") == data
