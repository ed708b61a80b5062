"""Settings of tracking, as one nested dataclass."""

from dataclasses import dataclass, field
from typing import Literal

from spheremouse.ball.centre_offset import BearingSettings
from spheremouse.ball.detect.discs import DiscSettings
from spheremouse.ball.detect.rings import RingSettings
from spheremouse.ball.filters.so3_settings import So3Settings
from spheremouse.ball.pose import PoseSettings
from spheremouse.settings import AREA, HAND_TURN, SECONDS, param


@dataclass(frozen=True, slots=True)
class LossSettings:
    """Times of loss and recovery."""

    lost_after: float = param(
        0.3, "s", "unconfirmed for so long the prediction is a guess: hand passes are shorter, rolls change", **SECONDS
    )
    reset_after: float = param(
        1.0, "s", "discs in view, yet not recognised for so long: a new map is begun at the last attitude", **SECONDS
    )
    fastest: float = param(
        20.0,
        "rad/s",
        "no hand turns the ball faster (1150 °/s): what says so is a wrong pairing, or a bumped camera",
        **HAND_TURN,
    )


@dataclass(frozen=True, slots=True)
class BlobSettings:
    """The published detector's bounds on a blob, which depend on camera and ball."""

    masks: int = param(10, "-", "number of masks, M: grey 0 to 120; each takes its time", ge=1, le=25)
    min_area: float = param(40.0, "px²", "least area of a contour, F_min", **AREA)
    max_area: float = param(300.0, "px²", "largest area of a contour, F_max", **AREA)
    # As published (table 4); no settings.
    mask_step: int = 10  # u_M, grey values between masks
    mask_width: int = 30  # u_B, grey values
    convexity: float = 0.95  # q_min, least area over area of the convex hull

    def __post_init__(self) -> None:
        if self.min_area > self.max_area:
            raise ValueError(f"min_area: {self.min_area:g} is above max_area, {self.max_area:g}: no blob has both")


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
    gate: float = param(
        0.03,
        "m",
        "a point farther than this from where a stored disc is predicted is another disc; Wittich 2017, table 4",
        ge=1e-6,
        le=100,  # farther than any ball reaches
    )
    radial_sigma: float = param(
        1e-4,
        "m",
        "added to each point along the ball's normal, where its covariance is singular if the ball is taken as exact; "
        "below the image noise on the ball (0.3 mm), above the sagitta of a prediction error of 0.01 rad (0.03 mm)",
        ge=1e-7,  # less is lost in the digits of a point 1 m away
        le=1,
    )
    # Not a setting: rad, rad/s, of the Euler angles and of their rates at the start (Wittich 2017, eq. 123).
    start_sigma: float = 0.01


@dataclass(frozen=True, slots=True)
class Settings:
    """All parameters of initialisation and use."""

    detector: Literal["default", "blobs"] = param("default", "-", "disc detector; `blobs` is the published one")
    tracker: Literal["so3", "ekf1", "ekf2"] = param("so3", "-", "filter; `ekf1` and `ekf2` are the published ones")
    rings: RingSettings = field(default_factory=RingSettings)
    pose: PoseSettings = field(default_factory=PoseSettings)
    discs: DiscSettings = field(default_factory=DiscSettings)
    blobs: BlobSettings = field(default_factory=BlobSettings)
    so3: So3Settings = field(default_factory=So3Settings)
    euler: EulerSettings = field(default_factory=EulerSettings)
    loss: LossSettings = field(default_factory=LossSettings)
    bearing: BearingSettings = field(default_factory=BearingSettings)
