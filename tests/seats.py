"""Where a player may stand, and the way they look from there, in obj, whose camera is at +Z."""

LOOKS = {"far-side": (0, 0, 1), "camera-side": (0, 0, -1), "left": (1, 0, 0), "right": (-1, 0, 0)}
