"""The frame rate and the stamps."""

from typing import Any

import numpy as np

from spheremouse.commands.doctor.footage import Footage
from spheremouse.finding import Finding, ok, unchecked, warning, wrong
from spheremouse.geometry.rotation import Array

_SLOW = 0.95  # of the promised rate: in two seconds the count is uncertain by one in sixty
_LOST = 0.01  # of the frames: a camera in order loses none
_UNSTEADY = 0.05  # of the interval: the measured rate of the ball has the same error
_MIN_FRAMES = 8  # frames


def rate(footage: Footage) -> Finding:
    """Report the rate, by the camera's own count."""
    n, expected = len(footage.stamps), footage.fps
    span = float(footage.stamps[-1] - footage.stamps[0])
    if n < _MIN_FRAMES:
        text = f"no more than {n} frame{'' if n == 1 else 's'} in {span:.1f} s"
        if not footage.live:
            return unchecked("rate", f"{text}: the recording is short, or slow", frames=n)
        return wrong("rate", text, "see cable, hub and power, and a fixed, shorter exposure", frames=n)
    produced = max(int(footage.sequence[-1] - footage.sequence[0]), n - 1)
    if span <= 0.0:
        return unchecked("rate", "the stamps do not increase", frames=n)
    got, lost = produced / span, produced - (n - 1)
    promised = "" if expected is None else f" of {expected:g} promised"
    values: dict[str, Any] = {"fps": round(got, 2), "promised_fps": expected, "frames": n, "lost": lost}
    values["damaged"] = footage.damaged
    text = f"{got:.1f} frames/s{promised}, {n} seen in {span:.1f} s"
    if footage.damaged:
        return warning(
            "rate",
            f"{text}; {footage.damaged} damaged",
            "a shorter cable, another port, or a format not MJPG",
            **values,
        )
    if expected is not None and got < _SLOW * expected:
        advice = "fix the exposure (camera.exposure_s): dim light makes cameras slower" if footage.live else ""
        return warning("rate", text, advice or "the recording has gaps: play it with its stamps", **values)
    if lost > _LOST * produced:
        return warning(
            "rate", f"{text}; {lost} lost on the way", "a lower rate or size, or fewer programs at work", **values
        )
    return ok("rate", text, **values)


def stamps(footage: Footage) -> Finding:
    """Check that stamps increase, are steady and belong to this clock."""
    steps = np.diff(footage.stamps)
    if len(steps) < _MIN_FRAMES - 1:
        return unchecked("stamps", "too few frames")
    bad = int(np.count_nonzero(steps <= 0.0))
    if bad:
        return wrong(
            "stamps", f"{bad} of {len(steps)} do not increase", "another driver or source; the tracker needs times"
        )
    interval, jitter = steadiness(footage.stamps, footage.sequence)
    values: dict[str, Any] = {"interval_ms": round(1e3 * interval, 3), "jitter_ms": round(1e3 * jitter, 3)}
    text = f"steady to {1e3 * jitter:.2f} ms ({100 * jitter / interval:.1f} % of the interval)"
    if footage.live and footage.stamped:
        age = footage.arrivals - footage.stamps
        values["age_ms"] = round(1e3 * float(np.median(age)), 2)
        text += f", {values['age_ms']:.1f} ms old when they come"
    notes = "; ".join(footage.notes)
    if notes:
        return warning(
            "stamps", f"{text}; {notes}", "the tracker corrects that; camera.stamp_shift_s sets the rest", **values
        )
    if jitter > _UNSTEADY * interval:
        advice = "take v4l2: in place of opencv:, which has the camera's own stamps" if not footage.stamped else ""
        advice = advice or "a port of its own for the camera, and fewer programs at work"
        return warning("stamps", text, advice if footage.live else "rates vary as much; film again", **values)
    return ok("stamps", text, **values)


def steadiness(stamps: Array, sequence: Array) -> tuple[float, float]:
    """Return interval and standard deviation of stamps, (n,) s, about a straight line through their numbers, (n,).

    If frames were not counted, the steps are rounded to whole intervals.
    """
    number = sequence - sequence[0]
    interval = float(np.median(np.diff(stamps) / np.maximum(np.diff(number), 1)))
    if interval <= 0.0:
        return 0.0, float("inf")
    steps = np.maximum(np.rint(np.diff(stamps) / interval), 1.0)
    number = np.concatenate([[0.0], np.cumsum(steps)])
    slope, start = np.polyfit(number, stamps - stamps[0], 1)
    rest = stamps - stamps[0] - (slope * number + start)
    return float(slope), float(np.sqrt(np.sum(rest**2) / max(len(stamps) - 2, 1)))
