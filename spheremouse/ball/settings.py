"""When the ball is lost, and all settings of tracking as one nested dataclass."""

from dataclasses import dataclass, field
from typing import Literal

from spheremouse.ball.centre_offset import BearingSettings
from spheremouse.ball.detect.blobs import BlobSettings
from spheremouse.ball.detect.discs import DiscSettings
from spheremouse.ball.detect.rings import RingSettings
from spheremouse.ball.filters.euler import EulerSettings
from spheremouse.ball.filters.so3_settings import So3Settings
from spheremouse.ball.pose import PoseSettings
from spheremouse.settings import HAND_TURN, SECONDS, param


@dataclass(frozen=True, slots=True)
class LossSettings:
    """When the ball is lost, and how it is found again."""

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
