"""`spheremouse demo`: simulate a camera, track the ball in its pictures, and compare with the truth."""

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("demo"),
    seconds: Annotated[float, typer.Option(metavar="S", min=2.0, max=600.0, help="Length of the play in s.")] = 10.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Another seed gives other discs, noise and play.")] = 1,
    game: Annotated[
        bool, typer.Option("--play", help="Play a game with the simulated ball, and write nothing. It needs pygame.")
    ] = False,
) -> None:
    """See it work without a camera: simulate, track, compare.

    A simulated camera films a ball in play. The tracker gets the pictures and the rig alone. At the end the command
    compares its estimates with the truth. It writes a video, a plot and the motion, and says what each file
    shows.
    """
    if game:
        return _play_game(seconds, seed)
    from spheremouse.commands.demo.play import play

    play(out, seconds, seed)


def _play_game(seconds: float, seed: int) -> None:
    import os

    import spheremouse as sm
    from spheremouse.errors import ConfigurationError

    os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"  # a banner on standard output
    try:
        from spheremouse.commands.demo.boulder import play
    except ImportError:
        raise ConfigurationError("--play: needs the package pygame", "pip install pygame") from None
    film = f"synthetic:motion=play,seconds={seconds:g},noise=4,seed={seed}"
    with sm.open_source(film, realtime=True) as source:
        print(f"huts hit: {play(sm.track(source))}")
