# spheremouse firmware
"""Frames in, frames and mouse reports out: the device's end of docs/protocol.md, as arithmetic without hardware.

Runs under CircuitPython, MicroPython and CPython alike. Nothing is allocated after construction: buffers have their
final size, session numbers are bytes, no integer leaves the 31 bits that a small board holds without the heap, and no
tuple is made to assign several names at once. Time comes in as milliseconds modulo 2^29, as `supervisor.ticks_ms` gives
it.
"""

from array import array

from frames import VERSION, Line, seal  # noqa: F401  for users of this module, Line too

FIRMWARE = (1, 0, 0)
HELLO, MOTION, ASK_STATUS, STOP = 0x01, 0x02, 0x03, 0x04
IDENTITY, ACK, STATUS = 0x81, 0x82, 0x83
CIRCUITPYTHON, AVR, SIMULATOR = 1, 2, 3
STEP = 1200  # counts: 600 per radian x 20 rad/s x SILENCE
SILENCE = 100  # ms
NOTCH = 120  # wheel and pan units of one notch
RUNNING, TOO_LARGE, USB_READY, WHEEL_FINE, PAN_FINE = 0x01, 0x02, 0x04, 0x08, 0x10

_TICKS = 0x1FFFFFFF
_COUNT = 0x3FFFFFFF
_HELLO_LENGTH, _MOTION_LENGTH, _BARE_LENGTH = 12, 17, 8


def elapsed(now, since):
    """Milliseconds from one tick to a later one."""
    return (now - since) & _TICKS


def signed(difference):
    """A difference modulo 2^16 as a number from -32768 to 32767."""
    difference &= 0xFFFF
    return difference - 0x10000 if difference & 0x8000 else difference


class Device:
    """The mouse: sessions, counters, buttons; what is due as a HID report, and what to answer."""

    def __init__(self, kind, board):
        """`board`: its name, ASCII bytes."""
        self.running = False
        self.buttons = 0  # asked for
        self.reported = 0  # of the last report
        self.usb_ready = False  # by `set_usb`
        self.untold = False  # the computer was away, and may have forgotten the buttons
        self.fine = 0  # resolution multipliers: bit 0 wheel, bit 1 pan
        self.report = bytearray(9)
        self.refused = self.lost = 0  # modulo 2^16
        self.frames = self.reports = 0  # modulo 2^30
        self.usb_errors = 0  # modulo 2^16
        self.uptime = 0  # s
        self.troubled = -1  # ticks of the last frame that was damaged, refused or lost; -1: none
        self._line = None  # of the session
        self._taken = False  # a MOTION, in this session
        self._heard = 0  # ticks
        self._second = -1  # ticks
        self._session, self._last, self._first = bytearray(4), bytearray(4), bytearray(4)
        self._target, self._passed, self._last_passed = array("H", [0] * 4), array("H", [0] * 4), array("H", [0] * 4)
        self._due = array("h", [0] * 4)  # in `report`
        self._notch = array("i", [0] * 4)  # 1/120 notches collected; wheel and pan
        self._identity, self._ack, self._status = bytearray(54), bytearray(25), bytearray(36)
        self._identity[2], self._ack[2], self._status[2] = IDENTITY, ACK, STATUS
        self._board = bytearray(16)
        self._board[: min(16, len(board))] = board[:16]
        self._kind = kind

    # ---- in ----

    def handle(self, line, now):
        """Obey the whole frame that `line` has taken."""
        content = line.content
        length = line.length
        kind = content[1]
        if length == _HELLO_LENGTH and kind == HELLO and content[0] != VERSION:
            self._damaged(line)
            self._owe_identity(line, False)
            return
        expected = _HELLO_LENGTH if kind == HELLO else _MOTION_LENGTH if kind == MOTION else _BARE_LENGTH
        if content[0] != VERSION or length != expected or kind == 0 or kind > STOP:
            self._damaged(line)
            return
        self.frames = (self.frames + 1) & _COUNT
        number = content[2] | content[3] << 8
        newer = False
        ours = kind != HELLO or self._is_session(line, self._session)
        if self.running and ours and line is self._line:
            gap = (number - line.last - 1) & 0xFFFF
            newer = gap < 0x7FFF
            if newer:
                line.last = number
                if gap:
                    self.lost = (self.lost + gap) & 0xFFFF
                    self.troubled = now
        if kind == HELLO:
            self._hello(line, number, now)
        elif kind == MOTION:
            self._motion(line, number, newer, now)
        elif kind == STOP:
            if line is self._line:
                self._end()
            self._owe_ack(line, number)
        else:
            line.owes_status = True

    def worry(self, line, now):
        """Frames came damaged on this line. Where another has the session, that is the noise of an open pin."""
        if line is self._line or not self.running:
            self.troubled = now

    def tick(self, now):
        """Let time pass: silence ends the session."""
        if self.running and elapsed(now, self._heard) >= SILENCE:
            self._end()
        if self._second < 0:
            self._second = now
        while elapsed(now, self._second) >= 1000:
            self._second = (self._second + 1000) & _TICKS
            self.uptime = (self.uptime + 1) & _COUNT

    def _hello(self, line, number, now):
        if self.running and self._is_session(line, self._session):
            if line is not self._line:  # the host has come back by another way
                self._line = line
                line.last = number
            self._owe_identity(line, True)
            return
        if not _any(line.content, 4) or self._is_session(line, self._last):
            self._refuse(now)
            return
        self._end()
        if not _any(self._first, 0):
            self._keep_session(line, self._first)
        self._keep_session(line, self._session)
        for k in range(4):
            self._target[k] = self._passed[k] = 0
        self._line = line
        self._heard = now
        self.running = True
        self._taken = False
        line.last = number
        line.owes_ack = False
        self._owe_identity(line, True)

    def _motion(self, line, number, newer, now):
        self._owe_ack(line, number)
        if not newer:
            self._refuse(now)
            return
        content = line.content
        passed = self._passed
        for k in range(4):
            step = signed((content[4 + 2 * k] | content[5 + 2 * k] << 8) - passed[k])
            if step > STEP or step < -STEP:
                self._refuse(now)
                self._end()
                line.too_large = True
                return
        for k in range(4):
            self._target[k] = content[4 + 2 * k] | content[5 + 2 * k] << 8
        self.buttons = content[12] & 0x1F
        self._heard = now
        self._taken = True

    def _end(self):
        if not self.running:
            return
        self.running = False
        self.buttons = 0
        for k in range(4):
            self._target[k] = self._passed[k]
            if self._taken:
                self._last[k] = self._session[k]
                self._last_passed[k] = self._passed[k]

    def _refuse(self, now):
        self.refused = (self.refused + 1) & 0xFFFF
        self.troubled = now

    def _damaged(self, line):
        line.damaged = (line.damaged + 1) & 0xFFFF

    def _is_session(self, line, session):
        for k in range(4):  # noqa: SIM110  all() would make a generator
            if line.content[4 + k] != session[k]:
                return False
        return True

    def _keep_session(self, line, session):
        for k in range(4):
            session[k] = line.content[4 + k]

    # ---- to USB ----

    def set_usb(self, ready):
        """Note whether USB takes reports. A computer that returns gets the buttons again."""
        if not ready and self.reports:
            self.untold = True
        self.usb_ready = ready

    def due(self):
        """Return whether `report` must be sent now. After sending, call `passed_on`."""
        if not self.usb_ready:
            return False
        report = self.report
        due = self._due
        target = self._target
        passed = self._passed
        notch = self._notch
        send = self.untold or self.buttons != self.reported
        report[0] = self.buttons
        for k in range(4):
            step = signed(target[k] - passed[k])
            due[k] = step
            if k >= 2 and not self.fine >> (k - 2) & 1:
                notch[k] += step
                passed[k] = target[k]
                step = notch[k] // NOTCH if notch[k] >= 0 else -(-notch[k] // NOTCH)
                due[k] = step
            if step:
                send = True
            report[1 + 2 * k] = step & 255
            report[2 + 2 * k] = step >> 8 & 255
        return send

    def passed_on(self):
        """USB has taken `report`."""
        self.untold = False
        self.reported = self.report[0]
        self.reports = (self.reports + 1) & _COUNT
        for k in range(4):
            if k >= 2 and not self.fine >> (k - 2) & 1:
                self._notch[k] -= self._due[k] * NOTCH
            else:
                self._passed[k] = (self._passed[k] + self._due[k]) & 0xFFFF

    def not_passed_on(self):
        """USB has not."""
        self.usb_errors = (self.usb_errors + 1) & 0xFFFF

    def set_multipliers(self, feature):
        """The byte of report 2: bits 0 and 1 the wheel's multiplier, bits 2 and 3 that of pan."""
        self.fine = (1 if feature & 3 else 0) | (2 if feature >> 2 & 3 else 0)

    # ---- out ----

    def answer(self, line):
        """The next frame to write to `line`, or None."""
        if line.owes_identity:
            line.owes_identity = False
            frame = self._fill_identity(line)
        elif line.owes_status:
            line.owes_status = False
            frame = self._fill_status(line)
        elif line.owes_ack:
            line.owes_ack = False
            frame = self._fill_ack(line)
        else:
            return None
        frame[1] = VERSION
        frame[2] = IDENTITY if frame is self._identity else STATUS if frame is self._status else ACK
        seal(frame, line.sent)
        line.sent = (line.sent + 1) & 0xFFFF
        return frame

    def _owe_identity(self, line, echo):
        for k in range(4):
            line.hello[k] = line.content[4 + k] if echo else 0
        line.owes_identity = True

    def _owe_ack(self, line, number):
        line.answered = number
        line.too_large = False
        line.owes_ack = True

    def _flags(self, line):
        return (
            (RUNNING if self.running and line is self._line else 0)
            | (USB_READY if self.usb_ready else 0)
            | (WHEEL_FINE if self.fine & 1 else 0)
            | (PAN_FINE if self.fine & 2 else 0)
        )

    def _fill_identity(self, line):
        frame = self._identity
        for k in range(4):
            frame[5 + k] = line.hello[k]
            frame[9 + k] = self._last[k]
            _put(frame, 13 + 2 * k, self._last_passed[k])
            frame[21 + k] = self._first[k]
        _put(frame, 25, STEP)
        _put(frame, 27, SILENCE)
        for k in range(3):
            frame[29 + k] = FIRMWARE[k]
        frame[32] = self._kind
        for k in range(16):
            frame[33 + k] = self._board[k]
        return frame

    def _fill_ack(self, line):
        frame = self._ack
        _put(frame, 5, line.answered)
        for k in range(4):
            _put(frame, 7 + 2 * k, self._passed[k])
        frame[15] = self._flags(line) | (TOO_LARGE if line.too_large else 0)
        _put(frame, 16, self.refused)
        _put(frame, 18, self.lost)
        return frame

    def _fill_status(self, line):
        frame = self._status
        for k in range(4):
            frame[5 + k] = self._session[k] if self.running else 0
        _put(frame, 9, self.uptime & 0xFFFF)
        _put(frame, 11, self.uptime >> 16)
        _put(frame, 13, self.frames & 0xFFFF)
        _put(frame, 15, self.frames >> 16)
        _put(frame, 17, line.damaged)
        _put(frame, 19, self.refused)
        _put(frame, 21, self.lost)
        _put(frame, 23, self.reports & 0xFFFF)
        _put(frame, 25, self.reports >> 16)
        _put(frame, 27, self.usb_errors)
        frame[29] = self._flags(line)
        frame[30] = self.reported
        return frame


def _put(frame, at, value):
    frame[at] = value & 255
    frame[at + 1] = value >> 8


def _any(data, at):
    return data[at] or data[at + 1] or data[at + 2] or data[at + 3]
