"""An evening of calibration as its folder shows it: what is there, what is next, and with which command."""
