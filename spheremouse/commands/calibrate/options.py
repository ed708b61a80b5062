"""Options that the commands of a calibration share."""

from pathlib import Path
from typing import Annotated

import typer

Force = Annotated[bool, typer.Option("--force", help="Replace files that are there.")]
Report = Annotated[
    Path | None, typer.Option("--report", metavar="FILE.html", help="Report with pictures.  [default: beside --out]")
]

# ---- the board; by default as in its board.yaml, or as printed ----

Corners = Annotated[
    str | None,
    typer.Option(
        "--board",
        metavar="CxR",
        help="Inner corners along and down: one less than squares.  [default: from board.yaml]",
    ),
]
Square = Annotated[
    str | None,
    typer.Option(
        metavar="LENGTH", help="Side of a square, measured on the print, as in 86mm.  [default: from board.yaml]"
    ),
]
Marker = Annotated[
    str | None, typer.Option(metavar="LENGTH", help="Side of a marker, as in 60mm: it is a ChArUco board.")
]
Dictionary = Annotated[str | None, typer.Option(metavar="NAME", help="ChArUco markers, as printed on the board.")]
