"""The guide through a calibration: the contents of its folder, the next step, and its command."""
