"""What a frame may have about a hand-held ball that its pose does not say, as data."""

from dataclasses import dataclass, field

from spheremouse.tracker import Event


@dataclass(frozen=True, slots=True)
class NotInView(Event):
    """It has not been seen yet."""

    ball: str


@dataclass(frozen=True, slots=True)
class BallLost(Event):
    """It was followed, and is seen no more."""

    ball: str


@dataclass(frozen=True, slots=True)
class BallHidden(Event):
    """It does not show for a moment: its pose is predicted."""

    ball: str


@dataclass(frozen=True, slots=True)
class SecondBall(Event):
    """Another one like it is in view, which nobody declared."""

    ball: str


@dataclass(frozen=True, slots=True)
class ColourNowhere(Event):
    """The bounds of a colour match nothing in the picture."""

    colour: str


@dataclass(frozen=True, slots=True)
class ColourEverywhere(Event):
    """They match more than any ball shows."""

    colour: str
    share: float = field(compare=False)  # of the picture
