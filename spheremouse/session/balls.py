"""Read the balls of wand files, and the bounds of their colours."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from spheremouse.errors import ConfigurationError
from spheremouse.files.wand import load_wand
from spheremouse.wand.ball import WandBall
from spheremouse.wand.settings import ColourSettings


@dataclass(frozen=True, slots=True)
class Balls:
    """Balls in the order of their numbers, and the bounds of their colours."""

    balls: tuple[WandBall, ...] = ()
    colours: dict[str, ColourSettings] = field(default_factory=dict)


def read_balls(files: Iterable[Path]) -> Balls:
    """Read balls from wand files.

    A file that is named twice stands for two equal balls. Raises ConfigurationError if a file is invalid, if balls of
    two files share a name, or if two files differ in a colour's bounds.
    """
    named: dict[str, Path] = {}
    balls: list[WandBall] = []
    colours: dict[str, ColourSettings] = {}
    said_by: dict[str, Path] = {}
    for path in files:
        file = load_wand(path)
        name = file.ball.name
        if name in named and not path.samefile(named[name]):  # a file that is named twice is of two equal balls
            raise ConfigurationError(f"{path}: name: {name} is also the ball of {named[name]}; give each its own name")
        named[name] = path
        balls.append(file.ball)
        for name, bounds in file.colours.items():
            if colours.setdefault(name, bounds) != bounds:
                raise ConfigurationError(
                    f"{path}: colours.{name}: other bounds than in {said_by[name]}; a colour has one set of bounds, "
                    "or another name"
                )
            said_by.setdefault(name, path)
    return Balls(tuple(balls), colours)


def told_apart(balls: tuple[WandBall, ...]) -> tuple[WandBall, ...]:
    """Number the balls of a recording that share a name, for messages."""
    names = [ball.name for ball in balls]
    return tuple(
        replace(ball, name=f"{ball.name} {names[: k + 1].count(ball.name)}") if names.count(ball.name) > 1 else ball
        for k, ball in enumerate(balls)
    )
