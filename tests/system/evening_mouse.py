"""What a mouse of the kernel says from now on until it rests, beside the truth, as a table.

    python evening_mouse.py ATTITUDE

ATTITUDE: a file of R_obj_ball, (n, 3, 3), of the pictures that are shown. The player stands on the far side.
"""

import select
import sys
from itertools import pairwise

import evdev
import numpy as np

from spheremouse.geometry.rotation import log

COUNTS = 600.0  # per radian: the default
REST = 20.0  # s without an event
DIRECTIONS = (("right", 0, 2, 1.0), ("down", 1, 0, -1.0))  # evdev's code, axis of obj, sign: Z goes right, X goes up


def main() -> None:
    (mouse,) = (d for d in map(evdev.InputDevice, evdev.list_devices()) if d.name == "spheremouse")
    sums, patience = {0: 0, 1: 0}, 60.0
    while select.select([mouse], [], [], patience)[0]:
        for event in mouse.read():
            if event.type == evdev.ecodes.EV_REL and event.code in sums:
                sums[event.code] += event.value
                patience = REST
    turns = [log(b @ a.T) for a, b in pairwise(np.load(sys.argv[1]))]
    truth, path = np.sum(turns, axis=0), np.abs(turns).sum(axis=0)
    print(f"{mouse.path}: {mouse.name}")
    for name, code, axis, sign in DIRECTIONS:
        true, way = COUNTS * sign * truth[axis], COUNTS * path[axis]
        print(f"{name:>5}: {sums[code]:+6d} counts; the ball's own motion: {true:+8.1f}, there and back {way:.0f}")


if __name__ == "__main__":
    main()
