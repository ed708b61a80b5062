# spheremouse firmware
"""The mouse and its loop: bytes from the serial lines, through protocol.py, into HID reports; the LED says how it is.

All firmwares have this report descriptor. Hardware comes in as objects, so that this runs on a desk as well.
"""

import protocol

MOUSE, MULTIPLIERS = 1, 2  # report IDs
REPORT_LENGTH, FEATURE_LENGTH = 9, 1  # bytes after the ID
DESCRIPTOR = bytes(
    (
        0x05, 0x01,  # Usage Page (Generic Desktop)
        0x09, 0x02,  # Usage (Mouse)
        0xA1, 0x01,  # Collection (Application)
        0x09, 0x01,  # Usage (Pointer)
        0xA1, 0x00,  # Collection (Physical)
        0x85, MOUSE,  # Report ID
        0x05, 0x09,  # Usage Page (Button)
        0x19, 0x01, 0x29, 0x05,  # Usage Minimum (1), Maximum (5)
        0x15, 0x00, 0x25, 0x01,  # Logical Minimum (0), Maximum (1)
        0x75, 0x01, 0x95, 0x05,  # Report Size (1), Count (5)
        0x81, 0x02,  # Input (Data, Variable, Absolute)
        0x75, 0x03, 0x95, 0x01,  # Report Size (3), Count (1)
        0x81, 0x03,  # Input (Constant)
        0x05, 0x01,  # Usage Page (Generic Desktop)
        0x09, 0x30, 0x09, 0x31,  # Usage (X), Usage (Y)
        0x16, 0x01, 0x80,  # Logical Minimum (-32767)
        0x26, 0xFF, 0x7F,  # Logical Maximum (32767)
        0x75, 0x10, 0x95, 0x02,  # Report Size (16), Count (2)
        0x81, 0x06,  # Input (Data, Variable, Relative)
        0xA1, 0x02,  # Collection (Logical)
        0x85, MULTIPLIERS,  # Report ID
        0x09, 0x48,  # Usage (Resolution Multiplier)
        0x15, 0x00, 0x25, 0x01,  # Logical Minimum (0), Maximum (1)
        0x35, 0x01, 0x45, protocol.NOTCH,  # Physical Minimum (1), Maximum (120)
        0x75, 0x02, 0x95, 0x01,  # Report Size (2), Count (1)
        0xB1, 0x02,  # Feature (Data, Variable, Absolute)
        0x85, MOUSE,  # Report ID
        0x09, 0x38,  # Usage (Wheel)
        0x16, 0x01, 0x80, 0x26, 0xFF, 0x7F,  # Logical Minimum (-32767), Maximum (32767)
        0x35, 0x00, 0x45, 0x00,  # Physical Minimum, Maximum: as logical
        0x75, 0x10,  # Report Size (16)
        0x81, 0x06,  # Input (Data, Variable, Relative)
        0xC0,  # End Collection
        0xA1, 0x02,  # Collection (Logical)
        0x85, MULTIPLIERS,  # Report ID
        0x09, 0x48,  # Usage (Resolution Multiplier)
        0x15, 0x00, 0x25, 0x01,  # Logical Minimum (0), Maximum (1)
        0x35, 0x01, 0x45, protocol.NOTCH,  # Physical Minimum (1), Maximum (120)
        0x75, 0x02,  # Report Size (2)
        0xB1, 0x02,  # Feature (Data, Variable, Absolute)
        0x35, 0x00, 0x45, 0x00,  # Physical Minimum, Maximum: as logical
        0x75, 0x04,  # Report Size (4)
        0xB1, 0x03,  # Feature (Constant)
        0x85, MOUSE,  # Report ID
        0x05, 0x0C,  # Usage Page (Consumer)
        0x0A, 0x38, 0x02,  # Usage (AC Pan)
        0x16, 0x01, 0x80, 0x26, 0xFF, 0x7F,  # Logical Minimum (-32767), Maximum (32767)
        0x75, 0x10,  # Report Size (16)
        0x81, 0x06,  # Input (Data, Variable, Relative)
        0xC0,  # End Collection
        0xC0,  # End Collection
        0xC0,  # End Collection
    )
)  # fmt: skip

_TROUBLE = 300  # ms that the LED flickers after a frame that was damaged, lost or refused
_PAUSE = 5000  # ms from one report that the computer did not fetch to the next try: CircuitPython waits 2000 of them
_UART_ANSWERS = 4  # ms between two answers on a UART, whose writing waits for the line


class Mouse:
    """Serial lines in, one mouse out. `turn` is the loop's body and allocates nothing."""

    def __init__(self, kind, board, hid, usb, uart, led, runtime):
        """`usb`: data port; `uart`: may be None; `runtime` has `usb_connected`; `led`: has `value`, may be None."""
        self.device = protocol.Device(kind, board)
        self._hid, self._usb, self._uart, self._led, self._runtime = hid, usb, uart, led, runtime
        self._usb_line, self._uart_line = protocol.Line(), protocol.Line()
        self._buffer = bytearray(128)
        self._answered = 0
        self._connected = False
        self._unfetched = -1  # ticks of a report that the computer did not fetch; -1: it does
        self._lit = False

    def turn(self, now):
        """Read, move, answer; `now` in ms modulo 2^29."""
        device = self.device
        self._read(self._usb, self._usb_line, now)
        if self._uart is not None:
            self._read(self._uart, self._uart_line, now)
        device.tick(now)
        self._move(now)
        self._answer(now)
        self._show(now)

    def _read(self, port, line, now):
        if not port.in_waiting:
            return
        count = port.readinto(self._buffer)
        if not count:
            return
        damaged = line.damaged
        at = 0
        while at < count:
            at = line.take(self._buffer, at, count)
            if line.length:
                self.device.handle(line, now)
        if line.damaged != damaged:
            self.device.worry(line, now)

    def _move(self, now):
        device = self.device
        connected = self._runtime.usb_connected
        if connected != self._connected or (self._unfetched >= 0 and protocol.elapsed(now, self._unfetched) >= _PAUSE):
            self._connected = connected
            self._unfetched = -1
        if not connected or self._unfetched < 0:
            device.set_usb(connected)
        feature = self._hid.get_last_received_report(MULTIPLIERS)
        if feature is not None:
            device.set_multipliers(feature[0])
        if device.due():
            try:
                self._hid.send_report(device.report, MOUSE)
            except OSError:  # enumerated, and nobody fetches: a BIOS, a system that no program reads mice of
                device.not_passed_on()
                device.usb_ready = False
                self._unfetched = now
            else:
                if self._runtime.usb_connected:
                    device.passed_on()
                else:  # the computer fell asleep while CircuitPython waited for it, which is no error to that
                    device.not_passed_on()

    def _answer(self, now):
        usb = self._usb
        uart = self._uart
        if usb.connected and not usb.in_waiting and not usb.out_waiting:
            frame = self.device.answer(self._usb_line)
            if frame is not None:
                usb.write(frame)
        if uart is not None and not uart.in_waiting and protocol.elapsed(now, self._answered) >= _UART_ANSWERS:
            frame = self.device.answer(self._uart_line)
            if frame is not None:
                self._answered = now
                uart.write(frame)

    def _show(self, now):
        """Dark: no computer. Slow blinking: waits for a session. Steady: runs. Flicker: bad or lost frames."""
        device = self.device
        if not device.usb_ready:
            lit = False
        elif device.troubled >= 0 and protocol.elapsed(now, device.troubled) < _TROUBLE:
            lit = bool(now & 32)
        else:
            device.troubled = -1
            lit = True if device.running else bool(now & 512)
        if lit != self._lit:
            self._lit = lit
            if self._led is not None:
                self._led.value = lit
