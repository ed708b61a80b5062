"""The table of docs/camera.md: python docs/camera_figures.py [--write].

What it costs to get luma, and colours, out of a frame as a camera sends it, on this machine in one thread. The frame is
the simulated far scene with noise. `--write` replaces the table of the page.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.capture.v4l2.pixels import FORMATS, Layout, bgr, luma
from spheremouse.files.safe_files import write_atomically
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate

PAGE = Path(__file__).with_name("camera.md")
MARKS = ("<!-- made by docs/camera_figures.py --write -->", "<!-- end -->")
SIZES = ((640, 480), (1280, 720))
QUALITY = 85  # of MJPG
ROUNDS = 200


def payload(image: NDArray[np.uint8], name: str) -> tuple[NDArray[np.uint8], Layout]:
    """An image (h, w, 3) BGR as a camera of that format sends it."""
    h, w = image.shape[:2]
    if name == "MJPG":
        return np.asarray(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]), Layout("MJPG", w, h, 0)
    if name == "GREY":
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8).reshape(-1), Layout("GREY", w, h, w)
    planes = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420), np.uint8)
    y, u, v = planes[:h], planes[h : h + h // 4].reshape(h // 2, w // 2), planes[h + h // 4 :].reshape(h // 2, w // 2)
    if name == "NV12":
        chroma = np.stack([u, v], axis=2).reshape(h // 2, w)
        return np.concatenate([y, chroma]).reshape(-1), Layout("NV12", w, h, w)
    pairs = np.stack([u, v], axis=2).repeat(2, axis=0).reshape(h, w)
    return np.stack([y, pairs], axis=2).reshape(-1), Layout("YUYV", w, h, 2 * w)


def milliseconds(work: Callable[[], object]) -> float:
    """The median of many rounds."""
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def table() -> str:
    """Formats and sizes in Markdown."""
    lines = [
        "| size | format | at 30 Hz, Mbit/s | luma, ms | colours, ms |",
        "| --- | --- | --- | --- | --- |",
    ]
    for size in SIZES:
        made = next(iter(simulate(prepare(SimulationOptions(size=size, noise=3.0)))))
        image = np.ascontiguousarray(made.frame.image)
        for name in FORMATS:
            data, layout = payload(image, name)
            grey, colour = (
                milliseconds(lambda d=data, n=layout: luma(d, n)),
                milliseconds(lambda d=data, n=layout: bgr(d, n)),
            )
            cost = f"{grey:.2f}" if name == "MJPG" else "0 (a view)"
            rate = len(data) * 8 * 30 / 1e6
            lines.append(f"| {size[0]}x{size[1]} | {name} | {rate:.0f} | {cost} | {colour:.2f} |")
            if name != "MJPG":
                assert grey < 0.02, f"{name}: luma took {grey} ms, and is said to be a view"
    return "\n".join(lines)


def main() -> None:
    """Print the table, or write it into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    made = table()
    print(made)
    if arguments.write:
        text = PAGE.read_text(encoding="utf-8")
        before, rest = text.split(MARKS[0])
        after = rest.split(MARKS[1], 1)[1]
        write_atomically(PAGE, f"{before}{MARKS[0]}\n{made}\n{MARKS[1]}{after}")


if __name__ == "__main__":
    main()
