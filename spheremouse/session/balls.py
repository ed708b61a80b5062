"""Balls of wand files, and the bounds of their colours."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from spheremouse.errors import ConfigurationError
from spheremouse.files.wand import load_wand
from spheremouse.wand.ball import WandBall
from spheremouse.wand.rims import ColourSettings


@dataclass(frozen=True, slots=True)
class Balls:
    """Balls in the order they are counted, and how to see their colours."""

    balls: tuple[WandBall, ...] = ()
    colours: dict[str, ColourSettings] = field(default_factory=dict)


def read_balls(files: Iterable[Path]) -> Balls:
    """Balls of wand files. ConfigurationError where a file is wrong, or two have other bounds for a colour."""
    balls: list[WandBall] = []
    colours: dict[str, ColourSettings] = {}
    said_by: dict[str, Path] = {}
    for path in files:
        file = load_wand(path)
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
    """Balls of the same name get numbers, for messages."""
    names = [ball.name for ball in balls]
    return tuple(
        replace(ball, name=f"{ball.name} {names[: k + 1].count(ball.name)}") if names.count(ball.name) > 1 else ball
        for k, ball in enumerate(balls)
    )
