"""What the board is to the computer, said before USB begins: a mouse, a console, a serial port for data, a drive."""

import supervisor
import usb_cdc
import usb_hid
import usb_midi
from mouse import DESCRIPTOR, FEATURE_LENGTH, MOUSE, MULTIPLIERS, REPORT_LENGTH

supervisor.set_usb_identification("spheremouse", "spheremouse")  # `serial:auto` looks for this product
usb_midi.disable()
usb_cdc.enable(console=True, data=True)
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
