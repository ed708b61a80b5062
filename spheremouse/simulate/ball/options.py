"""Options of films and photos of the ball, in the words of the command line."""

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Literal

from spheremouse.errors import ConfigurationError
from spheremouse.settings import param

View = Literal["far", "near"]
PatternName = Literal["patches", "marble", "speckle", "stripes", "dirt", "none"]
Motion = Literal["thesis", "roll", "play", "still", "rest", "creep", "flick", "axes"]
Triple = tuple[float, float, float]
Named = Callable[[str], str]  # returns the name of a field in its source, for messages

_MAX_PHOTOS = 99  # photos of a kind
_MAX_FPS = 1000.0  # Hz
_MAX_SIDE = 8192  # px
_RULES = {"gt": (operator.gt, "above"), "ge": (operator.ge, "at least"), "le": (operator.le, "at most")}


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """Options of a film. The fields are the options of `spheremouse simulate`."""

    pattern: PatternName | None = param(
        None, "-", "What is painted on the ball; none: a plain ball.  [default: discs alone]"
    )
    discs: int | None = param(None, "-", "Discs on the ball.  [default: 26, with --pattern 0]", ge=0)
    radius: float = param(
        0.6, "m", "Of the ball, in m or as in 5mm. The device scales with it, also mm below.", ge=1e-4, le=100
    )
    view: View = param("far", "-", "Camera 3.9 or 2.25 radii from the ball's centre.")
    motion: Motion = param(
        "thesis",
        "-",
        "What the ball does; roll goes through phi = 90 degrees. rest, creep and flick first show the ball from all "
        "sides for 8 s: then it lies still, or turns by 0.05 deg/s for a minute, or is flicked at 400 deg/s, stopped "
        "within 50 ms and flicked back. axes: the gestures of `spheremouse axes`.",
    )
    turns: float = param(20.0, "-", "Turns of --motion roll.", gt=0)
    seconds: float | None = param(None, "s", "Length in s.  [default: as long as the motion takes]", gt=0)
    fps: float = param(30.0, "Hz", "Frames per second.", gt=0, le=_MAX_FPS)
    noise: float = param(0.0, "levels", "Standard deviation of the image noise in grey values.", ge=0)
    brightness: float = param(0.0, "levels", "Grey values added to every pixel; may be negative.")
    blur: float = param(0.0, "s", "Exposure time in s: motion blur.", ge=0)
    readout: float = param(0.0, "s", "Time a rolling shutter takes over all rows in s.", ge=0)
    seed: int = param(0, "-", "Of discs, pattern, noise and play.", ge=0)
    layout: int | None = param(None, "-", "Seed of discs and pattern alone: another ball.  [default: as --seed]", ge=0)
    azimuth: float = param(
        0.0,
        "deg",
        "Where the camera stands, to the right about the ball's vertical axis. It has targets of its own, and films "
        "with one seed show the same motion to several cameras.",
        ge=-180,
        le=180,
    )
    late: float = param(0.0, "s", "Stamp of the first frame in s; a second camera is not synchronised.", ge=0, le=1)
    size: tuple[int, int] = param((640, 480), "WxH", "Size of the images in px.", ge=16, le=_MAX_SIDE)
    dist: tuple[float, float, float, float, float] = param(
        (0.0, 0.0, 0.0, 0.0, 0.0), "k1,k2,p1,p2,k3", "Lens distortion in OpenCV's order."
    )
    ball_colour: Triple | None = param(
        None, "B,G,R", "Blue, green and red of the ball, 0 to 255 as on a screen.  [default: white]", ge=0, le=255
    )
    disc_colour: Triple | None = param(None, "B,G,R", "The same of the discs.  [default: black]", ge=0, le=255)
    hands: bool = param(False, "-", "Hands reach over the ball, first one, later two.")
    cover: float | None = param(None, "s", "Two hands cover a third of the ball from this time on.", ge=0)
    cover_seconds: float = param(1.0, "s", "For how long; half a second more to come and to go.", gt=0)
    dim: float | None = param(None, "-", "Factor on the light, in the middle fifth of the time.", ge=0)
    dim_at: float | None = param(None, "s", "Time at which --dim begins instead.", ge=0)
    dim_seconds: float = param(1.0, "s", "And how long it lasts.", gt=0)
    flicker: float = param(0.0, "-", "Share of the light that comes and goes with the mains, 0 to 1.", ge=0, le=1)
    mains: float = param(50.0, "Hz", "Frequency of the mains; light flickers at twice that.", gt=0)
    limited: bool = param(False, "-", "Grey values from 16 to 235 in place of 0 to 255.")
    bump: float | None = param(None, "s", "Time at which the camera is pushed; it stays so.", ge=0)
    bump_by: tuple[float, float, float, float, float, float] = param(
        (2.0, 1.0, -2.0, 0.1, -0.2, 0.1),
        "X,Y,Z,RX,RY,RZ",
        "By how much: mm and degrees along and about the camera's axes.",
    )
    lift: float | None = param(None, "s", "Time at which the ball is lifted off its bearings.", ge=0)
    lift_by: Triple = param((0.0, 30.0, 0.0), "X,Y,Z", "By how much, in mm, Y up.")
    lift_seconds: float = param(1.0, "s", "For how long.", gt=0)
    sway: float = param(0.0, "mm", "How far the ball moves to and fro in its bearings, along X at 2 Hz.", ge=0)
    eccentric: float = param(0.0, "mm", "From the point the ball turns about to its centre.", ge=0)
    disc_off: float | None = param(None, "s", "Time at which a disc in view falls off.", ge=0)
    disc_moved: float | None = param(None, "s", "Time at which a disc in view is put 0.2 radii beside its place.", ge=0)

    @property
    def disc_count(self) -> int:
        """Number of discs on the ball at the start."""
        if self.discs is not None:
            return self.discs
        return 26 if self.pattern is None else 0


@dataclass(frozen=True, slots=True)
class StillsOptions:
    """Options of photos and camera. The fields are the options of `spheremouse calibrate practice`."""

    photos: int = param(6, "-", "Photos of the device.", ge=0, le=_MAX_PHOTOS)
    boards: int = param(15, "-", "Photos of the chessboard, 11x8 corners, 86 mm.", ge=0, le=_MAX_PHOTOS)
    size: tuple[int, int] = param((1920, 1080), "WxH", "Size of the photos in px.", ge=64)
    focal: float | None = param(None, "px", "Focal length in px.  [default: 1404 at 1920x1080]")
    dist: tuple[float, float, float, float, float] = param(
        (-0.49, 0.3, -0.0001, -0.0001, -0.11), "k1,k2,p1,p2,k3", "Lens distortion in OpenCV's order."
    )
    seed: int = param(0, "-", "Of places, errors of the tape and noise.", ge=0)
    noise: float = param(1.5, "levels", "Standard deviation of the noise in grey values.", ge=0, le=50)
    discs: int | None = param(None, "-", "Discs on the ball.  [default: 50, or as --like]", ge=1)


def check_bounds(options: Any, named: Named) -> None:
    """Raise ConfigurationError unless all numbers that are set are finite and within the bounds of their fields."""
    for field in fields(options):
        value, bounds = getattr(options, field.name), field.metadata["bounds"]
        for number in value if isinstance(value, tuple) else (value,):
            if not isinstance(number, int | float) or isinstance(number, bool):
                continue
            rule = next((f"{_RULES[k][1]} {v:g}" for k, v in bounds.items() if not _RULES[k][0](number, v)), "")
            if rule or not math.isfinite(number):
                raise ConfigurationError(f"{named(field.name)}: {number:g} must be {rule or 'a finite number'}")
