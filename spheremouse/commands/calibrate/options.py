"""Options that the commands of a calibration share."""

from pathlib import Path
from typing import Annotated

import typer

Report = Annotated[
    Path | None, typer.Option("--report", metavar="FILE.html", help="Report with pictures.  [default: beside --out]")
]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the figures; - prints them.")]
Force = Annotated[bool, typer.Option("--force", help="Replace files that are there.")]
