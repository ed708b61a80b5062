"""The whole configuration file: the tracker's parameters, and what the daemon needs besides."""

from dataclasses import dataclass, field
from typing import Literal

from spheremouse.ball.settings import Settings
from spheremouse.capture.settings import CameraSettings
from spheremouse.output.counts import MotionSettings
from spheremouse.output.pointer import PointerSettings
from spheremouse.session.settings.control import ControlSettings, MetricsSettings
from spheremouse.session.settings.record import RecordSettings
from spheremouse.session.settings.wand import WandRunSettings
from spheremouse.settings import param


@dataclass(frozen=True, slots=True)
class Configuration(Settings):
    """All parameters. Options of the command line, where there are some for the same, come before these."""

    motion: MotionSettings = field(default_factory=MotionSettings)

    tracker: Literal["so3", "ekf1", "ekf2", "wand"] = param(  # pyright: ignore[reportIncompatibleVariableOverride]
        "so3", "-", "filter; `ekf1` and `ekf2` are the published ones, `wand` tracks balls in a hand"
    )
    source: str | None = param(
        None, "-", "where frames come from, as --source: v4l2:/dev/v4l/by-id/... or opencv:INDEX for live cameras"
    )
    output: str | None = param(
        None,
        "-",
        "where motion goes, as --output: auto, uinput, serial:auto, desktop, text:FILE; null: nowhere",
        null="null",
    )
    rig: str | None = param(None, "-", "rig file, the device as calibrated; relative to this file's folder")
    camera_file: str | None = param(None, "-", "camera file in place of the rig's interior orientation; likewise")
    map: str | None = param(None, "-", "map of the discs; null keeps it beside the rig file where that may be written")
    realtime: Literal["auto", "off"] = param(
        "auto",
        "-",
        "`auto` comes before other programs, its memory locked, where the system grants it; `off` asks for neither. "
        "Read at the start only",
    )
    camera: CameraSettings = field(default_factory=CameraSettings)
    pointer: PointerSettings = field(default_factory=PointerSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
    record: RecordSettings = field(default_factory=RecordSettings)
    metrics: MetricsSettings = field(default_factory=MetricsSettings)
    wand: WandRunSettings = field(default_factory=WandRunSettings)
