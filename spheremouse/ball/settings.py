"""Settings of tracking, as one nested dataclass."""

from dataclasses import dataclass, field
from typing import Literal

from spheremouse.ball.detect.discs import DiscSettings
from spheremouse.ball.detect.rings import RingSettings
from spheremouse.ball.filters.so3_settings import So3Settings
from spheremouse.ball.pose import PoseSettings
from spheremouse.settings import AREA, SECONDS, param


@dataclass(frozen=True, slots=True)
class LossSettings:
    """Times of loss and recovery."""

    lost_after: float = param(
        0.3,
        "s",
        "without a confirmation for this time the ball is lost; a hand passes sooner, and a roll changes within it",
        **SECONDS,
    )
    reset_after: float = param(
        1.0,
        "s",
        "discs are in view, but not recognised for this time: the tracker begins a new map at the last attitude",
        **SECONDS,
    )
    # Not a setting: rad/s, 1150 °/s. No hand turns the ball faster; a faster rate means wrong pairs or a bumped camera.
    fastest: float = 20.0
    # Not a setting: radii. A ball whose centre is farther than this from its usual place was lifted. Worn bearings move
    # it by less.
    lifted: float = 0.025


@dataclass(frozen=True, slots=True)
class BlobSettings:
    """The published detector's bounds on a blob, which depend on camera and ball."""

    area: tuple[float, float] = param((40.0, 300.0), "px²", "bounds of a contour's area, F_min and F_max", **AREA)
    # As published (table 4); no settings.
    masks: int = 10  # M, number of masks: grey 0 to 120
    mask_step: int = 10  # u_M, grey values between masks
    mask_width: int = 30  # u_B, grey values
    convexity: float = 0.95  # q_min, least area over area of the convex hull

    def __post_init__(self) -> None:
        least, largest = self.area
        if least > largest:
            raise ValueError(f"area: give [F_min, F_max]; {least:g} is above {largest:g}")


@dataclass(frozen=True, slots=True)
class EulerSettings:
    """Parameters of the published filters."""

    acceleration_sigma: float = param(
        0.1,
        "rad/s²",
        "assumed acceleration of each Euler angle, sigma_w; best rates in Wittich 2017, section 4.5",
        ge=1e-4,  # a tenth of the thesis' least
        le=1000,  # of a flick
    )
    # As published; no settings.
    gate: float = 0.03  # m; a point farther than this from a predicted disc is another disc (Wittich 2017, table 4)
    start_sigma: float = 0.01  # rad, rad/s, of the Euler angles and of their rates at the start (eq. 123)
    # Not published: m, added to each point along the ball's normal, where its covariance is singular if the ball is
    # exact. Below the image noise on the ball (0.3 mm), above the sagitta of a prediction error of 0.01 rad (0.03 mm).
    radial_sigma: float = 1e-4


@dataclass(frozen=True, slots=True)
class Settings:
    """All parameters of initialisation and use."""

    detector: Literal["default", "blobs", "texture", "both"] = param(
        "default",
        "-",
        "what is seen of the ball: discs, discs as published (`blobs`), its pattern (`texture`), or discs and the "
        "pattern between them (`both`)",
    )
    tracker: Literal["so3", "ekf1", "ekf2"] = param("so3", "-", "filter; `ekf1` and `ekf2` are the published ones")
    rings: RingSettings = field(default_factory=RingSettings)
    pose: PoseSettings = field(default_factory=PoseSettings)
    discs: DiscSettings = field(default_factory=DiscSettings)
    blobs: BlobSettings = field(default_factory=BlobSettings)
    so3: So3Settings = field(default_factory=So3Settings)
    euler: EulerSettings = field(default_factory=EulerSettings)
    loss: LossSettings = field(default_factory=LossSettings)

    def __post_init__(self) -> None:
        if self.detector in ("texture", "both") and self.tracker != "so3":
            raise ValueError(f"detector: {self.detector} needs the tracker so3, not {self.tracker}")
