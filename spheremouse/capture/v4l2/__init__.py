"""`v4l2:DEVICE[,width=W,height=H,fps=F,format=NAME]`: a camera on Linux, with its own stamps and without copies.

DEVICE is a number, /dev/videoN or a path below /dev/v4l/by-id. A raw frame is one of the driver's mapped buffers.
`next` takes it from the driver's queue, and `release` returns it. While all buffers are taken the driver drops frames,
and their numbers have a gap.
"""

import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from pathlib import Path
from select import POLLIN, poll
from threading import Lock
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from spheremouse.capture import Payload, Stream
from spheremouse.capture.nodes import nodes, persistent_name, probe_node
from spheremouse.capture.settings import CameraSettings
from spheremouse.capture.steady import SteadyStamps
from spheremouse.capture.v4l2.pixels import Layout, bgr, luma, payload_of
from spheremouse.capture.v4l2.stamps import Arrival, Count, Moment, Stamps, Timing, correct_stamp, unwrap_count
from spheremouse.errors import ConfigurationError, DamagedFrameError, SourceError
from spheremouse.files.config import override
from spheremouse.files.registry import options
from spheremouse.finding import Finding
from spheremouse.tracker import Frame

if TYPE_CHECKING:
    from spheremouse.capture.v4l2.controls import Controls
    from spheremouse.capture.v4l2.device import Device, Mode

BUFFERS = 6  # the daemon may hold two while the driver fills others

FRAME_TIMEOUT = 5.0  # s without a frame, after which the plain source raises an error
MAX_DAMAGED = 60  # frames in a row, after which it raises an error
_SIZE = {"width": int, "height": int}
_ERROR, _SRC_MASK, _SRC_SOE = 0x40, 0x70000, 0x10000  # V4L2_BUF_FLAG_ERROR, _TSTAMP_SRC_MASK, _TSTAMP_SRC_SOE
_CLOCK_MASK, _CLOCKS = 0xE000, {0x2000: "monotonic", 0x4000: "copied"}  # V4L2_BUF_FLAG_TIMESTAMP_MASK
_HWTIMESTAMPS = Path("/sys/module/uvcvideo/parameters/hwtimestamps")


class V4L2Frame:
    """A frame in the driver's buffer, as a `capture.RawFrame`."""

    __slots__ = ("_camera", "_index", "_layout", "_lost", "_payload", "sequence", "stamp")

    def __init__(
        self, camera: "V4L2Camera", index: int, payload: NDArray[np.uint8], lost: bool, stamp: float, sequence: int
    ) -> None:
        self.stamp, self.sequence = stamp, sequence
        self._camera, self._index, self._layout, self._lost = camera, index, camera.layout, lost
        self._payload: NDArray[np.uint8] | None = payload

    def frame(self, colour: bool) -> Frame:
        """Return luma (a view of the buffer, except for MJPG) or BGR (a copy). Raises DamagedFrameError."""
        if self._payload is None:
            raise ValueError("this frame was released")
        if self._lost:
            raise DamagedFrameError("the driver lost a part of the frame")
        image = (bgr if colour else luma)(self._payload, self._layout)
        return Frame(image, self.stamp, self.sequence)

    def payload(self) -> Payload:
        """Return the buffer's image, without the padding of its rows. Raises DamagedFrameError if bytes are missing."""
        if self._payload is None:
            raise ValueError("this frame was released")
        return payload_of(self._payload, self._layout)

    def release(self) -> None:
        """Return the buffer to the driver. A luma image of `frame` is invalid afterwards."""
        self._payload = None
        self._camera.take_back(self._index, self)


class V4L2Camera:
    """An open camera that streams, as a `capture.Camera`. One thread calls `next`; any thread calls the others."""

    def __init__(
        self, device: "Device", controls: "Controls", mode: "Mode", settings: CameraSettings, words: str
    ) -> None:
        self.layout: Layout = mode.layout
        self.fps = mode.fps
        self.notes: tuple[str, ...] = ()  # problems of the stamps, each once
        self._device: Device | None = device
        self._controls = controls
        self._lock = Lock()
        self._lent: dict[int, V4L2Frame] = {}  # frames whose buffers the driver does not have, by index
        self._ready = poll()
        self._ready.register(device.fd, POLLIN)
        self._stamps, self._count = Stamps(), Count()
        self._soe = start_of_exposure_moment(device.driver)
        self._exposure = controls.exposure()
        interval = 1.0 / mode.fps if mode.fps else 1.0 / 30.0
        begin = Timing(Moment.END_OF_FRAME, interval, self._exposure, settings.readout_s or 0.0, settings.stamp_shift_s)
        self._steady = SteadyStamps(interval)
        self._timings = {moment: replace(begin, moment=moment) for moment in Moment}
        self._flags: int | None = None  # of the newest frame
        self._words = words

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def next(self, timeout: float) -> V4L2Frame | None:
        """Return the oldest queued frame; None if none comes within `timeout` (s). Raises SourceError if it is gone."""
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
        self._stamps, corrected, note = correct_stamp(self._stamps, raw, arrival, self._timings[self._moment(flags)])
        if note:
            self.notes = (*self.notes, note)
        before = self._count.number
        self._count, sequence = unwrap_count(self._count, buffer.sequence)
        stamp = self._steady.next(corrected, arrival.clock, sequence - before)
        payload = device.buffers[buffer.index][: buffer.bytesused]
        frame = V4L2Frame(self, buffer.index, payload, bool(flags & _ERROR), stamp, sequence)
        with self._lock:
            self._lent[buffer.index] = frame
        return frame

    def take_back(self, index: int, raw: V4L2Frame) -> None:
        """Queue a raw frame's buffer again, unless this frame has given it back before or the camera is closed."""
        with self._lock:
            if self._lent.get(index) is not raw:
                return
            del self._lent[index]
            if self._device is not None:
                with suppress(OSError):  # `next` reports that the camera is gone
                    self._device.queue(index)

    def describe(self) -> str:
        """Return device, mode, changed controls, kind of stamps, and problems of the stamps."""
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
        """Restore the controls and close the device. Raw frames stay readable until they are released."""
        with self._lock:
            device, self._device = self._device, None
        if device is not None:
            self._controls.restore()
            device.close()

    def _moment(self, flags: int) -> Moment:
        return self._soe if flags & _SRC_MASK == _SRC_SOE else Moment.END_OF_FRAME


def open(argument: str, realtime: bool) -> Stream:  # a camera is always real time
    """Open a camera that yields the newest frame, in colour, and skips older ones."""
    return stream(argument, CameraSettings())


def stream(argument: str, settings: CameraSettings) -> Stream:
    """Open a camera with the given settings, as `open` does."""
    camera = open_camera(argument, settings)
    return Stream(newest_frames(camera), live=True, fps=camera.fps, close=camera.close)


def largest_size(argument: str, limit: tuple[int, int]) -> tuple[int, int] | None:
    """Return the largest size within `limit` at which a camera is fast enough; None if the driver lists no size."""
    if not sys.platform.startswith("linux"):
        return None
    from spheremouse.capture.v4l2.device import Device, find

    with closing(Device(find(argument.partition(",")[0]))) as device:
        return device.largest(limit)


def open_camera(argument: str, settings: CameraSettings) -> V4L2Camera:
    """Open the camera `DEVICE[,KEY=VALUE...]`, set its controls and start it. The argument overrides `settings`.

    Raises SourceError outside Linux, for an invalid argument, or if the camera refuses.
    """
    if not sys.platform.startswith("linux"):
        raise SourceError("v4l2: works on Linux alone; write opencv:0 for the first camera here")
    from spheremouse.capture.v4l2.controls import read_controls
    from spheremouse.capture.v4l2.device import Device, find

    name, settings = parse(argument, settings)
    device = Device(find(name))
    with ExitStack() as undo:
        undo.callback(device.close)
        try:
            controls = read_controls(device.fd, device.path)
            mode = device.negotiate(settings)
            changes = controls.apply(settings)
            undo.callback(controls.restore)
            device.start(BUFFERS)
            words = f"{device.path} ({device.card}, {device.driver}, {len(device.buffers)} buffers)"
            name = persistent_name(device.path)
            words += f", persistent name {name}" if name else ""
            words += f", set {', '.join(changes)}" if changes else ""
            camera = V4L2Camera(device, controls, mode, settings, words)
        except OSError as e:
            raise device.failure(e) from None
        undo.pop_all()
        return camera


def check(argument: str) -> None:
    parse(argument, CameraSettings())


def parse(argument: str, settings: CameraSettings) -> tuple[str, CameraSettings]:
    """Return DEVICE, and the settings with the other parts of the argument. Raises SourceError if one is invalid."""
    name, _, rest = argument.partition(",")
    label = f"v4l2:{argument}"
    given = options(rest, {**_SIZE, "fps": float, "format": str}, label, SourceError)
    if len(_SIZE.keys() & given.keys()) == 1:
        raise SourceError(f"{label}: width and height go together; give both")
    assignments = [f"size=[{given['width']}, {given['height']}]"] if "width" in given else []
    assignments += [f"fps={given['fps']}"] if "fps" in given else []
    assignments += [f"format={str(given['format']).upper()}"] if "format" in given else []
    try:
        for assignment in assignments:
            settings = override(settings, assignment, label=f"{label}: ")
    except ConfigurationError as e:
        raise SourceError(str(e).splitlines()[0]) from None
    return name, settings


def probe(argument: str) -> list[Finding]:
    from spheremouse.capture.v4l2.device import find

    return probe_node(find(argument.partition(",")[0]), nodes())


def newest_frames(camera: V4L2Camera) -> Iterator[Frame]:
    """Yield the newest frame in colour. Raise SourceError if none comes in time, or too many are damaged in a row."""
    damaged = 0
    while True:
        raw = camera.next(FRAME_TIMEOUT)
        if raw is None:
            raise SourceError(f"{camera.describe()}: no frame for {FRAME_TIMEOUT:g} s; see cable, hub and power")
        while (newer := camera.next(0.0)) is not None:
            raw.release()
            raw = newer
        try:
            frame = raw.frame(colour=True)
            damaged = 0
        except DamagedFrameError as e:
            damaged += 1
            if damaged >= MAX_DAMAGED:
                raise SourceError(f"{camera.describe()}: {damaged} damaged frames in a row, the last: {e}") from None
            continue
        finally:
            raw.release()
        yield frame


def start_of_exposure_moment(driver: str) -> Moment:
    """Return the actual moment of stamps that a driver declares as start of exposure."""
    if driver != "uvcvideo":
        return Moment.EXPOSURE_BEGINS
    try:
        hardware = _HWTIMESTAMPS.read_text().strip() in ("1", "Y", "y")
    except OSError:
        hardware = False
    return Moment.EXPOSURE_BEGINS if hardware else Moment.FIRST_PACKET
