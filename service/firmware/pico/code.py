# spheremouse firmware
"""The board's program: finds its hardware, starts the watchdog, and turns the loop of mouse.py for ever."""

import board
import busio
import digitalio
import microcontroller
import supervisor
import usb_cdc
import usb_hid
from mouse import Mouse
from protocol import CIRCUITPYTHON
from watchdog import WatchDogMode

supervisor.runtime.autoreload = False
if supervisor.runtime.run_reason != supervisor.RunReason.STARTUP:
    microcontroller.reset()  # else the computer thinks its resolution multipliers are still set
if usb_cdc.data is None:
    raise RuntimeError("boot.py has not run yet: unplug the board and plug it in again")

led = digitalio.DigitalInOut(board.LED) if hasattr(board, "LED") else None  # some boards have a coloured one only
if led is not None:
    led.switch_to_output(False)
usb_cdc.data.timeout = 0
usb_cdc.data.write_timeout = 0
uart = None
if hasattr(board, "GP0"):
    uart = busio.UART(board.GP0, board.GP1, baudrate=115200, timeout=0, receiver_buffer_size=512)
name = board.board_id[13:] if board.board_id.startswith("raspberry_pi_") else board.board_id
mouse = Mouse(CIRCUITPYTHON, name.encode(), usb_hid.devices[0], usb_cdc.data, uart, led, supervisor.runtime)

dog = microcontroller.watchdog
dog.timeout = 5  # s; a sleeping computer can hold a report for two
dog.mode = WatchDogMode.RESET
ticks, turn, feed = supervisor.ticks_ms, mouse.turn, dog.feed
while True:
    turn(ticks())
    feed()
