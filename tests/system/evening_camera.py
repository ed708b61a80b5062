"""A camera's other side: writes films to a v4l2loopback device, and rests on the last picture of each.

    python evening_camera.py NODE WxH FIRST PIPE

FIRST, and what comes through PIPE, a line each: a file of YUYV pictures and the seconds that each is shown; or without
seconds, and `next` shows its next picture, after the last the first. Pictures are written five times a second, since a
camera whose scene stands still goes on filming.
"""

import os
import select
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np
from linuxpy.video.device import BufferType, Device

INTERVAL = 0.2  # s
FOREVER = 1e9  # s


def main() -> None:
    """Write until PIPE says `end`."""
    node, size, first, fifo = sys.argv[1:]
    width, height = map(int, size.split("x"))
    device = Device.from_id(int(node))
    device.open()
    device.set_format(BufferType.VIDEO_OUTPUT, width, height, "YUYV")
    pipe = os.open(fifo, os.O_RDWR)  # it never ends, as it has a writer
    told, seconds = False, []
    reader, coming = ThreadPoolExecutor(1), None  # the old scene is shown until the new one has been read
    pictures, hold, began, ahead, line = film(first, width, height), FOREVER, time.monotonic(), 0, ""
    while line != "end":
        if coming is not None and coming.done():
            pictures, coming, began, ahead = coming.result(), None, time.monotonic(), 0
            hold = float(seconds[0]) if seconds else FOREVER
        if hold < FOREVER:  # none is left out, however slow the guest is
            ahead = min(ahead + (time.monotonic() - began > hold * (ahead + 1)), len(pictures) - 1)
        k = ahead % len(pictures)
        os.write(device.fileno(), pictures[k].tobytes())
        if not told:
            told = True
            print("writing", flush=True)
        if select.select([pipe], [], [], min(INTERVAL, hold))[0]:
            line = os.read(pipe, 4096).decode().strip()
            if line == "next":
                ahead += 1
            elif line != "end":
                path, *seconds = line.split()
                coming = reader.submit(film, path, width, height)
    device.close()


@lru_cache(1)
def film(path: str, width: int, height: int) -> np.ndarray:
    """(n, bytes of a picture): read beforehand, since a guest reads slowly."""
    return np.fromfile(path, np.uint8).reshape(-1, 2 * width * height)


if __name__ == "__main__":
    main()
