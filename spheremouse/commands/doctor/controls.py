"""Automatic controls of the camera: exposure, gain, focus, white balance."""

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spheremouse.finding import Finding, ok, unchecked, warning

_MANUAL, _SHUTTER_PRIORITY = 1, 2  # V4L2_CID_EXPOSURE_AUTO with an exposure that stays
_UNIT = 1e-4  # s, of V4L2_CID_EXPOSURE_ABSOLUTE
_MAINS = {0: "off", 1: "50 Hz", 2: "60 Hz", 3: "automatic"}  # V4L2_CID_POWER_LINE_FREQUENCY


@dataclass(frozen=True, slots=True)
class Controls:
    """Values of the controls; None if the camera has no such control."""

    exposure_s: float | None = None  # also while it is automatic
    automatic_exposure: bool | None = None
    automatic_gain: bool | None = None
    automatic_focus: bool | None = None
    automatic_white_balance: bool | None = None
    mains: int | None = None  # of the control


def read(node: Path) -> Controls | None:
    """Return the controls of a camera, which may be open elsewhere; None if it cannot be asked."""
    try:
        from linuxpy.video.device import ControlID, get_control

        fd = os.open(node, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except (ImportError, OSError):
        return None
    found: dict[str, int] = {}
    try:
        for name in (
            "EXPOSURE_ABSOLUTE",
            "EXPOSURE_AUTO",
            "AUTOGAIN",
            "FOCUS_AUTO",
            "AUTO_WHITE_BALANCE",
            "POWER_LINE_FREQUENCY",
        ):
            with contextlib.suppress(OSError):
                found[name] = int(get_control(fd, ControlID[name]))
    finally:
        os.close(fd)
    automatic = found.get("EXPOSURE_AUTO")
    units = found.get("EXPOSURE_ABSOLUTE")
    return Controls(
        None if not units else units * _UNIT,
        None if automatic is None else automatic not in (_MANUAL, _SHUTTER_PRIORITY),
        _flag(found.get("AUTOGAIN")),
        _flag(found.get("FOCUS_AUTO")),
        _flag(found.get("AUTO_WHITE_BALANCE")),
        found.get("POWER_LINE_FREQUENCY"),
    )


def check(controls: Controls) -> list[Finding]:
    """Return findings about exposure, focus and colours."""
    return [_exposure(controls), _focus(controls), _colours(controls)]


def _exposure(c: Controls) -> Finding:
    told = "" if c.exposure_s is None else f", now {1e3 * c.exposure_s:g} ms"
    mains = None if c.mains is None else _MAINS.get(c.mains)
    values: dict[str, Any] = {"exposure_s": c.exposure_s, "automatic": c.automatic_exposure, "mains_filter": mains}
    if c.automatic_exposure is None and c.exposure_s is None:
        return unchecked("exposure", "this camera has no control for it, so it is unknown")
    if c.automatic_exposure:
        return warning(
            "exposure",
            f"automatic{told}: in dim light it gets long, which blurs a turning ball and may halve the rate",
            "set camera.exposure_s: 0.01 in the configuration, or shorter, and more light",
            **values,
        )
    if c.automatic_gain:
        return warning(
            "exposure",
            f"fixed{told}, but the gain is automatic: brightness and noise change",
            "set camera.gain in the configuration",
            **values,
        )
    return ok("exposure", f"fixed{told}", **values)


def _focus(c: Controls) -> Finding:
    if c.automatic_focus is None:
        return ok("focus", "this camera has no control for automatic focus")
    if c.automatic_focus:
        return warning(
            "focus",
            "automatic: each time it moves, the calibration no longer holds",
            "set camera.focus in the configuration to its value at the calibration",
        )
    return ok("focus", "fixed")


def _colours(c: Controls) -> Finding:
    if c.automatic_white_balance:
        return warning(
            "white balance",
            "automatic: the targets' colours change with the rest of the picture",
            "set camera.white_balance in the configuration, for example 4500",
        )
    if c.automatic_white_balance is None:
        return ok("white balance", "this camera has no such control")
    return ok("white balance", "fixed")


def _flag(value: int | None) -> bool | None:
    return None if value is None else bool(value)
