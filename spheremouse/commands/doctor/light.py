"""The light: brightness, overexposure and flicker. The limits are those of the disc detector (`detect.discs`)."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.signal import lombscargle

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import DiscSettings
from spheremouse.ball.detect.projection import GREY, Projection
from spheremouse.commands.doctor.camera import Footage, steadiness
from spheremouse.finding import Finding, Verdict, classify, ok, unchecked
from spheremouse.geometry.rotation import Array

_CLIPPED = 254  # grey value: the last two values have all overexposed pixels at any noise
_LIGHT_DISCS = 99.8  # per cent of the ball that are darker than light discs: eight of 2 cm on 1.2 m cover 0.2 %
_BRIGHTEST = 95.0  # per cent of the picture that are darker
_MAX_CLIPPED = 0.1  # of the ball overexposed: one disc in ten has a rim with a clipped bright side
_PRINT_CONTRAST = 0.8  # contrast of black print on white
_LAMPS_HZ = (100.0, 120.0)  # Hz: twice the mains of 50 and 60
_MAINS_DRIFT_HZ = 0.5  # Hz about them: mains within 0.2 %, the camera's clock and its stamps over two seconds
_MAX_CHANCE = 1e-4  # chance that noise alone is taken for flicker
_MIN_DEPTH = 0.005  # depth below which flicker is not reported


def brightness(
    views: list[Image], mask: Image | None, settings: DiscSettings, noise: float, projection: Projection = GREY
) -> Finding:
    """Check the grey values of the ball's surface in `views` (h, w), where `mask` (h, w) is not 0.

    Without a mask, check the brightest part of the picture.

    A disc of the lowest contrast must exceed the noise at its edge, where half of it is left, by four standard
    deviations and a grey value, as in the detector. The contrast is relative to the lighter of disc and ball, which is
    the disc in any `projection` but grey.
    """
    values = np.concatenate([v[mask > 0] if mask is not None else v.ravel() for v in views])
    middle = float(np.median(values) if mask is not None else np.percentile(values, _BRIGHTEST))
    level = middle if projection == GREY else float(np.percentile(values, _LIGHT_DISCS))
    clipped = float(np.mean(values >= _CLIPPED))
    least, hopeless = ((4.0 * noise + 1.0) / (0.5 * c) for c in (settings.contrast, _PRINT_CONTRAST))
    ball, where = (True, "the ball") if mask is not None else (False, "the brightest of the picture")
    darken = "a shorter exposure (camera.exposure_s), less gain, or a lamp less"
    lighten = "more light on the ball; then gain, then exposure"
    hidden = f": even black print stands out of the noise from {hopeless:.0f} on"
    return classify(
        "brightness",
        f"{where} is at {middle:.0f} of 255, noise {noise:.1f}, {100 * clipped:.1f} % overexposed",
        (ball and clipped > 0.5, Verdict.WRONG, ": most discs have no true rim", darken),
        (ball and level < hopeless, Verdict.WRONG, hidden, lighten),
        (ball and clipped > _MAX_CLIPPED, Verdict.WARNING, ": discs there are measured badly", darken),
        (level < least, Verdict.WARNING, f": discs in haze or shade need {least:.0f}", lighten),
        grey=round(middle, 1),
        noise=round(noise, 2),
        blown_out=round(clipped, 4),
        least=round(least, 1),
    )


# ---- flicker ----


@dataclass(frozen=True, slots=True)
class Flicker:
    """Flicker of lamps on the mains in a film."""

    lamp: float  # Hz
    seen_at: float  # Hz, in the film: how far from a whole multiple of its rate
    depth: float  # of the mean grey value, amplitude
    chance: float  # probability that noise alone does this


def flicker(footage: Footage, mask: Image | None, settings: DiscSettings) -> Finding:
    """Check for grey values that oscillate with the mains. Bands as dark as a faint disc are a warning."""
    interval, _ = steadiness(footage.stamps, footage.sequence)
    if len(footage.stamps) < 20 or interval <= 0.0:
        return unchecked("flicker", "too few frames for this check")
    found, hidden = search(footage.grid, footage.stamps, footage.sequence, mask)
    fps = f"at {1 / interval:.4g} frames/s"
    if len(hidden) == len(_LAMPS_HZ):
        return unchecked("flicker", f"{fps} lamps of 50 and 60 Hz mains stand still or look alike")
    real = [f for f in found if f.chance < _MAX_CHANCE and f.depth > _MIN_DEPTH]
    if not real:
        blind = "".join(f"; {lamp / 2:g} Hz mains flicker is invisible {fps}" for lamp in hidden)
        return ok("flicker", f"none seen{blind}", hidden_hz=list(hidden))
    worst = max(real, key=lambda f: f.depth)
    mains = worst.lamp / 2.0
    strong = worst.depth > 0.3 * settings.contrast  # peak to peak as the detector's limit for a disc
    period = f"set camera.exposure_s to a whole number of {1 / worst.lamp:.4g} s, or camera.mains_hz: {mains:g}"
    return classify(
        "flicker",
        f"mains of {mains:g} Hz: grey values oscillate by {100 * worst.depth:.1f} %, "
        + ("as much as a faint disc" if strong else "which does no harm"),
        (strong, Verdict.WARNING, "", f"{period}; or lamps that do not flicker"),
        mains_hz=mains,
        depth=round(worst.depth, 4),
        chance=worst.chance,
        seen_at_hz=round(worst.seen_at, 2),
    )


def search(grid: Array, stamps: Array, sequence: Array, mask: Image | None) -> tuple[list[Flicker], tuple[float, ...]]:
    """Return the flicker at each lamp frequency that the film can show, and the frequencies, Hz, that it cannot.

    `grid`, `stamps` (s) and `sequence` are those of `Footage`. `mask` (h, w) is the ball in the picture; None: all.

    A film of F frames/s shows f as |f - n F|. At less than one and a half turns in the film it looks like a slow
    change. Within a turn of F/2 its depth is not determined. Strips of rows each have a phase of their own, for a
    rolling shutter reads them at different times; their powers are added. Compared with the median power at all other
    frequencies, noise exceeds k times its mean with a chance of exp(-k) (a strip's power is exponentially
    distributed; strips may have their noise in common and count as one), times the number of frequencies tried.
    """
    interval, _ = steadiness(stamps, sequence)
    t = _times(stamps, interval)
    signal = _strips(grid, mask)
    span, half = float(t[-1] - t[0]), 0.5 / interval
    frequencies = np.arange(1.5 / span, half - 1.0 / span, 0.25 / span)
    if len(frequencies) < 8 or signal.shape[1] == 0:
        return [], _LAMPS_HZ
    power = _power(signal, t, frequencies)
    alias = {lamp: abs(lamp - np.rint(lamp * interval) / interval) for lamp in _LAMPS_HZ}
    alike = abs(alias[100.0] - alias[120.0]) < 2.0 / span
    found, hidden = [], []
    for lamp, seen in alias.items():
        near = np.abs(frequencies - seen) <= max(_MAINS_DRIFT_HZ, 0.5 / span)
        if not near.any() or seen < frequencies[0] or seen > frequencies[-1] or alike:
            hidden.append(lamp)
            continue
        away = np.abs(frequencies - seen) > max(_MAINS_DRIFT_HZ, 0.5 / span) + 1.0 / span
        mean = float(np.median(power[away])) / np.log(2.0) if away.any() else np.inf
        best = float(power[near].max())
        tries = max(1.0, 2.0 * _MAINS_DRIFT_HZ * span)
        chance = min(1.0, tries * float(np.exp(-best / max(mean, 1e-30))))
        found.append(Flicker(lamp, float(seen), float(np.sqrt(best)), chance))
    return found, tuple(hidden)


def _times(stamps: Array, interval: float) -> Array:
    """Return the times of a regular camera without the jitter of its stamps; the stamps if it is not regular."""
    number = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(np.diff(stamps) / interval), 1.0))])
    regular = number * interval
    rest = stamps - stamps[0] - regular
    return regular if np.std(rest) < 0.25 * interval else stamps - stamps[0]


def _strips(grid: Array, mask: Image | None) -> Array:
    """Return the grey of strips of rows over n frames, (n, strips), relative to their mean over time.

    `grid` (n, rows, columns) has the mean grey values of cells of the pictures. Cells that are not within `mask`, the
    ball in the picture, do not count; None: all count. A fitted parabola in time is subtracted.
    """
    n, rows, columns = grid.shape
    weight = np.ones((rows, columns))
    if mask is not None:
        weight = (cv2.resize(mask.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA) > 0.95 * 255) * 1.0
    if not weight.any():
        weight[:] = 1.0
    good = weight.sum(axis=1) > 0
    strips = (grid * weight).sum(axis=2)[:, good] / weight.sum(axis=1)[good]
    mean = strips.mean(axis=0)
    strips = strips[:, mean > 1.0] / mean[mean > 1.0] - 1.0
    x = np.linspace(-1.0, 1.0, n)
    slow = np.stack([np.ones(n), x, x**2], axis=1)
    return strips - slow @ np.linalg.lstsq(slow, strips, rcond=None)[0]


def _power(signal: Array, t: Array, frequencies: Array) -> Array:
    """Return the squared amplitude of the best harmonic (Lomb 1976), the mean over strips, (frequencies,)."""
    powers = [lombscargle(t, strip, 2.0 * np.pi * frequencies) for strip in signal.T]
    return 4.0 / len(t) * np.mean(powers, axis=0)
