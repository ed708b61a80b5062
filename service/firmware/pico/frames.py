# spheremouse firmware
"""Frames of docs/protocol.md: bytes of a serial line to contents, and contents to bytes.

As in protocol.py, nothing is allocated after construction, and the CRC is two 16-bit halves.
"""

from array import array

VERSION = 1
MOST = 64  # bytes of content
_LEAST = 8  # bytes of content: header and CRC


def _tables():
    low, high = array("H", [0] * 256), array("H", [0] * 256)
    for k in range(256):
        crc = k
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
        low[k], high[k] = crc & 0xFFFF, crc >> 16
    return low, high


_LOW, _HIGH = _tables()


def seal(frame, number):
    """Make a frame of a buffer that has its version, type and body at 1, 2 and 5 ...: number, CRC, COBS, end."""
    end = len(frame) - 5  # of what the CRC covers
    frame[3] = number & 255
    frame[4] = number >> 8
    low = high = 0xFFFF
    at = 1
    while at < end:
        k = (low ^ frame[at]) & 255
        low = (low >> 8 | (high & 255) << 8) ^ _LOW[k]
        high = high >> 8 ^ _HIGH[k]
        at += 1
    low ^= 0xFFFF
    high ^= 0xFFFF
    frame[end] = low & 255
    frame[end + 1] = low >> 8
    frame[end + 2] = high & 255
    frame[end + 3] = high >> 8
    last = len(frame) - 1
    code = 0
    at = 1
    while at < last:
        if frame[at] == 0:
            frame[code] = at - code
            code = at
        at += 1
    frame[code] = last - code
    frame[last] = 0


class Line:
    """One serial line: what has come in of the frame that is under way, and what has to be answered."""

    def __init__(self):
        self.content = bytearray(MOST)  # of the last whole frame, CRC included
        self.length = 0  # of it; 0: `take` has found none
        self.sent = 0  # number of the next frame from here
        self.last = 0  # number of the last frame that came in this line's session
        self.hello = bytearray(4)  # session to echo
        self.owes_identity = self.owes_status = self.owes_ack = False
        self.answered = 0  # number of the frame that the next ACK answers
        self.too_large = False  # its step was
        self.damaged = 0  # frames
        self._low = self._high = 0xFFFF  # the CRC's halves
        self._length = -1  # so far; -1: the first code byte is to come; above MOST: too long already
        self._left = 0  # bytes until the next code byte

    def take(self, data, at, end):
        """Read data[at:end] up to the end of the next whole frame; where to go on. `length` says if there was one."""
        content = self.content
        low = self._low
        high = self._high
        length = self._length
        left = self._left
        self.length = 0
        while at < end:
            byte = data[at]
            at += 1
            if byte == 0:
                whole = left == 0 and low == 0x20E3 and high == 0xDEBB and _LEAST <= length <= MOST
                if not whole and length >= 0:
                    self.damaged = (self.damaged + 1) & 0xFFFF
                found = length
                low = high = 0xFFFF
                length = -1
                left = 0
                if whole:
                    self.length = found
                    break
                continue
            if length > MOST:
                continue
            if left:
                left -= 1
            else:
                left = byte - 1
                if length < 0:
                    length = 0
                    continue
                byte = 0
            if length < MOST:
                content[length] = byte
                k = (low ^ byte) & 255
                low = (low >> 8 | (high & 255) << 8) ^ _LOW[k]
                high = high >> 8 ^ _HIGH[k]
            length += 1
        self._low = low
        self._high = high
        self._length = length
        self._left = left
        return at
