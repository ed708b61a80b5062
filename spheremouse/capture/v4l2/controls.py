"""Set the controls of a V4L2 camera by name, read them back, and restore them at the end.

Names are those of v4l2-ctl: in lower case, with one underscore for other characters than letters and digits.
"""

import contextlib
import errno
import re
from collections.abc import Callable
from dataclasses import dataclass, field

from linuxpy.video.device import (
    IOC,
    ControlFlag,
    ControlID,
    ControlType,
    get_control,
    iter_read,
    iter_read_controls,
    raw,
    set_control,
)

from spheremouse.capture.settings import CameraSettings
from spheremouse.errors import SourceError
from spheremouse.files.validate import nearest

_EXPOSURE_MANUAL, _EXPOSURE_SHUTTER_PRIORITY = 1, 2  # values of V4L2_CID_EXPOSURE_AUTO with a known exposure
_EXPOSURE_UNIT = 1e-4  # s, of V4L2_CID_EXPOSURE_ABSOLUTE
_MAINS_FILTERS = {0: 0, 50: 1, 60: 2}  # V4L2_CID_POWER_LINE_FREQUENCY
_MANUAL_CONTROLS = (  # setting, the control of its automatic (0: none), its own control, unit
    ("gain", ControlID.AUTOGAIN, ControlID.GAIN, ""),
    ("focus", ControlID.FOCUS_AUTO, ControlID.FOCUS_ABSOLUTE, ""),
    ("zoom", 0, ControlID.ZOOM_ABSOLUTE, ""),
    ("white_balance", ControlID.AUTO_WHITE_BALANCE, ControlID.WHITE_BALANCE_TEMPERATURE, " K"),
)
_ON_OFF = {"on": 1, "true": 1, "yes": 1, "off": 0, "false": 0, "no": 0}
_INTEGER_TYPES = {
    ControlType.INTEGER,
    ControlType.BOOLEAN,
    ControlType.MENU,
    ControlType.INTEGER_MENU,
    ControlType.BITMASK,
}
_MAX_NAMES = 24  # in a message
_FIXED_FLAGS = ControlFlag.READ_ONLY | ControlFlag.DISABLED | ControlFlag.GRABBED


@dataclass(frozen=True, slots=True)
class Control:
    """A control with an integer value."""

    id: int
    name: str
    type: int
    minimum: int
    maximum: int
    fixed: bool  # cannot be set


@dataclass(slots=True)
class Controls:
    """Controls of an open device."""

    fd: int
    path: str
    known: dict[int, Control]
    old_values: list[tuple[Control, int]] = field(default_factory=list)  # in the order of the changes

    def apply(self, settings: CameraSettings) -> list[str]:
        """Set the controls of the settings; return the changes in words. On SourceError all are restored."""
        try:
            return self._apply(settings)
        except BaseException:
            self.restore()
            raise

    def _apply(self, settings: CameraSettings) -> list[str]:
        """As `apply`, but keep changes on an error. Controls by name come last, so they can override the others."""
        words = []
        if settings.mains_hz is not None:
            self._set_required(ControlID.POWER_LINE_FREQUENCY, _MAINS_FILTERS[settings.mains_hz], "mains_hz")
            words.append(f"mains {settings.mains_hz} Hz" if settings.mains_hz else "mains filter off")
        if settings.fps is not None or settings.exposure_s is not None:
            self._set_if_present(ControlID.EXPOSURE_AUTO_PRIORITY, 0)  # otherwise dim light lowers the rate
        if settings.exposure_s is not None:
            self._set_if_present(ControlID.EXPOSURE_AUTO, _EXPOSURE_MANUAL)
            units = max(1, round(settings.exposure_s / _EXPOSURE_UNIT))
            got = self._set_required(
                ControlID.EXPOSURE_ABSOLUTE, units, "exposure_s", lambda n: f"{n * _EXPOSURE_UNIT:g} s"
            )
            words.append(f"exposure {1e3 * got * _EXPOSURE_UNIT:g} ms")
        for name, automatic, control_id, unit in _MANUAL_CONTROLS:
            if (value := getattr(settings, name)) is not None:
                self._set_if_present(automatic, 0)
                words.append(f"{name.replace('_', ' ')} {self._set_required(control_id, value, name)}{unit}")
        for text in settings.controls:
            name, _, value = (part.strip() for part in text.partition("="))
            control = self.find(name)
            words.append(f"{name} {self._set_and_read(control, self._value(control, value), f'controls: {name}')}")
        return words

    def exposure(self) -> float | None:
        """Return the exposure (s); None if it is automatic or unknown."""
        with contextlib.suppress(OSError):
            automatic = self._read(ControlID.EXPOSURE_AUTO)
            units = self._read(ControlID.EXPOSURE_ABSOLUTE)
            if automatic in (None, _EXPOSURE_MANUAL, _EXPOSURE_SHUTTER_PRIORITY) and units:
                return units * _EXPOSURE_UNIT
        return None

    def restore(self) -> None:
        """Restore the old values in reverse order. Errors of an unplugged camera are ignored."""
        while self.old_values:
            control, value = self.old_values.pop()
            with contextlib.suppress(OSError):
                set_control(self.fd, control.id, value)

    def find(self, name: str) -> Control:
        """Return the control with a name. Raises SourceError if there is none."""
        for control in self.known.values():
            if control.name == name:
                return control
        advice = nearest(name, [c.name for c in self.known.values()], otherwise="name one of these")
        raise SourceError(f"{self.path}: no control {name}; {advice} ({self._names()})")

    def _names(self) -> str:
        names = sorted(c.name for c in self.known.values() if not c.fixed)
        more = ", ..." if len(names) > _MAX_NAMES else ""
        return f"it has {', '.join(names[:_MAX_NAMES])}{more}" if names else "it has none"

    def _read(self, control_id: int) -> int | None:
        return get_control(self.fd, control_id) if control_id in self.known else None

    def _set_if_present(self, control_id: int, value: int) -> None:
        """Set a control if it exists and has another value."""
        control = self.known.get(control_id)
        if control is not None and not control.fixed and self._read(control_id) != value:
            self._set_and_read(control, value, control.name)

    def _set_required(self, control_id: int, value: int, setting: str, shown: Callable[[int], str] = str) -> int:
        """Set the control that a `setting` needs, and return the value that the camera reports; it may differ.

        `shown` formats a value for an error. Raises SourceError if the camera has no such control, or refuses.
        """
        control = self.known.get(control_id)
        if control is None:
            raise SourceError(
                f"{self.path}: {setting}: the camera has no such control ({self._names()}); leave the setting out"
            )
        return self._set_and_read(control, value, setting, shown)

    def _set_and_read(self, control: Control, value: int, setting: str, shown: Callable[[int], str] = str) -> int:
        """Set a control and return the value that the camera reports."""
        if control.fixed:
            raise SourceError(f"{self.path}: {setting}: cannot be set on this camera; leave it out")
        if not control.minimum <= value <= control.maximum:
            raise SourceError(
                f"{self.path}: {setting}: {shown(value)} is not possible; "
                f"the camera takes {shown(control.minimum)} to {shown(control.maximum)}"
            )
        try:
            old = get_control(self.fd, control.id)
            set_control(self.fd, control.id, value)
            self.old_values.append((control, old))
            return get_control(self.fd, control.id)
        except OSError as e:
            if e.errno in (errno.ENODEV, errno.EPROTO, errno.ETIMEDOUT):  # EIO and EPIPE may be a refusal
                raise
            raise SourceError(
                f"{self.path}: {setting}: the camera does not take {shown(value)} ({e.strerror}); choose another value"
            ) from None

    def _value(self, control: Control, text: str) -> int:
        """Parse a number, on or off, or an item of the control's menu."""
        with contextlib.suppress(ValueError):
            return int(text, 0)
        if control.type == ControlType.BOOLEAN and text.lower() in _ON_OFF:
            return _ON_OFF[text.lower()]
        items = self._menu(control)
        if text.lower() in items:
            return items[text.lower()]
        takes = (
            ", ".join(f"{n} ({name})" for name, n in items.items())
            or f"a number, {control.minimum} to {control.maximum}"
        )
        raise SourceError(f"{self.path}: controls: {control.name} must be {takes}, is {text!r}")

    def _menu(self, control: Control) -> dict[str, int]:
        """Return the items of a menu in lower case, with their numbers."""
        if control.type != ControlType.MENU:
            return {}
        query = raw.v4l2_querymenu()
        query.id = control.id
        items = iter_read(
            self.fd, IOC.QUERYMENU, query, start=control.minimum, stop=control.maximum + 1, step=1, ignore_einval=True
        )
        return {_text(item.name).lower(): item.index for item in items}


def read_controls(fd: int, path: str) -> Controls:
    """Return the integer controls of an open device."""
    known = {}
    for info in iter_read_controls(fd):
        if info.type in _INTEGER_TYPES and not info.flags & ControlFlag.HAS_PAYLOAD:
            name = re.sub(r"[^a-z0-9]+", "_", _text(info.name).lower()).strip("_")
            fixed = bool(info.flags & _FIXED_FLAGS)
            known[info.id] = Control(info.id, name, info.type, info.minimum, info.maximum, fixed)
    return Controls(fd, path, known)


def _text(name: bytes) -> str:
    return name.decode(errors="replace")
