# spheremouse firmware
"""What the board is to the computer, said before USB begins: a mouse, a console, a serial port for data, a drive.

A jumper from GP22 to GND (pins 29 and 28 of a Pico) leaves console and drive out.
"""

import board
import digitalio
import storage
import supervisor
import usb_cdc
import usb_hid
import usb_midi
from mouse import DESCRIPTOR, FEATURE_LENGTH, MOUSE, MULTIPLIERS, REPORT_LENGTH

hidden = False
if hasattr(board, "GP22"):
    pin = digitalio.DigitalInOut(board.GP22)
    pin.switch_to_input(digitalio.Pull.UP)
    hidden = not pin.value
    pin.deinit()

supervisor.set_usb_identification("spheremouse", "spheremouse")  # `serial:auto` looks for this product
usb_midi.disable()
if hidden:
    storage.disable_usb_drive()
usb_cdc.enable(console=not hidden, data=True)
usb_hid.enable(
    (
        usb_hid.Device(
            report_descriptor=DESCRIPTOR,
            usage_page=0x01,
            usage=0x02,
            report_ids=(MOUSE, MULTIPLIERS),
            in_report_lengths=(REPORT_LENGTH, 0),
            out_report_lengths=(0, FEATURE_LENGTH),  # CircuitPython hands features over like output reports
        ),
    )
)
