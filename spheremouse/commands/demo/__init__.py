"""`spheremouse demo`: a simulated camera films the turning ball and the real pipeline tracks it, then truth is asked.

Only the pictures and the rig go to the pipeline; the truth is kept aside until the end.
"""

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("demo"),
    seconds: Annotated[float, typer.Option(metavar="S", min=2.0, max=600.0, help="Length of the play in s.")] = 10.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of discs, noise and play.")] = 1,
) -> None:
    """See it work without a camera: simulate, track, compare.

    A simulated camera films a ball that somebody plays with; the real pipeline finds the camera's pose and tracks the
    ball from the pictures alone. Then its figures are compared with the truth, and an overlay picture and video, a
    plot and the motion are written.
    """
    from spheremouse.commands.demo.play import play

    play(out, seconds, seed)
