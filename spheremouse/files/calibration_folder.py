"""Names of the files of a calibration, and its usual folder. The live page reads this without OpenCV."""

from pathlib import Path

BOARD, DEVICE = "board", "device"  # folders of photos
CAMERA_FILE, DEVICE_FILE, RIG_FILE, CONFIG_FILE = "camera.yaml", "device.yaml", "rig.yaml", "config.yaml"

DEFAULT = Path("cabinet")


def default_folder() -> Path:
    """Return the folder meant if none is named: the current one if it has contents, else `cabinet`."""
    has_contents = any(Path(name).exists() for name in (DEVICE_FILE, CAMERA_FILE, BOARD))
    return Path() if has_contents and not DEFAULT.exists() else DEFAULT
