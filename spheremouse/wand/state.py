"""What the wand's tracking carries from frame to frame."""

from dataclasses import dataclass, field

import numpy as np

from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Event, Frame, Status
from spheremouse.wand.ball import WandBall
from spheremouse.wand.course import Course
from spheremouse.wand.model import Model
from spheremouse.wand.particles import (
    Particles,
)
from spheremouse.wand.rims import ColourSettings
from spheremouse.wand.settings import WandSettings

MIXTURE = np.array([0.45, 0.45, 0.1])  # rest, go on, free


@dataclass(frozen=True, slots=True)
class WandTracker:
    """What stays the same from frame to frame."""

    settings: WandSettings
    camera: InteriorOrientation
    balls: tuple[WandBall, ...]
    models: tuple[Model, ...]
    discs: tuple[Array, ...]  # (m, 4) of each ball: direction, angular radius
    colours: dict[str, ColourSettings]
    names: tuple[str, ...]  # of the colours in use


@dataclass(frozen=True, slots=True)
class WandPose:
    """A ball in one frame."""

    name: str
    position: Array | None  # (3,) m, cam; None where it is not known
    rotation: Array | None  # (3, 3) R_cam_ball
    covariance: Array | None  # (6, 6) m, rad: position + d, exp(theta) @ rotation, cam axes
    phase: Status
    event: Event | None  # what a user should know; None where all is well
    match: float = 0.0  # part of the coloured points that show
    effective: float = 0.0  # effective number of particles before resampling
    seen: bool = False  # in this frame, not only predicted


@dataclass(frozen=True, slots=True)
class Track:
    """One ball's state."""

    phase: Status = Status.SEARCHING
    particles: Particles | None = None
    pose: tuple[Array, Array, Array] | None = None  # position, rotation, covariance
    course: Course | None = None  # of the peak that it follows; while it is tracked
    motion: Array = field(default_factory=MIXTURE.copy)  # (3,) probabilities of the motions
    repeats: Array = field(default_factory=lambda: np.zeros((6, 6)))  # what the last picture had wrong: its covariance
    stamp: float = 0.0  # s, of the particles
    seen: float = -np.inf  # s
    unseen_frames: int = 0
    level: float = 0.0  # log-likelihood ratio that this ball's pose has had of late
    turn: int = 0  # spot with which the next search begins, where a picture has too many for one
    second: tuple[int, Array] | None = None  # pictures in a row with another ball like it, and where, (3,) m

    @property
    def velocity(self) -> Array:
        """(6,) m/s, rad/s in cam axes; zero where it is not known."""
        return np.zeros(6) if self.course is None else self.course.velocity


@dataclass(frozen=True, slots=True)
class WandState:
    """The tracker's memory."""

    tracks: tuple[Track, ...]
    looked: float = -np.inf  # s, last search of the whole picture
    waited: int = 0  # frames since
    complaint: Event | None = None  # of the last search: about colours
    worth: float = 0.0  # at 1, it is worth a word though all balls are followed
    heard: float = -np.inf  # s, of the last search
    seed: int = 0


@dataclass(frozen=True, slots=True)
class WandEpoch:
    """One tracked frame."""

    frame: Frame
    poses: tuple[WandPose, ...]
    state: WandState
    seconds: float  # wall time of the step
