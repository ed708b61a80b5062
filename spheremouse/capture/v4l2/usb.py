"""Reset the USB device of a camera, as unplugging does.

Some cameras answer with protocol errors after they were plugged in again, until they are reset.
"""

import fcntl
import os
from pathlib import Path

from spheremouse.capture.nodes import VIDEO_CLASS

_USBDEVFS_RESET = 0x5514  # linux/usbdevice_fs.h: _IO('U', 20)


def reset_camera(path: str, listed: Path = VIDEO_CLASS, bus: Path = Path("/dev/bus/usb")) -> str:
    """Reset the USB device behind the node `path`, and return a line for the log that names the device."""
    device = usb_device(listed / Path(path).resolve().name)
    if device is None:
        return f"{path}: is no USB camera, so there is nothing to reset"
    number, address = (int((device / name).read_text()) for name in ("busnum", "devnum"))
    node = bus / f"{number:03}" / f"{address:03}"
    product = device / "product"
    name = f"{node} ({product.read_text().strip()})" if product.is_file() else f"{node}"
    try:
        fd = os.open(node, os.O_WRONLY | os.O_CLOEXEC)
        try:
            fcntl.ioctl(fd, _USBDEVFS_RESET, 0)
        finally:
            os.close(fd)
    except OSError as e:
        return (
            f"{path}: its USB device {name} cannot be reset ({e.strerror}); plug it in again, or allow it, as root: "
            "spheremouse service install"
        )
    return f"{path}: its USB device {name} was reset, because it answered with errors"


def usb_device(entry: Path) -> Path | None:
    """Return the sysfs folder of the USB device that an entry of a class in sysfs belongs to; None if to none."""
    device = entry.resolve()
    return next((folder for folder in (device, *device.parents) if (folder / "devnum").is_file()), None)
