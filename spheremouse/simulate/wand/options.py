"""Options of films of a wand, in the words of the command line."""

from dataclasses import dataclass
from typing import Literal

from spheremouse.settings import param

Motion = Literal["drive", "hand"]
Light = Literal["indoor", "outdoor"]

_HOUR = 3600.0  # s; to scale a hand's motion takes memory and time in proportion to its length


@dataclass(frozen=True, slots=True)
class WandOptions:
    """Options of a film. The fields are the options of `spheremouse wand simulate`."""

    motion: Motion = param("drive", "-", "drive: on a robot, as in Grzonka 2005; hand: on a stick.")
    seed: int = param(0, "-", "Of path, room, paints and noise.", ge=0)
    fps: float | None = param(None, "Hz", "Frames per second.  [default: 0.8 of a drive, 15 of a hand]", gt=0)
    seconds: float | None = param(None, "s", "Length in s.  [default: the whole drive, 20 s of a hand]", gt=0, le=_HOUR)
    begin: float = param(0.0, "s", "Time of the motion at which the film begins.", ge=0, le=_HOUR)
    speed: float | None = param(
        None, "m/s", "Largest speed; a drive turns in proportion.  [default: 0.035, 0.4 of a hand]", gt=0
    )
    rate: float | None = param(None, "deg/s", "Largest turning rate of a hand.  [default: 180]", gt=0)
    size: tuple[int, int] = param((1280, 960), "WxH", "Size of the images in px.", ge=64)
    focal: float | None = param(
        None, "px", "Focal length.  [default: 2100 of a drive, 1000 of a hand, at 1280 columns]", gt=0
    )
    dist: tuple[float, float, float, float, float] = param(
        (0.0, 0.0, 0.0, 0.0, 0.0), "k1,k2,p1,p2,k3", "Lens distortion in OpenCV's order."
    )
    distance: float | None = param(None, "m", "From the camera to a hand.  [default: 1m]", ge=0.4)
    balls: int = param(1, "-", "Balls in view, 1 to 3.", ge=1, le=3)
    light: Light = param("indoor", "-", "outdoor: sun, with glare on the ball.")
    noise: float = param(2.0, "levels", "Standard deviation of the image noise in grey values.", ge=0)
    blur: float = param(0.0, "s", "Exposure time in s: motion blur.", ge=0)
    hand: float | None = param(None, "s", "Time at which a hand passes beside the ball.")
    card: float | None = param(None, "s", "Time at which a card in the ball's colours passes before it.")
    clutter: bool = param(True, "-", "A red mug and a blue book.")
    vary: float = param(0.1, "-", "Share by which paints differ from seed to seed.", ge=0, le=0.5)
