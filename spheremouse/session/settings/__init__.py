"""The whole configuration file: the settings of the tracker and those of a run."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

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
    """All settings. An option of the command line comes before the setting of the same meaning."""

    # the settings of daily use, which `config init` writes; the others are for experts
    COMMON: ClassVar[tuple[str, ...]] = (
        *("tracker", "source", "output", "rig", "camera_file", "map", "realtime"),
        *(f"motion.{k}" for k in ("player", "counts_per_mm", "scale_x", "scale_y", "scale_z")),
        *("motion.invert_x", "motion.invert_y", "motion.invert_z"),
        *(f"camera.{k}" for k in ("size", "fps", "exposure_s", "gain", "focus", "white_balance", "mains_hz")),
        *("pointer.rate", "pointer.smooth", "control.group"),
        *("record.folder", "record.seconds", "record.megabytes", "wand.balls", "wand.points"),
    )

    motion: MotionSettings = field(default_factory=MotionSettings)

    tracker: Literal["so3", "ekf1", "ekf2", "wand"] = param(  # pyright: ignore[reportIncompatibleVariableOverride]
        "so3",
        "-",
        "tracker: so3 for a ball in its frame, wand for a ball in a hand; ekf1 and ekf2 are the published filters",
    )
    source: str | None = param(
        None,
        "-",
        "source of the frames, as --source: v4l2:/dev/v4l/by-id/..., opencv:INDEX, dataset:FOLDER or video:FILE",
    )
    output: str | None = param(
        None,
        "-",
        "destination of the motion, as --output: auto, uinput, serial:auto, desktop or text:FILE; null discards it",
        null="null",
    )
    rig: str | None = param(None, "-", "rig file of the calibrated device, relative to this file's folder")
    camera_file: str | None = param(
        None, "-", "camera file that replaces the rig's interior orientation, relative to this file's folder"
    )
    map: str | None = param(
        None, "-", "file for the map of the discs; null keeps it beside the rig file, if that folder is writable"
    )
    realtime: Literal["auto", "off"] = param(
        "auto",
        "-",
        "auto requests a real-time scheduling class and locked memory, which keep the pointer smooth under load; off "
        "requests neither. Read at the start only",
    )
    camera: CameraSettings = field(default_factory=CameraSettings)
    pointer: PointerSettings = field(default_factory=PointerSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
    record: RecordSettings = field(default_factory=RecordSettings)
    metrics: MetricsSettings = field(default_factory=MetricsSettings)
    wand: WandRunSettings = field(default_factory=WandRunSettings)
