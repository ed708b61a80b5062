"""Live pictures in shared memory: a ring of slots that the daemon writes and other processes read.

The memory is an anonymous file (memfd_create(2)). A header of 64-bit integers comes first, then the slots. Each has the
numbers `begun` and `ended`, `_FIELDS`, the pixels, and the annotations as JSON. `begun` and `ended` are a sequence
lock. A copy is consistent if `ended` was the picture's number before copying, and `begun` is it afterwards. Neither
side waits, so a reader that dies or stops does not affect the writer.
"""

import json
import mmap
import os
import struct
import threading
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal, get_args

import orjson

from spheremouse.errors import ControlError

PictureFormat = Literal["jpeg", "yuyv", "nv12", "grey", "bgr"]

_FORMATS: tuple[PictureFormat, ...] = get_args(PictureFormat)
_MAGIC = int.from_bytes(b"spherem2", "little")
_NEWEST, _SLOTS, _SLOT_BYTES = range(1, 4)  # in the header, after _MAGIC
_HEADER_BYTES = 64
_FIELDS = struct.Struct("=dIIIIII")  # stamp, index of the format, width, height, bytes of pixels, of annotations, 0
_FIELDS_AT = 16  # after `begun` and `ended`
_SLOT_HEADER_BYTES = 64
_MAX_READ_ATTEMPTS = 3  # of a reader, each at a newer picture
_F_SEAL_FUTURE_WRITE = 0x10  # Linux 5.1


@dataclass(frozen=True, slots=True)
class LivePicture:
    """A frame as the camera sent it, with the tracker's marks."""

    number: int  # 1 for the first picture of a run, then rising
    stamp: float  # s, mid-exposure, on the source's own clock
    format: PictureFormat
    width: int  # px
    height: int  # px
    pixels: bytes | memoryview  # rows without padding, or a JPEG file
    annotations: dict[str, Any] | None  # described in docs/control.md


class PictureRing:
    """The writer's side. One thread writes; any thread may call `duplicate`."""

    def __init__(self, slot_bytes: int, slots: int = 3) -> None:
        """Allocate memory for `slots` pictures of `slot_bytes` (B, with annotations).

        Raises ControlError if the system has no such memory.
        """
        self.slots, self.slot_bytes = slots, -(-slot_bytes // 8) * 8
        self._order = _Order()
        self._closing = threading.Lock()
        size = _HEADER_BYTES + slots * (_SLOT_HEADER_BYTES + self.slot_bytes)
        self._file: int | None = None
        try:
            self._file = os.memfd_create("spheremouse-pictures", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
            os.ftruncate(self._file, size)
            self._map = mmap.mmap(self._file, size)
            _seal(self._file)
        except (AttributeError, OSError) as e:
            if self._file is not None:
                os.close(self._file)
            reason = "needs Linux" if isinstance(e, AttributeError) else e.strerror
            raise ControlError(f"pictures: no shared memory of {size} bytes: {reason}") from None
        self._numbers = memoryview(self._map).cast("Q")
        self._numbers[_SLOTS], self._numbers[_SLOT_BYTES] = slots, self.slot_bytes
        self._numbers[0] = _MAGIC

    def write(self, picture: LivePicture) -> bool:
        """Copy a picture with a higher number into the oldest slot. Return False if it does not fit."""
        given = picture.annotations
        annotations = b"" if given is None else json.dumps(given, separators=(",", ":"), allow_nan=False).encode()
        pixels = picture.pixels
        if len(pixels) + len(annotations) > self.slot_bytes:
            return False
        at = _slot_at(picture.number, self.slots, self.slot_bytes)
        begin = at + _SLOT_HEADER_BYTES
        middle, end = begin + len(pixels), begin + len(pixels) + len(annotations)
        kind = _FORMATS.index(picture.format)
        self._numbers[at // 8] = picture.number
        self._order()
        size = picture.width, picture.height, len(pixels), len(annotations)
        _FIELDS.pack_into(self._map, at + _FIELDS_AT, picture.stamp, kind, *size, 0)
        self._map[begin:middle] = pixels
        self._map[middle:end] = annotations
        self._order()
        self._numbers[at // 8 + 1] = self._numbers[_NEWEST] = picture.number
        return True

    def duplicate(self) -> int:
        """Return a new descriptor of the memory, for another process. Raises ControlError after `close`."""
        with self._closing:
            if self._file is None:
                raise ControlError("pictures: the memory is being replaced", "ask again")
            return os.dup(self._file)

    def close(self) -> None:
        """Free the memory when the last reader has closed it."""
        with self._closing:
            if self._file is None:
                return
            os.close(self._file)
            self._file = None
        self._numbers.release()
        self._map.close()


class PictureReader:
    """The reader's side, in any process."""

    def __init__(self, file: int) -> None:
        """Map the memory, and close the descriptor. Raises ControlError if it has another form."""
        try:
            self._map = mmap.mmap(file, 0, mmap.MAP_SHARED, mmap.PROT_READ)
        except (OSError, ValueError):
            raise ControlError("pictures: the daemon's memory cannot be mapped") from None
        finally:
            os.close(file)
        self._order = _Order()
        with memoryview(self._map) as data:
            self._numbers = data[: len(data) // 8 * 8].cast("Q")
        known = len(self._map) >= _HEADER_BYTES and self._numbers[0] == _MAGIC
        self.slots, self.slot_bytes = (self._numbers[k] if known else 0 for k in (_SLOTS, _SLOT_BYTES))
        if not known or len(self._map) < _HEADER_BYTES + self.slots * (_SLOT_HEADER_BYTES + self.slot_bytes):
            self.close()
            raise ControlError("pictures: the daemon has another version", "restart it")

    def latest(self, after: int = 0) -> LivePicture | None:
        """Return a copy of the newest picture; None if its number is not above `after`, or it was being overwritten."""
        for _ in range(_MAX_READ_ATTEMPTS):
            number = self._numbers[_NEWEST]
            if number <= after:
                return None
            at = _slot_at(number, self.slots, self.slot_bytes)
            if self._numbers[at // 8 + 1] != number:
                continue
            self._order()
            copied = self._copy(at)
            self._order()
            if copied is not None and self._numbers[at // 8] == number:
                stamp, kind, width, height, pixels, annotations = copied
                marks = orjson.loads(annotations) if annotations else None
                return LivePicture(number, stamp, _FORMATS[kind], width, height, pixels, marks)
        return None

    def close(self) -> None:
        """Unmap the memory."""
        self._numbers.release()
        self._map.close()

    def _copy(self, at: int) -> tuple[float, int, int, int, bytes, bytes] | None:
        """Return the contents of a slot, which may be inconsistent; None if a length is impossible."""
        stamp, kind, width, height, pixels, annotations, _ = _FIELDS.unpack_from(self._map, at + _FIELDS_AT)
        if pixels + annotations > self.slot_bytes:
            return None
        begin = at + _SLOT_HEADER_BYTES
        middle = begin + pixels
        return stamp, kind, width, height, self._map[begin:middle], self._map[middle : middle + annotations]


class _Order:
    """A memory barrier: other processes see the writes before a call before those after it.

    Python has none, and some processors (ARM) reorder writes. A lock's release and acquisition are one.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lock.acquire()

    def __call__(self) -> None:
        self._lock.release()
        self._lock.acquire()


def _slot_at(number: int, slots: int, slot_bytes: int) -> int:
    return _HEADER_BYTES + number % slots * (_SLOT_HEADER_BYTES + slot_bytes)


def _seal(file: int) -> None:
    """Forbid everybody to change the size, which would kill the writer, and other processes to write."""
    import fcntl  # not on every system that can import this

    fcntl.fcntl(file, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
    with suppress(OSError):  # an older kernel: readers could damage pictures, and nothing else
        fcntl.fcntl(file, fcntl.F_ADD_SEALS, _F_SEAL_FUTURE_WRITE)
    fcntl.fcntl(file, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SEAL)
