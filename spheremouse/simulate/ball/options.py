"""Options of films and photos of the ball, in the words of the command line."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal

from spheremouse.errors import ConfigurationError
from spheremouse.settings import param

View = Literal["far", "near"]
Motion = Literal["thesis", "roll", "play", "still", "rest", "creep", "flick", "axes"]
Triple = tuple[float, float, float]
Named = Callable[[str], str]  # returns the name of a field in its source, for messages

_MOST = 99  # photos of a kind


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """Options of a film. The fields are the options of `spheremouse simulate`."""

    discs: int = param(26, "-", "Discs on the ball.")
    view: View = param("far", "-", "Camera 2.35 m or 1.35 m from the ball's centre.")
    motion: Motion = param(
        "thesis",
        "-",
        "What the ball does; roll goes through phi = 90 degrees. rest, creep and flick first show the ball from all "
        "sides for 8 s: then it lies still, or turns by 0.05 deg/s for a minute, or is flicked at 400 deg/s, stopped "
        "within 50 ms and flicked back. axes: the gestures of `spheremouse axes`.",
    )
    turns: float = param(20.0, "-", "Turns of --motion roll.")
    seconds: float | None = param(None, "s", "Length in s.  [default: as long as the motion takes]")
    fps: float = param(30.0, "Hz", "Frames per second.")
    noise: float = param(0.0, "levels", "Standard deviation of the image noise in grey values.")
    brightness: float = param(0.0, "levels", "Grey values added to every pixel; may be negative.")
    blur: float = param(0.0, "s", "Exposure time in s: motion blur.")
    readout: float = param(0.0, "s", "Time a rolling shutter takes over all rows in s.")
    seed: int = param(0, "-", "Of discs, noise and play.")
    layout: int | None = param(None, "-", "Seed of the places of the discs alone: another ball.  [default: as --seed]")
    size: tuple[int, int] = param((640, 480), "WxH", "Size of the images in px.", ge=16)
    dist: tuple[float, float, float, float, float] = param(
        (0.0, 0.0, 0.0, 0.0, 0.0), "k1,k2,p1,p2,k3", "Lens distortion in OpenCV's order."
    )
    ball_colour: Triple | None = param(
        None, "B,G,R", "Blue, green and red of the ball, 0 to 255 as on a screen.  [default: white]"
    )
    disc_colour: Triple | None = param(None, "B,G,R", "The same of the discs.  [default: black]")
    hands: bool = param(False, "-", "Hands reach over the ball, first one, later two.")
    cover: float | None = param(None, "s", "Two hands cover a third of the ball from this time on.")
    cover_seconds: float = param(1.0, "s", "For how long; half a second more to come and to go.")
    dim: float | None = param(None, "-", "Factor on the light, in the middle fifth of the time.")
    dim_at: float | None = param(None, "s", "Time at which --dim begins instead.")
    dim_seconds: float = param(1.0, "s", "And how long it lasts.")
    flicker: float = param(0.0, "-", "Share of the light that comes and goes with the mains, 0 to 1.")
    mains: float = param(50.0, "Hz", "Frequency of the mains; light flickers at twice that.")
    limited: bool = param(False, "-", "Grey values from 16 to 235 in place of 0 to 255.")
    bump: float | None = param(None, "s", "Time at which the camera is pushed; it stays so.")
    bump_by: tuple[float, float, float, float, float, float] = param(
        (2.0, 1.0, -2.0, 0.1, -0.2, 0.1),
        "X,Y,Z,RX,RY,RZ",
        "By how much: mm and degrees along and about the camera's axes.",
    )
    lift: float | None = param(None, "s", "Time at which the ball is lifted off its bearings.")
    lift_by: Triple = param((0.0, 30.0, 0.0), "X,Y,Z", "By how much, in mm, Y up.")
    lift_seconds: float = param(1.0, "s", "For how long.")
    eccentric: float = param(0.0, "mm", "From the point the ball turns about to its centre.")
    disc_off: float | None = param(None, "s", "Time at which a disc in view falls off.")
    disc_moved: float | None = param(None, "s", "Time at which a disc in view is put 12 cm beside its place.")


@dataclass(frozen=True, slots=True)
class StillsOptions:
    """Options of photos and camera. The fields are the options of `spheremouse calibrate practice`."""

    photos: int = param(6, "-", "Photos of the device.", ge=0, le=_MOST)
    boards: int = param(15, "-", "Photos of the chessboard, 11x8 corners, 86 mm.", ge=0, le=_MOST)
    size: tuple[int, int] = param((1920, 1080), "WxH", "Size of the photos in px.", ge=64)
    focal: float | None = param(None, "px", "Focal length in px.  [default: 1404 at 1920x1080]")
    dist: tuple[float, float, float, float, float] = param(
        (-0.49, 0.3, -0.0001, -0.0001, -0.11), "k1,k2,p1,p2,k3", "Lens distortion in OpenCV's order."
    )
    seed: int = param(0, "-", "Of places, errors of the tape and noise.", ge=0)
    noise: float = param(1.5, "levels", "Standard deviation of the noise in grey values.", ge=0, le=50)
    discs: int | None = param(None, "-", "Discs on the ball.  [default: 50, or as --like]", ge=1)


def option_name(field: str) -> str:
    """Return the command-line option of a field."""
    return "--" + field.replace("_", "-")


def check_signs(options: Any, above: Iterable[str], from_zero: Iterable[str], named: Named) -> None:
    """Raise ConfigurationError unless fields that are set are finite, and above 0 or at least 0."""
    for names, what in ((above, "above 0"), (from_zero, "0 or more")):
        for name in names:
            value = getattr(options, name)
            if value is None or (math.isfinite(value) and (value > 0 or (value == 0 and names is from_zero))):
                continue
            finite = "" if value <= 0 else f"{',' if names is from_zero else ''} and finite"
            raise ConfigurationError(f"{named(name)}: {value:g} must be {what}{finite}")
