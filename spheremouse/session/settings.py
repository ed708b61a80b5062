"""The whole configuration file: the settings of the tracker and those of a run."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

from spheremouse.ball.settings import Settings
from spheremouse.capture.settings import CameraSettings
from spheremouse.files import config
from spheremouse.files.dataset.format import MAX_BALLS
from spheremouse.output.counts import MotionSettings
from spheremouse.output.pointer import PointerSettings
from spheremouse.output.wand_mapping import PointingSettings
from spheremouse.settings import param
from spheremouse.wand.settings import WandSettings


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """The control socket, by which `spheremouse ctl` reaches the daemon. Read at the start only."""

    socket: str | None = param(
        None, "-", "path of the socket, at most 107 bytes; null puts control.sock into the runtime directory"
    )
    group: str | None = param(
        None,
        "-",
        "group with access to the socket, and so to the pointer (mode 0660); null allows root and the "
        "daemon's own user (0600)",
    )
    # Not a setting: connections of each user at a time. A person, a tray and a monitor need one each.
    clients: int = 16


@dataclass(frozen=True, slots=True)
class MetricsSettings:
    """Metrics for Prometheus over HTTP. Read at the start only."""

    port: int | None = param(None, "-", "TCP port; null opens none", ge=1, le=65535)
    address: str = param(
        "127.0.0.1",
        "-",
        "IP address of the port; the default serves this machine alone. Another one serves the network without a "
        "password",
    )


@dataclass(frozen=True, slots=True)
class RecordSettings:
    """Recordings and snapshots of `spheremouse ctl`, with limits after which a recording ends."""

    folder: str | None = param(
        None,
        "-",
        "folder of recordings and snapshots, relative to this file; null is `recordings` in the state directory",
    )
    seconds: float = param(
        60.0, "s", "maximum duration of a recording; a minute is enough to show a fault", ge=0.1, le=86400
    )
    megabytes: float = param(
        1000.0,
        "MB",
        "maximum size of a recording; a minute of 640x480 at 60 Hz has 210 MB in grey, 1500 MB in colour",
        ge=20,
        le=1e8,  # 100 TB: a day of the largest pictures
    )
    everything: bool = param(
        False, "-", "keep whole images; by default all but ball and targets is black, to protect the people in view"
    )
    # Not a setting: MB that recordings and snapshots leave free on the disk for the system and the map.
    free_megabytes: float = 500.0


@dataclass(frozen=True, slots=True)
class WandRunSettings(WandSettings):
    """The hand-held ball, where `tracker` is wand."""

    balls: tuple[str, ...] = param(
        (),
        "-",
        "wand files, one for each ball, relative to this file's folder; by default the recording's ball, or Grzonka's",
        most=MAX_BALLS,
    )
    points: int = param(
        1, "-", "number of the ball that moves the pointer, in the order of `balls`", ge=1, le=MAX_BALLS
    )
    pointing: PointingSettings = field(default_factory=PointingSettings)


@dataclass(frozen=True, slots=True)
class Configuration(Settings):
    """All settings. An option of the command line overrides its setting."""

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
    source: str | tuple[str, ...] | None = param(
        None,
        "-",
        "source of the frames, as --source: v4l2:/dev/v4l/by-id/..., opencv:INDEX, dataset:FOLDER or video:FILE; a "
        "list for two cameras",
        most=2,
    )
    output: str | tuple[str, ...] | None = param(
        None,
        "-",
        "destination of the motion, as --output, or a list of them: auto, uinput, serial:auto, desktop, text:FILE and "
        "others (docs/outputs.md); null discards it",
        null="null",
        most=16,
    )

    @property
    def outputs(self) -> tuple[str, ...]:
        """Destinations of the motion, `KIND:ARGUMENT`; the first is the main one."""
        return (self.output,) if isinstance(self.output, str) else self.output or ()

    rig: str | tuple[str, ...] | None = param(
        None,
        "-",
        "rig file of the calibrated device, relative to this file's folder; one for each source",
        most=2,
    )

    @property
    def sources(self) -> tuple[str, ...]:
        """Sources of the frames, one for each camera."""
        return (self.source,) if isinstance(self.source, str) else self.source or ()

    @property
    def rigs(self) -> tuple[str, ...]:
        """Rig files, one for each camera; none for sources that bring their own."""
        return (self.rig,) if isinstance(self.rig, str) else self.rig or ()

    camera_file: str | None = param(
        None, "-", "camera file that replaces the rig's interior orientation, relative to this file's folder"
    )
    map: str | None = param(
        None, "-", "file for the map of the ball; null keeps it beside the rig file, if that folder is writable"
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
    # Not a setting: named assignments KEY=VALUE of the section `profiles`, for `spheremouse ctl profile`.
    profiles: config.Profiles = field(default_factory=dict)


def configuration_text(c: Configuration, **changes: Any) -> str:
    """Return the settings without devices, files and sockets of this computer, which a replay replaces."""
    plain = type(c)()
    c = replace(
        c,
        source=None, output=None, rig=None, camera_file=None, map=None,
        control=plain.control, record=plain.record, metrics=plain.metrics, **changes,
    )  # fmt: skip
    return config.dump(c, plain)
