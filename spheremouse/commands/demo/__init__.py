"""`spheremouse demo`: simulate a camera, track the ball in its pictures, and compare with the truth."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spheremouse.errors import ConfigurationError

if TYPE_CHECKING:
    from spheremouse import Sample


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("demo"),
    seconds: Annotated[float, typer.Option(metavar="S", min=2.0, max=600.0, help="Length of the play in s.")] = 10.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Another seed gives other discs, noise and play.")] = 1,
    game: Annotated[
        bool,
        typer.Option("--play", help="Play a game with the ball of the running service, or else with a simulated one."),
    ] = False,
) -> None:
    """See it work without a camera: simulate, track, compare.

    A simulated camera films a ball in play. The tracker gets the pictures and the rig alone. At the end the command
    compares its estimates with the truth. It writes a video, a plot and the motion, and says what each file
    shows.
    """
    if game:
        _play_game(seconds, seed)
    else:
        from spheremouse.commands.demo.play import play

        play(out, seconds, seed)


def _play_game(seconds: float, seed: int) -> None:
    """Play the game, which needs the package pygame and a screen."""
    import os

    os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"
    try:
        from pygame import error
    except ModuleNotFoundError:
        raise ConfigurationError("--play: needs the package pygame", "pip install pygame") from None
    from spheremouse.commands.demo.boulder import play

    try:
        hits = play(_samples(seconds, seed), seed)
    except error as e:
        raise ConfigurationError(f"--play: no window can be opened ({e})", "run it in a desktop session") from None
    print(f"{hits} hut{'' if hits == 1 else 's'} hit")


def _samples(seconds: float, seed: int) -> "Iterator[Sample]":
    """Yield the samples of the running service, else those of a simulated camera for some `seconds`."""
    import spheremouse as sm
    from spheremouse.session.control.client import NoDaemonError

    samples = sm.connect()
    try:
        yield next(samples)
    except NoDaemonError:
        film = f"synthetic:motion=play,seconds={seconds:g},seed={seed},noise=4"
        with sm.open_source(film, realtime=True) as source:
            yield from sm.track(source)
    else:
        yield from samples
