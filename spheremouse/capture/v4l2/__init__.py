"""`v4l2:DEVICE[,width=W,height=H,fps=F,format=NAME]`: a camera of Linux, with its own stamps and without copies.

DEVICE is a number, /dev/videoN or a path below /dev/v4l/by-id. The driver's mapped buffers are the ring: `next` takes
one out of its queue and hands it on as a raw frame, `release` puts it back; while all are out the driver drops, and
the frames' numbers show that.
"""

import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from select import POLLIN, poll
from threading import Lock
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, cast, get_args

import numpy as np
from numpy.typing import NDArray

from spheremouse.capture import Stream
from spheremouse.capture.settings import CameraSettings, PixelName
from spheremouse.capture.v4l2.pixels import Layout, bgr, luma
from spheremouse.capture.v4l2.stamps import Arrival, Count, Moment, Stamps, Timing, counted, stamped
from spheremouse.errors import DamagedFrameError, SourceError
from spheremouse.files.registry import options
from spheremouse.tracker import Frame

if TYPE_CHECKING:
    from spheremouse.capture.v4l2.controls import Controls
    from spheremouse.capture.v4l2.device import Device, Mode

BUFFERS = 6  # two may be held, and the driver fills others meanwhile

_PATIENCE = 5.0  # s without a frame after which the plain source gives up
_MOST_DAMAGED = 60  # frames one after another, after which it gives up as well
_SIZE = {"width": int, "height": int}
_ERROR, _SRC_MASK, _SRC_SOE = 0x40, 0x70000, 0x10000  # V4L2_BUF_FLAG_ERROR, _TSTAMP_SRC_MASK, _TSTAMP_SRC_SOE
_CLOCK_MASK, _CLOCKS = 0xE000, {0x2000: "monotonic", 0x4000: "copied"}  # V4L2_BUF_FLAG_TIMESTAMP_MASK
_HWTIMESTAMPS = Path("/sys/module/uvcvideo/parameters/hwtimestamps")


class V4L2Frame:
    """A frame in the driver's buffer, not decoded yet; see capture.RawFrame."""

    __slots__ = ("_camera", "_index", "_layout", "_lost", "_payload", "sequence", "stamp")

    def __init__(
        self, camera: "V4L2Camera", index: int, payload: NDArray[np.uint8], lost: bool, stamp: float, sequence: int
    ) -> None:
        self.stamp, self.sequence = stamp, sequence
        self._camera, self._index, self._layout, self._lost = camera, index, camera.layout, lost
        self._payload: NDArray[np.uint8] | None = payload

    def frame(self, colour: bool) -> Frame:
        """Luma (a view of the buffer, but for MJPG) or BGR (a copy). DamagedFrameError where it is no whole picture."""
        if self._payload is None:
            raise ValueError("this frame was released")
        if self._lost:
            raise DamagedFrameError("the driver lost a part of the frame")
        image = (bgr if colour else luma)(self._payload, self._layout)
        return Frame(image, self.stamp, self.sequence)

    def release(self) -> None:
        """The buffer goes back to the driver; what `frame` gave of luma must not be looked at any more."""
        self._payload = None
        self._camera.take_back(self._index, self)


class V4L2Camera:
    """An open camera whose frames come; see capture.Camera. `next` is for one thread, all else for any."""

    def __init__(
        self, device: "Device", controls: "Controls", mode: "Mode", settings: CameraSettings, words: str
    ) -> None:
        self.layout: Layout = mode.layout
        self.fps = mode.fps
        self.notes: tuple[str, ...] = ()  # what was wrong with stamps, each told once
        self._device: Device | None = device
        self._controls = controls
        self._lock = Lock()
        self._out: dict[int, V4L2Frame] = {}
        self._ready = poll()
        self._ready.register(device.fd, POLLIN)
        self._stamps, self._count = Stamps(), Count()
        self._soe = _meaning_of_soe(device.driver)
        self._exposure = controls.exposure()
        interval = 1.0 / mode.fps if mode.fps else 1.0 / 30.0
        begin = Timing(Moment.END_OF_FRAME, interval, self._exposure, settings.readout_s or 0.0, settings.stamp_shift_s)
        self._timings = {moment: replace(begin, moment=moment) for moment in Moment}
        self._flags: int | None = None  # those of the newest frame
        self._words = words

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def next(self, timeout: float) -> V4L2Frame | None:
        """The oldest frame not given yet, None if none comes within `timeout` s; SourceError if the camera is gone."""
        deadline = time.monotonic() + timeout
        device = self._device
        if device is None:
            raise SourceError("the camera is closed")
        waited = False
        while not (events := self._ready.poll(0)):
            left = deadline - time.monotonic()
            if left <= 0.0:
                return None
            waited = True
            self._ready.poll(1e3 * left)
        buffer = device.dequeue()
        if buffer is None:
            if not events[0][1] & POLLIN:
                raise SourceError(f"{device.path}: the camera is gone, or its stream broke off; plug it in again")
            return None
        arrival = Arrival(time.monotonic(), time.time(), waited)
        return self._raw_frame(device, buffer, arrival)

    def _raw_frame(self, device: "Device", buffer: Any, arrival: Arrival) -> V4L2Frame:
        raw = buffer.timestamp.secs + 1e-6 * buffer.timestamp.usecs
        self._flags = flags = buffer.flags
        self._stamps, stamp, said = stamped(self._stamps, raw, arrival, self._timings[self._moment(flags)])
        if said:
            self.notes = (*self.notes, said)
        self._count, sequence = counted(self._count, buffer.sequence)
        payload = device.buffers[buffer.index][: buffer.bytesused]
        frame = V4L2Frame(self, buffer.index, payload, bool(flags & _ERROR), stamp, sequence)
        with self._lock:
            self._out[buffer.index] = frame
        return frame

    def take_back(self, index: int, raw: V4L2Frame) -> None:
        """Queue a raw frame's buffer again, unless that was done, or the camera is closed."""
        with self._lock:
            if self._out.get(index) is not raw:
                return
            del self._out[index]
            if self._device is not None:
                with suppress(OSError):  # the camera is gone, which `next` will say
                    self._device.queue(index)

    def describe(self) -> str:
        """Device, mode, what the stamps are, what was set, and what was wrong with stamps."""
        layout = self.layout
        rate = f"{self.fps:g} frames/s" if self.fps else "unknown rate"
        parts = [f"{self._words}: {layout.width}x{layout.height} {layout.format}, {rate}"]
        if layout.format == "GREY":
            parts.append("no colour: ring targets cannot be found")
        exposure = "unknown" if self._exposure is None else f"{1e3 * self._exposure:g} ms"
        if self._flags is not None:
            clock = _CLOCKS.get(self._flags & _CLOCK_MASK, "unknown")
            parts.append(f"stamps at {self._moment(self._flags).value}, {clock} clock, exposure {exposure}")
        return "; ".join((*parts, *self.notes))

    def close(self) -> None:
        """Controls as they were, the device closed; raw frames that are out stay readable until they are released."""
        with self._lock:
            device, self._device = self._device, None
        if device is not None:
            self._controls.restore()
            device.close()

    def _moment(self, flags: int) -> Moment:
        return self._soe if flags & _SRC_MASK == _SRC_SOE else Moment.END_OF_FRAME


def open(argument: str, realtime: bool) -> Stream:  # a live source is real time by itself
    """Frames in colour, the newest there is each time; for what does not need every one."""
    return stream(argument, CameraSettings())


def stream(argument: str, settings: CameraSettings) -> Stream:
    """`open`, with the camera set as `settings` ask."""
    camera = open_camera(argument, settings)
    return Stream(_newest(camera), live=True, fps=camera.fps, close=camera.close)


def full_size(argument: str, most: tuple[int, int]) -> tuple[int, int] | None:
    """The largest size up to `most` at which a camera gives enough frames to play with; None where it is not told."""
    if not sys.platform.startswith("linux"):
        return None
    from spheremouse.capture.v4l2.device import Device, find

    device = Device(find(argument.partition(",")[0]))
    try:
        return device.largest(most)
    finally:
        device.close()


def open_camera(argument: str, settings: CameraSettings) -> V4L2Camera:
    """The camera that `DEVICE[,KEY=VALUE...]` names, set as `settings` and above them the argument ask; it streams."""
    if not sys.platform.startswith("linux"):
        raise SourceError("v4l2: is of Linux; write opencv:0 for the first camera here")
    from spheremouse.capture.v4l2.controls import read_controls
    from spheremouse.capture.v4l2.device import Device, find, lasting_name

    name, settings = parse(argument, settings)
    device = Device(find(name))
    try:
        controls = read_controls(device.fd, device.path)
        mode = device.negotiate(settings)
        done = controls.apply(settings)
        try:
            device.start(BUFFERS)
            words = f"{device.path} ({device.card}, {device.driver}, {len(device.buffers)} buffers)"
            lasting = lasting_name(device.path)
            words += f", lasting name {lasting}" if lasting else ""
            words += f", set {', '.join(done)}" if done else ""
            return V4L2Camera(device, controls, mode, settings, words)
        except BaseException:
            controls.restore()
            raise
    except OSError as e:
        failure = device.failure(e)
        device.close()
        raise failure from None
    except BaseException:
        device.close()
        raise


def check(argument: str) -> None:
    """SourceError where the argument is of no use."""
    parse(argument, CameraSettings())


def size_to_come(argument: str, settings: CameraSettings) -> tuple[int, int]:
    """Width and height, px, that `open_camera` would ask for; the camera is asked, and nothing of it is changed.

    SourceError where it is not there, or has no such size.
    """
    from spheremouse.capture.v4l2.device import Device, find

    name, settings = parse(argument, settings)
    device = Device(find(name))
    try:
        return device.size_to_come(settings)
    finally:
        device.close()


def parse(argument: str, settings: CameraSettings) -> tuple[str, CameraSettings]:
    """DEVICE, and the settings with what else the argument says."""
    name, _, rest = argument.partition(",")
    label = f"v4l2:{argument}"
    given = options(rest, {**_SIZE, "fps": float, "format": str}, label, SourceError)
    if len(_SIZE.keys() & given.keys()) == 1:
        raise SourceError(f"{label}: width and height go together; give both")
    try:
        if "width" in given:
            settings = replace(settings, size=(int(given["width"]), int(given["height"])))
        if "fps" in given:
            settings = replace(settings, fps=float(given["fps"]))
        if "format" in given:
            settings = replace(settings, format=cast(PixelName, str(given["format"]).upper()))
    except ValueError as e:
        raise SourceError(f"{label}: {e}") from None
    known = get_args(PixelName)
    if settings.format != "auto" and settings.format not in known:
        raise SourceError(f"{label}: unknown format {given['format']}; formats are {', '.join(known)}")
    if settings.fps is not None and not settings.fps > 0.0:
        raise SourceError(f"{label}: fps must be above 0, is {settings.fps:g}")
    if settings.size is not None and min(settings.size) < 1:
        raise SourceError(f"{label}: width and height must be above 0")
    return name, settings


def _newest(camera: V4L2Camera) -> Iterator[Frame]:
    """Frames in colour, those that were not fetched in time left out."""
    damaged = 0
    while True:
        raw = camera.next(_PATIENCE)
        if raw is None:
            raise SourceError(f"{camera.describe()}: no frame for {_PATIENCE:g} s; see cable, hub and power")
        while (newer := camera.next(0.0)) is not None:
            raw.release()
            raw = newer
        try:
            frame = raw.frame(colour=True)
            damaged = 0
        except DamagedFrameError as e:
            damaged += 1
            if damaged >= _MOST_DAMAGED:
                raise SourceError(f"{camera.describe()}: {damaged} damaged frames in a row, the last: {e}") from None
            continue
        finally:
            raw.release()
        yield frame


def _meaning_of_soe(driver: str) -> Moment:
    """The moment that a driver's stamps "at start of exposure" tell."""
    if driver != "uvcvideo":
        return Moment.EXPOSURE_BEGINS
    try:
        hardware = _HWTIMESTAMPS.read_text().strip() in ("1", "Y", "y")
    except OSError:
        hardware = False
    return Moment.EXPOSURE_BEGINS if hardware else Moment.FIRST_PACKET
