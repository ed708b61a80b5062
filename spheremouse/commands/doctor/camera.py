"""The camera: two seconds of its frames, their rate and stamps, and its automatic controls."""

import contextlib
import os
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from spheremouse.ball.rig import Rig
from spheremouse.capture import Camera, RawFrame, Source, open_source
from spheremouse.capture.fetch import Fetched
from spheremouse.capture.lock import locked
from spheremouse.errors import DamagedFrameError, SourceError, SpheremouseError, format_count
from spheremouse.finding import Finding, Verdict, classify, unchecked, wrong
from spheremouse.geometry.rotation import Array
from spheremouse.session.run_config import RunConfig
from spheremouse.tracker import Frame

_SETTLING_S = 0.4  # after a camera's first frame that are left out, while it finds its exposure
_MAX_VIEWS = 10  # whole frames
_FIRST_TIMEOUT_S = 4.0  # for a camera to begin
_SILENT_TIMEOUT_S = 1.0  # without a frame after which it has stopped
_MAX_FRAMES = 600  # of a recording at 240 Hz

_MIN_RATE = 0.95  # of the promised one: in two seconds the count is uncertain by one in sixty
_MAX_LOST = 0.01  # of the frames: a camera in order loses none
_MAX_JITTER = 0.05  # of the interval: the measured rate of the ball has the same error
_MIN_FRAMES = 8

_MANUAL, _SHUTTER_PRIORITY = 1, 2  # V4L2_CID_EXPOSURE_AUTO with an exposure that stays
_EXPOSURE_UNIT_S = 1e-4  # of V4L2_CID_EXPOSURE_ABSOLUTE
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
    dynamic_rate: bool | None = None  # dim light lowers the frame rate
    focus: int | None = None
    zoom: int | None = None
    sharpness: int | None = None


def read_controls(node: Path) -> Controls | None:
    """Return the controls of a camera, which may be open elsewhere; None if it cannot be asked."""
    try:
        from linuxpy.video.device import ControlID, get_control

        fd = os.open(node, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except (ImportError, OSError):
        return None

    def value(name: str) -> int | None:
        with contextlib.suppress(OSError):
            return int(get_control(fd, ControlID[name]))
        return None

    def flag(name: str) -> bool | None:
        return None if (v := value(name)) is None else bool(v)

    try:
        mode, units = value("EXPOSURE_AUTO"), value("EXPOSURE_ABSOLUTE")
        return Controls(
            units * _EXPOSURE_UNIT_S if units else None,
            None if mode is None else mode not in (_MANUAL, _SHUTTER_PRIORITY),
            flag("AUTOGAIN"),
            flag("FOCUS_AUTO"),
            flag("AUTO_WHITE_BALANCE"),
            value("POWER_LINE_FREQUENCY"),
            flag("EXPOSURE_AUTO_PRIORITY"),
            value("FOCUS_ABSOLUTE"),
            value("ZOOM_ABSOLUTE"),
            value("SHARPNESS"),
        )
    finally:
        os.close(fd)


def controls(c: Controls) -> list[Finding]:
    """Return findings about exposure, mains, frame rate, motors, colours and sharpening."""
    focus = "set camera.focus in the configuration to its value at the calibration"
    now = "" if c.focus is None else f", at {c.focus}"
    white = "set camera.white_balance in the configuration, for example 4500"
    sharpness = 'set camera.controls: ["sharpness=0"] in the configuration'
    flicker = c.automatic_exposure and c.mains == 0
    return [
        _exposure(c),
        classify(
            "mains",
            "this camera has no filter against flicker"
            if c.mains is None
            else f"filter {_MAINS.get(c.mains, c.mains)}",
            (bool(flicker), Verdict.WARNING, ": lamps may flicker in the picture", "set camera.mains_hz: 50, or 60"),
        ),
        _automatic(
            "frame rate",
            c.dynamic_rate and c.automatic_exposure is not False,
            "dim light lowers it (exposure_dynamic_framerate)",
            "set camera.fps in the configuration, which switches that off",
        ),
        Finding("zoom", Verdict.OK, "fixed" if c.zoom is None else f"at {c.zoom}; camera.zoom: {c.zoom} keeps it"),
        _automatic("focus", c.automatic_focus, "each time it moves, the calibration no longer holds", focus, now),
        _automatic(
            "white balance",
            c.automatic_white_balance,
            "the targets' colours change with the rest of the picture",
            white,
        ),
        classify(
            "sharpening",
            "this camera has no control for it" if c.sharpness is None else f"at {c.sharpness}",
            (bool(c.sharpness), Verdict.WARNING, ": bright rims bias discs at the ball's edge", sharpness),
        ),
    ]


def _exposure(c: Controls) -> Finding:
    if c.automatic_exposure is None and c.exposure_s is None:
        return unchecked("exposure", "this camera has no control for it, so it is unknown")
    now = "" if c.exposure_s is None else f", now {1e3 * c.exposure_s:g} ms"
    dim = ": in dim light it gets long, which blurs a turning ball and may halve the rate"
    shorter = "set camera.exposure_s: 0.01 in the configuration, or shorter, and more light"
    gain = ", but the gain is automatic: brightness and noise change"
    return classify(
        "exposure",
        f"{'automatic' if c.automatic_exposure else 'fixed'}{now}",
        (bool(c.automatic_exposure), Verdict.WARNING, dim, shorter),
        (bool(c.automatic_gain), Verdict.WARNING, gain, "set camera.gain in the configuration"),
        exposure_s=c.exposure_s,
        automatic=c.automatic_exposure,
        mains_filter=None if c.mains is None else _MAINS.get(c.mains),
    )


def _automatic(name: str, automatic: bool | None, effect: str, advice: str, now: str = "") -> Finding:
    if automatic:
        return Finding(name, Verdict.WARNING, f"automatic: {effect}", advice)
    return Finding(name, Verdict.OK, f"fixed{now}" if automatic is False else "this camera does not set it by itself")


@dataclass(frozen=True, slots=True)
class Footage:
    """Two seconds of frames: their times, and a few whole ones."""

    stamps: Array  # (n,) s
    arrivals: Array  # (n,) s on the clock of live stamps
    sequence: Array  # (n,)
    views: tuple[Frame, ...]
    fps: float | None  # Hz, as promised
    live: bool
    damaged: int = 0
    notes: tuple[str, ...] = ()  # on stamps, and on the end of the frames
    stamped: bool = False  # stamps are the camera's own
    description: str = ""
    rig: Rig | None = None  # of the source
    controls: Controls | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in px."""
        height, width = self.views[0].image.shape[:2]
        return width, height


def film(plan: RunConfig, seconds: float, node: Path | None, source: Source | None = None) -> Footage:
    """Film a source, which may be open already. SourceError if no frame comes."""
    kind, _, argument = plan.source.partition(":")
    with contextlib.ExitStack() as stack:
        if node is not None:
            stack.enter_context(locked(node))
        if kind == "v4l2":
            from spheremouse.capture.v4l2 import open_camera

            camera = stack.enter_context(open_camera(argument, plan.configuration.camera))
            footage = _footage(_raw_frames(camera), seconds, camera.fps, live=True)
            footage = replace(footage, stamped=True, notes=footage.notes + camera.notes, description=camera.describe())
        else:
            source = stack.enter_context(source or open_source(plan.source))
            footage = _footage(map(Fetched, source), seconds, source.fps, live=source.live)
            footage = replace(footage, description=plan.source, rig=source.rig)
        if len(footage.stamps) == 0:
            what = f"nothing but {footage.damaged} damaged frames" if footage.damaged else "no frame"
            raise SourceError(f"{footage.description}: {what}; see cable, hub and power, or take another format")
        return replace(footage, controls=None if node is None else read_controls(node))


def _raw_frames(camera: Camera) -> Iterator[RawFrame]:
    timeout = _FIRST_TIMEOUT_S
    while (raw := camera.next(timeout)) is not None:
        timeout = _SILENT_TIMEOUT_S
        yield raw
    if timeout == _SILENT_TIMEOUT_S:
        raise SourceError(f"the frames stopped for {_SILENT_TIMEOUT_S:g} s")


def _footage(raws: Iterable[RawFrame], seconds: float, fps: float | None, *, live: bool) -> Footage:
    """Collect frames: of a live source by the clock, after it has settled, of a recording by the stamps."""
    step = max(1, round((fps or 30.0) * seconds / _MAX_VIEWS))
    times: list[tuple[float, float, int]] = []
    views: list[Frame] = []
    damaged, notes = 0, ()
    begin: float | None = None
    try:
        for n, raw in enumerate(raws):
            arrival = time.monotonic()
            now = arrival if live else raw.stamp
            begin = now + _SETTLING_S * live if begin is None else begin
            if now > begin + seconds or n >= _MAX_FRAMES:
                raw.release()
                break
            try:
                if now >= begin:
                    whole = len(times) % step == 0 and len(views) <= _MAX_VIEWS
                    frame = raw.frame(whole)
                    times.append((frame.stamp, arrival, frame.sequence))
                    views += [replace(frame, image=frame.image.copy())] if whole else []
            except DamagedFrameError:
                damaged += 1
            finally:
                raw.release()
    except SpheremouseError as e:
        if not times:
            raise
        notes = (str(e),)
    stamps, arrivals, sequence = np.array(times, dtype=float).reshape(-1, 3).T
    return Footage(stamps, arrivals, sequence.astype(int), tuple(views), fps, live, damaged, notes)


def rate(footage: Footage) -> Finding:
    """Report the rate, by the camera's own count."""
    n, promised, live = len(footage.stamps), footage.fps, footage.live
    span = float(footage.stamps[-1] - footage.stamps[0])
    if n < _MIN_FRAMES:
        text = f"no more than {format_count(n, 'frame')} in {span:.1f} s"
        if not live:
            return unchecked("rate", f"{text}: the recording is short, or slow", frames=n)
        return wrong("rate", text, "see cable, hub and power, and a fixed, shorter exposure", frames=n)
    if span <= 0.0:
        return unchecked("rate", "the stamps do not increase", frames=n)
    produced = max(int(footage.sequence[-1] - footage.sequence[0]), n - 1)
    fps, lost = produced / span, produced - (n - 1)
    cable = "try a shorter cable, another port, or a format other than MJPG"
    gaps = "the recording has gaps: play it with its stamps"
    dim = "fix the exposure (camera.exposure_s): dim light makes cameras slower"
    busy = "choose a lower rate or size, or run fewer programs"
    return classify(
        "rate",
        f"{fps:.1f} frames/s{'' if promised is None else f' of {promised:g} promised'}, {n} seen in {span:.1f} s",
        (footage.damaged > 0, Verdict.WARNING, f"; {footage.damaged} damaged", cable),
        (promised is not None and fps < _MIN_RATE * promised, Verdict.WARNING, "", dim if live else gaps),
        (lost > _MAX_LOST * produced, Verdict.WARNING, f"; {lost} lost on the way", busy),
        fps=round(fps, 2),
        promised_fps=promised,
        frames=n,
        lost=lost,
        damaged=footage.damaged,
    )


def stamps(footage: Footage) -> Finding:
    """Check that stamps increase, are steady and belong to this clock."""
    steps = np.diff(footage.stamps)
    if len(steps) < _MIN_FRAMES - 1:
        return unchecked("stamps", "too few frames")
    if bad := int(np.count_nonzero(steps <= 0.0)):
        advice = "another driver or source; the tracker needs times"
        return wrong("stamps", f"{bad} of {len(steps)} do not increase", advice)
    interval, jitter = steadiness(footage.stamps, footage.sequence)
    values = {"interval_ms": round(1e3 * interval, 3), "jitter_ms": round(1e3 * jitter, 3)}
    text = f"steady to {1e3 * jitter:.2f} ms ({100 * jitter / interval:.1f} % of the interval)"
    if footage.live and footage.stamped:
        values["age_ms"] = round(1e3 * float(np.median(footage.arrivals - footage.stamps)), 2)
        text += f", {values['age_ms']:.1f} ms old when they come"
    corrected = "the tracker corrects that; camera.stamp_shift_s sets the rest"
    own = "take v4l2: in place of opencv:, which has the camera's own stamps"
    port = "give the camera a port of its own, and run fewer programs"
    advice = "rates vary as much; film again" if not footage.live else port if footage.stamped else own
    return classify(
        "stamps",
        text,
        (bool(footage.notes), Verdict.WARNING, f"; {'; '.join(footage.notes)}", corrected),
        (jitter > _MAX_JITTER * interval, Verdict.WARNING, "", advice),
        **values,
    )


def steadiness(stamps: Array, sequence: Array) -> tuple[float, float]:
    """Return interval and standard deviation of stamps, (n,) s, about a straight line through their numbers, (n,).

    If frames were not counted, the steps are rounded to whole intervals.
    """
    interval = float(np.median(np.diff(stamps) / np.maximum(np.diff(sequence), 1)))
    if interval <= 0.0:
        return 0.0, float("inf")
    steps = np.maximum(np.rint(np.diff(stamps) / interval), 1.0)
    number = np.concatenate([[0.0], np.cumsum(steps)])
    slope, start = np.polyfit(number, stamps - stamps[0], 1)
    rest = stamps - stamps[0] - (slope * number + start)
    return float(slope), float(np.sqrt(np.sum(rest**2) / max(len(stamps) - 2, 1)))
