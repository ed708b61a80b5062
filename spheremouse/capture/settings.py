"""Settings of a live camera: size, rate, format, and controls. Automatic values of these controls spoil a measurement.

None leaves a setting as the camera has it. Closing the camera restores the old values.
"""

from dataclasses import dataclass
from typing import Literal

from spheremouse.geometry.camera import MAX_SIDE, too_large
from spheremouse.settings import STEPS, param

PixelName = Literal["MJPG", "YUYV", "NV12", "GREY"]


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """Settings of the camera during a run. null leaves a setting as the camera has it."""

    size: tuple[int, int] | None = param(
        None,
        "px",
        "width and height, as 640x480 or [640, 480]; take the size of the calibration",
        ge=16,
        le=MAX_SIDE,
        pair="x",
    )
    fps: float | None = param(
        None,
        "Hz",
        "frames per second; a higher rate is smoother and follows a faster ball",
        ge=0.1,  # one in ten seconds shows no motion
        le=1000,  # a frame cannot be tracked in less than a millisecond
    )
    format: Literal["auto", PixelName] = param(
        "auto", "-", "pixel format of the camera; auto prefers an uncompressed one if the rate allows"
    )
    exposure_s: float | None = param(
        None,
        "s",
        "exposure time, which switches automatic exposure off; short enough for a sharp turning disc, and under mains "
        "light a multiple of the half period (0.01 s at 50 Hz)",
        ge=1e-6,  # less than any shutter has
        le=1,
    )
    gain: int | None = param(
        None,
        "-",
        "gain in the camera's steps, which switches automatic gain off; as small as the light allows",
        **STEPS,
    )
    focus: int | None = param(
        None,
        "-",
        "focus in the camera's steps, which switches autofocus off; autofocus would change the calibration",
        **STEPS,
    )
    zoom: int | None = param(
        None,
        "-",
        "zoom in the camera's steps; some cameras forget it when they are unplugged, and it changes the calibration",
        **STEPS,
    )
    white_balance: int | None = param(
        None,
        "K",
        "colour temperature, which switches automatic white balance off, so that the targets keep their colours",
        ge=1,
        le=100_000,  # the bluest sky has 30 000
    )
    mains_hz: Literal[0, 50, 60] | None = param(
        None, "Hz", "mains frequency at which automatic exposure avoids flicker; 0 switches that off"
    )
    controls: tuple[str, ...] = param(
        (), "-", 'other controls as "name=value", with the names of `v4l2-ctl --list-ctrls-menus`', most=64
    )
    readout_s: float | None = param(
        None,
        "s",
        "time in which a rolling shutter reads all rows, for the stamps; null is unknown and counts as 0",
        ge=0,
        le=1,
    )
    stamp_shift_s: float = param(
        0.0, "s", "time added to every stamp, to correct a measured delay of the camera", ge=-1, le=1
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
