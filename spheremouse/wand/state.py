"""State of the wand's tracker, and the poses that it returns."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Estimate, Event, Frame, Status
from spheremouse.wand.ball import WandBall
from spheremouse.wand.model import Model
from spheremouse.wand.particles import Particles
from spheremouse.wand.pose_velocity import PoseVelocityState
from spheremouse.wand.rims import IN_FOCUS
from spheremouse.wand.settings import ColourSettings, WandSettings

PRIOR_MOTION_PROBABILITY = np.array([0.45, 0.45, 0.1])  # rest, constant velocity, sudden start
EXPOSURES = np.array([0.0, 0.002, 0.004, 0.008, 0.012, 0.016, 0.024])  # s, of a picture: candidates
# log-likelihood of each without evidence: the shortest one that explains the rims
EXPOSURE_PRIOR = -np.arange(float(len(EXPOSURES)))
# px, standard deviation of a lens's blur: that in focus, and others with which a ball is searched in turn
LENS_BLURS = np.array([IN_FOCUS, 0.9, 1.4])


@dataclass(frozen=True, slots=True)
class WandTracker:
    """Constant inputs of the tracker: settings, camera, balls, and the filter that follows one ball."""

    settings: WandSettings
    camera: InteriorOrientation
    balls: tuple[WandBall, ...]
    models: tuple[Model, ...]  # of each ball
    discs: tuple[Array, ...]  # (m, 4) of each ball: direction, angular radius
    colours: dict[str, ColourSettings]
    names: tuple[str, ...]  # of the colours in use
    follow: Callable[..., tuple["Track", "WandPose"]]  # (track, stamp, context, search_due, rng), as `track.follow`
    points: int = 0  # index of the ball of which `step` returns the estimate


@dataclass(frozen=True, slots=True)
class WandPose:
    """Pose of a ball in one frame."""

    name: str
    position: Array | None  # (3,) m, cam; None if unknown
    rotation: Array | None  # (3, 3) R_cam_ball
    covariance: Array | None  # (6, 6) m, rad: position + d, exp(theta) @ rotation, cam axes
    phase: Status
    event: Event | None  # a problem to report to the user; None without one
    match: float = 0.0  # fraction of the coloured points that show their colour
    effective: float = 0.0  # effective number of particles before resampling
    seen: bool = False  # measured in this frame, not only predicted

    @classmethod
    def unknown(cls, name: str, phase: Status, event: Event | None, match: float = 0.0) -> "WandPose":
        """Return the result of a frame in which nothing determines the pose."""
        return cls(name, position=None, rotation=None, covariance=None, phase=phase, event=event, match=match)


@dataclass(frozen=True, slots=True)
class MeasuredPose:
    """Pose of a ball in the last frame that measured it."""

    stamp: float  # s
    position: Array  # (3,) m, cam
    rotation: Array  # (3, 3) R_cam_ball
    covariance: Array  # (6, 6) m, rad


@dataclass(frozen=True, slots=True)
class Track:
    """State of one ball."""

    phase: Status = Status.SEARCHING
    particles: Particles | None = None
    pose: tuple[Array, Array, Array] | None = None  # (3,) m in cam, R_cam_ball (3, 3), covariance (6, 6) m, rad
    pose_velocity: PoseVelocityState | None = None  # of the followed peak; None unless tracked
    motion_probability: Array = field(default_factory=PRIOR_MOTION_PROBABILITY.copy)  # (3,)
    measurement_covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))  # (6, 6) m, rad: last frame's peak
    stamp: float = 0.0  # s, of the particles
    seen: float = -np.inf  # s, last measurement
    unseen_frames: int = 0
    support: float = 0.0  # of the best peak in the last measured frame, `Modes.support`
    exposure_log_likelihood: Array = field(default_factory=EXPOSURE_PRIOR.copy)  # (n,) of each of `EXPOSURES`
    lens_blur: Array = field(default_factory=lambda: LENS_BLURS[0])  # (c,) or () px, `Fields.with_lens_blur`
    next_spot: int = 0  # spot with which the next search begins, if one frame has too many spots for one search
    measured: MeasuredPose | None = None  # None: the ball was never seen, or it is lost
    second: tuple[int, Array] | None = None  # frames in a row with an undeclared ball like it, and its position, (3,) m

    @property
    def exposure_motion(self) -> Array:
        """Motion during the likeliest exposure, (6,) m, rad in cam axes; zero if unknown."""
        return self.velocity * EXPOSURES[int(np.argmax(self.exposure_log_likelihood))]

    @property
    def velocity(self) -> Array:
        """(6,) m/s, rad/s in cam axes; zero if unknown."""
        return np.zeros(6) if self.pose_velocity is None else self.pose_velocity.velocity


@dataclass(frozen=True, slots=True)
class WandState:
    """State of the tracker between two frames."""

    tracks: tuple[Track, ...]
    poses: tuple[WandPose, ...] = ()  # of each ball in the last frame
    estimates: tuple[Estimate, ...] = ()  # of each ball in the last frame
    frames: int = 0  # since the tracker began
    last_search: float = -np.inf  # s, last search of the whole picture
    frames_since_search: int = 0
    rows: bytes = b""  # of the last picture, `sampled_rows`
    repeats: int = 0  # frames in a row that showed it again
    colour_problem: Event | None = None  # that the last search of the whole picture found
    colour_problem_age: float = 0.0  # over the age at which it is reported although all balls are tracked
    colour_problem_stamp: float = -np.inf  # s, last update of it
    seed: int = 0


@dataclass(frozen=True, slots=True)
class WandEpoch:
    """One tracked frame."""

    frame: Frame
    state: WandState
    estimate: Estimate
    seconds: float  # wall time of the step

    @property
    def poses(self) -> tuple[WandPose, ...]:
        """Poses of all balls."""
        return self.state.poses
