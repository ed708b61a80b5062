"""The folder of a calibration: names of its files, and its place if no folder is named.

The live page reads it, and loads no OpenCV.
"""

from pathlib import Path

BOARD, DEVICE = "board", "device"  # folders of photos
CAMERA_FILE, DEVICE_FILE, RIG_FILE, CONFIG_FILE = "camera.yaml", "device.yaml", "rig.yaml", "config.yaml"

DEFAULT = Path("cabinet")


def default_folder() -> Path:
    """Return the folder meant if none is named: the current one if it has contents, else `cabinet`."""
    has_contents = any(Path(name).exists() for name in (DEVICE_FILE, CAMERA_FILE, BOARD))
    return Path() if has_contents and not DEFAULT.exists() else DEFAULT
