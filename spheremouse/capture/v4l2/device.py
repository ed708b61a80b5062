"""Open a V4L2 capture device, negotiate its mode and map its buffers. Errors give a remedy.

The ioctls are functions of linuxpy. The driver's mapped buffers are used without a copy.
"""

import errno
import mmap
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from linuxpy.video.device import (
    IOC,
    BufferType,
    Capability,
    FrameIntervalType,
    FrameSizeType,
    Memory,
    dequeue_buffer,
    enqueue_buffer,
    free_buffers,
    get_fps,
    get_raw_format,
    human_pixel_format,
    iter_read,
    mmap_from_buffer,
    query_buffer,
    raw,
    read_capabilities,
    request_buffers,
    set_format,
    set_fps,
    stream_off,
    stream_on,
)
from numpy.typing import NDArray

from spheremouse.capture.nodes import cameras_here
from spheremouse.capture.settings import CameraSettings, PixelName
from spheremouse.capture.v4l2.pixels import FORMATS, Layout
from spheremouse.capture.v4l2.usb import reset_camera
from spheremouse.errors import SourceError, TransferError

CAPTURE = BufferType.VIDEO_CAPTURE
TRANSFER_ERRORS = (errno.EIO, errno.EPROTO, errno.EPIPE, errno.ETIMEDOUT)  # of a camera that does not answer properly

_FOURCC: dict[str, PixelName] = {"YUYV": "YUYV", "NV12": "NV12", "MJPG": "MJPG", "JPEG": "MJPG", "GREY": "GREY"}
_SUFFICIENT_RATE = 30.0  # Hz; without a requested rate, faster formats are no better


@dataclass(frozen=True, slots=True)
class Mode:
    """Layout and rate that the driver has accepted."""

    layout: Layout
    fps: float | None  # Hz; None: unknown


@dataclass(frozen=True, slots=True)
class Sizes:
    """Sizes of a format, px: a list, or a range."""

    listed: tuple[tuple[int, int], ...] = ()
    range: tuple[tuple[int, int], tuple[int, int]] | None = None  # smallest and largest

    @property
    def known(self) -> bool:
        """True if the driver lists its sizes."""
        return bool(self.listed) or self.range is not None

    def allow(self, size: tuple[int, int]) -> bool:
        """Return True if the format has this size, or its sizes are unknown."""
        if self.range is not None:
            low, high = self.range
            return low[0] <= size[0] <= high[0] and low[1] <= size[1] <= high[1]
        return size in self.listed or not self.known

    def __str__(self) -> str:
        if self.range is not None:
            return " to ".join(map(_format_size, self.range))
        return ", ".join(map(_format_size, sorted(self.listed)))


class Device:
    """An open capture device. Its methods raise SourceError. `close` may be called more than once."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)
        try:
            self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as e:
            raise _failure(path, e) from None
        try:
            found = read_capabilities(self.fd)
        except OSError:
            os.close(self.fd)
            raise SourceError(f"{path}: is no video device; {cameras_here()}") from None
        names = (found.driver, found.card, found.bus_info)
        self.driver, self.card, self.bus = (name.decode(errors="replace") for name in names)
        able = Capability(found.device_caps if found.capabilities & Capability.DEVICE_CAPS else found.capabilities)
        trouble = _unsuitable(able)
        if trouble:
            os.close(self.fd)
            raise SourceError(f"{path}: {trouble}; {cameras_here()}")
        self._maps: list[mmap.mmap] = []
        self.buffers: list[NDArray[np.uint8]] = []  # mapped, one array each
        self._streaming = False

    # ---- mode ----

    def negotiate(self, settings: CameraSettings) -> Mode:
        """Set format, size and rate. Raises SourceError with the possible modes if the device refuses them."""
        try:
            name, fourcc, size = self._choose_mode(settings)
            set_format(self.fd, CAPTURE, *size, pixel_format=human_pixel_format(fourcc))
            if settings.fps is not None:
                with suppress(OSError):  # some drivers have only one rate
                    set_fps(self.fd, CAPTURE, settings.fps)
            pix = get_raw_format(self.fd, CAPTURE).fmt.pix
            fps = self._rate()
        except OSError as e:
            raise self.failure(e) from None
        got = (pix.width, pix.height)
        if _FOURCC.get(human_pixel_format(pix.pixelformat)) != name:
            raise SourceError(
                f"{self.path}: gives {human_pixel_format(pix.pixelformat)} in place of {name}; {self.modes()}"
            )
        if settings.size is not None and got != tuple(settings.size):
            raise SourceError(
                f"{self.path}: gives {_format_size(got)} in place of {_format_size(settings.size)}; {self.modes()}"
            )
        if settings.fps is not None and not (fps and abs(fps - settings.fps) <= 0.01 * settings.fps):
            rates = self._rates(fourcc, *got)
            has = f"it has {', '.join(f'{r:g}' for r in rates)}" if rates else "leave fps out"
            given = f"{fps:g}" if fps else "no known number of"
            asked = f"{settings.fps:g} at {_format_size(got)} {name}"
            raise SourceError(f"{self.path}: gives {given} frames per second in place of {asked}; {has}")
        if name == "NV12" and (got[0] % 2 or got[1] % 2):
            raise SourceError(
                f"{self.path}: NV12 of {_format_size(got)}, which is odd, cannot be read; choose another size"
            )
        stride = max(pix.bytesperline, got[0] * (2 if name == "YUYV" else 1))
        return Mode(Layout(name, *got, 0 if name == "MJPG" else stride), fps)

    def largest(self, limit: tuple[int, int]) -> tuple[int, int] | None:
        """Return width and height, px, of the largest area within `limit` at a sufficient rate; None if none fits.

        Of a stepwise range only `limit` itself counts. Raises SourceError if the device fails.
        """
        found: set[tuple[int, int]] = set()
        try:
            for code in self._formats().values():
                sizes = self._sizes(code)
                candidates = (*sizes.listed, *([limit] if sizes.known and sizes.allow(limit) else []))
                fitting = {s for s in candidates if s[0] <= limit[0] and s[1] <= limit[1]}
                found |= {s for s in fitting if self._useful_rate(code, s, _SUFFICIENT_RATE) > 0.8 * _SUFFICIENT_RATE}
        except OSError as e:
            raise self.failure(e) from None
        return max(found, key=lambda s: s[0] * s[1], default=None)

    def modes(self) -> str:
        """Return the supported formats and sizes of the device in words."""
        formats = self._formats()
        has = "; ".join(f"{name} {self._sizes(code)}".strip() for name, code in formats.items())
        return f"it has {has}" if has else f"it has no format that can be read here ({', '.join(FORMATS)})"

    def _choose_mode(self, settings: CameraSettings) -> tuple[PixelName, int, tuple[int, int]]:
        """Return the format, its code, and the size to request."""
        formats = self._formats()
        now = get_raw_format(self.fd, CAPTURE).fmt.pix
        size = settings.size or (now.width, now.height)
        if settings.format != "auto" and settings.format not in formats:
            raise SourceError(f"{self.path}: has no {settings.format}; {self.modes()}")
        usable: list[PixelName] = [n for n in FORMATS if n in formats and settings.format in ("auto", n)]
        fitting: list[PixelName] = [n for n in usable if self._sizes(formats[n]).allow(size)]
        if not fitting and settings.size is None:
            fitting = usable
        if not usable:
            raise SourceError(f"{self.path}: {self.modes()}; use another camera")
        if not fitting:
            wish = "" if settings.format == "auto" else f" in {settings.format}"
            raise SourceError(f"{self.path}: has no {_format_size(size)}{wish}; {self.modes()}")
        sufficient_rate = settings.fps or _SUFFICIENT_RATE
        name = max(fitting, key=lambda n: (n != "GREY", self._useful_rate(formats[n], size, sufficient_rate)))
        return name, formats[name], size

    def _useful_rate(self, fourcc: int, size: tuple[int, int], sufficient_rate: float) -> float:
        """Return the highest rate (Hz), at most `sufficient_rate`, which it also returns if the driver lists none."""
        return min(sufficient_rate, max(self._rates(fourcc, *size), default=sufficient_rate))

    def _formats(self) -> dict[PixelName, int]:
        """Return the supported formats of the device, with their codes."""
        query = raw.v4l2_fmtdesc()
        query.type = CAPTURE
        found: dict[PixelName, int] = {}
        for item in iter_read(self.fd, IOC.ENUM_FMT, query):
            name = _FOURCC.get(human_pixel_format(item.pixelformat))
            if name is not None:
                found.setdefault(name, item.pixelformat)
        return found

    def _sizes(self, fourcc: int) -> Sizes:
        """Return the picture sizes that the driver offers for a pixel format `fourcc`."""
        query = raw.v4l2_frmsizeenum()
        query.pixel_format = fourcc
        sizes = []
        for item in iter_read(self.fd, IOC.ENUM_FRAMESIZES, query):
            if item.type != FrameSizeType.DISCRETE:
                s = item.stepwise
                return Sizes((), ((s.min_width, s.min_height), (s.max_width, s.max_height)))
            sizes.append((item.discrete.width, item.discrete.height))
        return Sizes(tuple(dict.fromkeys(sizes)))

    def _rates(self, fourcc: int, width: int, height: int) -> list[float]:
        """Return the listed rates (Hz) in ascending order; of a range its ends."""
        query = raw.v4l2_frmivalenum()
        query.pixel_format, query.width, query.height = fourcc, width, height
        rates = set()
        for item in iter_read(self.fd, IOC.ENUM_FRAMEINTERVALS, query):
            if item.type == FrameIntervalType.DISCRETE:
                rates.add(_hertz(item.discrete))
            else:
                rates |= {_hertz(item.stepwise.min), _hertz(item.stepwise.max)}
                break
        return sorted(r for r in rates if 0.0 < r < 1e5)

    def _rate(self) -> float | None:
        with suppress(OSError, ZeroDivisionError):
            return float(get_fps(self.fd, CAPTURE)) or None
        return None

    # ---- frames ----

    def start(self, count: int) -> None:
        """Map and queue `count` buffers (the driver may give more or fewer), and start the stream."""
        try:
            given = request_buffers(self.fd, CAPTURE, Memory.MMAP, count).count
            for i in range(given):
                self._maps.append(mmap_from_buffer(self.fd, query_buffer(self.fd, CAPTURE, Memory.MMAP, i)))
                self.buffers.append(np.frombuffer(self._maps[-1], np.uint8))
                self.queue(i)
            stream_on(self.fd, CAPTURE)
        except OSError as e:
            raise self.failure(e) from None
        self._streaming = True

    def queue(self, index: int) -> None:
        """Give a buffer to the driver. Raises OSError."""
        enqueue_buffer(self.fd, CAPTURE, Memory.MMAP, 0, index)

    def dequeue(self) -> raw.v4l2_buffer | None:
        """Return the driver's description of the oldest filled buffer; None if there is none."""
        try:
            return dequeue_buffer(self.fd, CAPTURE, Memory.MMAP)
        except BlockingIOError:
            return None
        except OSError as e:
            raise SourceError(str(self.failure(e))) from None  # a stream that breaks off is opened again first

    def close(self) -> None:
        """Stop the stream, free all buffers and close the device. All errors are ignored.

        The memory of a buffer that an image still uses is unmapped when that image is deleted. Until then the kernel
        keeps the device open. Because its buffers are free, other programs can use it, except with old kernels, which
        free no buffer that is mapped.
        """
        if self.fd < 0:
            return
        if self._streaming:
            with suppress(OSError):
                stream_off(self.fd, CAPTURE)
        self.buffers.clear()
        while self._maps:
            with suppress(BufferError):  # an image uses it
                self._maps.pop().close()
        with suppress(OSError):
            free_buffers(self.fd, CAPTURE, Memory.MMAP)
        os.close(self.fd)
        self.fd = -1

    def failure(self, error: OSError) -> SourceError:
        """Return the error of the open device, with a remedy."""
        if error.errno == errno.EINVAL and self.driver == "v4l2 loopback":
            return SourceError(f"{self.path}: this loopback device has no writer; start its writer first")
        return _failure(self.path, error)


def find(text: str) -> Path:
    """Return the node of a number or path. Raises SourceError for an empty text."""
    text = text.strip()
    if not text:
        raise SourceError(f"v4l2: needs a device; write v4l2:/dev/video0 ({cameras_here()})")
    return Path(f"/dev/video{text}") if text.isdecimal() else Path(text)


def _failure(path: Path | str, error: OSError) -> SourceError:
    match error.errno:
        case errno.ENOENT:
            text = f"no such device; {cameras_here()}"
        case errno.EACCES | errno.EPERM:
            text = "may not be opened; as root: usermod -aG video USER, then log in again"
        case errno.ENODEV | errno.ENXIO | errno.ESHUTDOWN:
            text = "the camera is gone; plug it in again"
        case errno.EBUSY:
            text = f"another program uses it; `fuser -v {path}` shows which"
        case e if e in TRANSFER_ERRORS:
            text = f"{path}: the camera stopped ({error.strerror}); see its cable, hub and power"
            return TransferError(text, partial(reset_camera, str(path)))
        case errno.ENOSPC:
            text = "not enough USB bandwidth; choose format=MJPG, a smaller size or rate, or another port"
        case _:
            text = f"{error.strerror or error}; unplug the camera and plug it in again"
    return SourceError(f"{path}: {text}")


def _unsuitable(able: Capability) -> str | None:
    """Return the reason why a device with these capabilities is unsuitable; None if it is suitable."""
    if Capability.VIDEO_CAPTURE not in able:
        if Capability.VIDEO_CAPTURE_MPLANE in able:
            return "has its images in several planes, which is not supported"
        return "gives no images (a camera's second node carries other data); name its first"
    return None if Capability.STREAMING in able else "does not stream; its driver is too old"


def _hertz(interval: raw.v4l2_fract) -> float:
    return interval.denominator / interval.numerator if interval.numerator else 0.0


def _format_size(size: Sequence[int]) -> str:
    return f"{size[0]}x{size[1]}"
