"""What a live camera is asked for: size, rate, format, and the controls that automatic cameras get wrong for measuring.

None leaves a parameter as the camera has it. What is set is put back when the camera is closed.
"""

from dataclasses import dataclass
from typing import Literal

from spheremouse.geometry.camera import MAX_SIDE, too_large
from spheremouse.settings import STEPS, param

PixelName = Literal["MJPG", "YUYV", "NV12", "GREY"]


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """Settings of the camera while it is used."""

    size: tuple[int, int] | None = param(
        None,
        "px",
        "width and height, as 640x480 or [640, 480]; the size of the calibration. null leaves it as the camera has it",
        ge=16,
        le=MAX_SIDE,
        pair="x",
    )
    fps: float | None = param(
        None,
        "Hz",
        "frames per second; more is smoother and copes with a faster ball. None: as the camera stands",
        ge=0.1,  # one in ten seconds shows no motion
        le=1000,  # a frame cannot be tracked in less than a millisecond
    )
    format: Literal["auto", PixelName] = param(
        "auto", "-", "pixels as the camera sends them; auto takes one that need not be decoded where its rate allows"
    )
    exposure_s: float | None = param(
        None,
        "s",
        "exposure, which ends automatic exposure; short enough that a turning disc stays sharp, and under mains light "
        "a whole number of its half periods (0.01 s at 50 Hz). None: as the camera stands",
        ge=1e-6,  # less than any shutter has
        le=1,
    )
    gain: int | None = param(
        None, "-", "gain in the camera's own steps, which ends automatic gain; as small as the light allows", **STEPS
    )
    focus: int | None = param(
        None, "-", "focus in the camera's own steps, which ends autofocus: that would change the calibration", **STEPS
    )
    white_balance: int | None = param(
        None,
        "K",
        "colour temperature, which ends automatic white balance: the targets keep their colours",
        ge=1,
        le=100_000,  # the bluest sky has 30 000
    )
    mains_hz: Literal[0, 50, 60] | None = param(
        None, "Hz", "mains frequency against which automatic exposure avoids flicker; 0 switches that off"
    )
    controls: tuple[str, ...] = param(
        (), "-", 'other controls as "name=value", by the names that `v4l2-ctl --list-ctrls-menus` shows', most=64
    )
    readout_s: float | None = param(
        None,
        "s",
        "time in which a rolling shutter reads the rows, for the stamp; None: unknown, taken as 0",
        ge=0,
        le=1,
    )
    stamp_shift_s: float = param(
        0.0, "s", "added to every stamp, where the camera's own delay has been measured", ge=-1, le=1
    )

    def __post_init__(self) -> None:
        if self.size is not None and (problem := too_large(*self.size)):
            raise ValueError(f"size: {problem}")
        if self.fps is not None and self.exposure_s is not None and self.exposure_s * self.fps > 1.0:
            raise ValueError(
                f"exposure_s {self.exposure_s:g} is longer than a frame at {self.fps:g} per second; shorten one of them"
            )
        for text in self.controls:
            name, equals, value = text.partition("=")
            if not (equals and name.strip() and value.strip()):
                raise ValueError(f'controls: {text!r} is not "name=value"')
