"""`spheremouse demo`: simulate a camera, track the ball in its pictures, and compare with the truth."""

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("demo"),
    seconds: Annotated[float, typer.Option(metavar="S", min=2.0, max=600.0, help="Length of the play in s.")] = 10.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Another seed gives other discs, noise and play.")] = 1,
) -> None:
    """See it work without a camera: simulate, track, compare.

    A simulated camera films a ball in play. The tracker gets the pictures and the rig alone. At the end the command
    compares its estimates with the truth. It writes a video, a plot and the motion, and says what each file
    shows.
    """
    from spheremouse.commands.demo.play import play

    play(out, seconds, seed)
