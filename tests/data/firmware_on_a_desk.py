"""The Pico's firmware under MicroPython, with stand-ins for its hardware; driven by tests/firmware_driver.mjs."""

import gc
import json
import sys

from mouse import MOUSE, Mouse
from protocol import CIRCUITPYTHON


class Port:
    """A serial port: `came` is what the host wrote, `went` what the board wrote, both without allocating."""

    connected = True
    out_waiting = 0

    def __init__(self):
        self.came, self.at, self.in_waiting = b"", 0, 0
        self.went, self.length = bytearray(16384), 0

    def fill(self, data):
        self.came, self.at, self.in_waiting = data, 0, len(data)

    def readinto(self, buffer):
        count = min(len(buffer), self.in_waiting)
        k = 0
        while k < count:
            buffer[k] = self.came[self.at + k]
            k += 1
        self.at += count
        self.in_waiting -= count
        return count

    def write(self, data):
        k = 0
        while k < len(data):
            self.went[self.length + k] = data[k]
            k += 1
        self.length += len(data)
        return len(data)

    def empty(self):
        data, self.length = bytes(self.went[: self.length]), 0
        return data


class Hid:
    def __init__(self):
        self.moved, self.buttons, self.refuses, self.feature = [0, 0, 0, 0], 0, False, None
        self.nods_off = False  # while the next report waits
        self.tries = 0

    def get_last_received_report(self, report_id):
        feature = self.feature
        self.feature = None
        return feature

    def send_report(self, report, report_id):
        self.tries += 1
        if self.refuses:
            raise OSError
        if self.nods_off:  # CircuitPython asks to wake the computer up, and returns as if all were well
            self.nods_off = runtime.usb_connected = False
            return
        assert report_id == MOUSE
        k = 0
        while k < 4:
            value = report[1 + 2 * k] | report[2 + 2 * k] << 8
            self.moved[k] += value - 0x10000 if value & 0x8000 else value
            k += 1
        self.buttons = report[0]


class Led:
    value = False


class Runtime:
    usb_connected = True


port, hid, led, runtime, mouse = Port(), Hid(), Led(), Runtime(), None


def boot():
    global mouse  # noqa: PLW0603
    hid.buttons = 0
    mouse = Mouse(CIRCUITPYTHON, b"desk", hid, port, None, led, runtime)


def turn(text):
    """One command of the test: bytes that came at a time, and what they lead to; JSON in, JSON out."""
    asked = json.loads(text)
    if asked.get("reset"):
        boot()
    if "feature" in asked:
        hid.feature = bytes([asked["feature"]])
    hid.refuses = asked.get("refuses", hid.refuses)
    hid.nods_off = asked.get("nods_off", hid.nods_off)
    runtime.usb_connected = asked.get("usb", runtime.usb_connected)
    port.fill(bytes.fromhex(asked.get("bytes", "")))
    mouse.turn(asked["now"])
    while port.in_waiting:
        mouse.turn(asked["now"])
    return json.dumps(
        {"bytes": port.empty().hex(), "moved": hid.moved, "buttons": hid.buttons, "led": led.value, "tries": hid.tries}
    )


def moved(text):
    return json.dumps(hid.moved)


def allocated(text):
    """Bytes of the heap that handling these bytes takes, 1 ms between each `step` of them."""
    asked = json.loads(text)
    data, step = bytes.fromhex(asked["bytes"]), asked["step"]
    pieces = [data[k : k + step] for k in range(0, len(data), step)]
    now, before = asked["now"], 0
    gc.collect()
    gc.disable()
    before = gc.mem_alloc()
    k = 0
    while k < len(pieces):
        port.came = pieces[k]
        port.at = 0
        port.in_waiting = len(port.came)
        port.length = 0
        mouse.turn(now)
        while port.in_waiting:
            mouse.turn(now)
        now += 1
        k += 1
    after = gc.mem_alloc()
    gc.enable()
    return json.dumps({"bytes": after - before, "moved": hid.moved})


def version(text):
    return json.dumps([sys.implementation.name, list(sys.implementation.version[:3])])


boot()
