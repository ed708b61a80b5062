"""The figures of docs/recording.md: what recording costs. `python docs/recording_figures.py`, best on an idle machine.

The simulated far camera at 60 Hz with noise, handed over as a worker would; processor time of the whole process less
that of handing over, as a share of one core.
"""

import os
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from spheremouse.session.ball.recorded import ball_subject
from spheremouse.session.record.recorder import Recorder
from spheremouse.session.settings import Configuration, RecordSettings
from spheremouse.session.tracker_adapter import Subject
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.tracker import Frame

FPS, SECONDS = 60.0, 6.0
SIZES = ((640, 480), (1280, 720))


def processor() -> float:
    """s of processor time that this process has taken."""
    spent = os.times()
    return spent.user + spent.system


def measured(images: list[np.ndarray], subject: Subject, settings: RecordSettings, folder: Path) -> str:
    """Record the images at their pace and return the cost in words."""
    recorder = Recorder(folder, subject, settings)
    writer = threading.Thread(target=recorder.write)
    writer.start()
    n, handing, begun, before = round(FPS * SECONDS), [], time.monotonic(), processor()
    for i in range(n):
        time.sleep(max(0.0, begun + i / FPS - time.monotonic()))
        a = time.perf_counter()
        recorder.add(Frame(images[i % len(images)], i / FPS, i))
        handing.append(time.perf_counter() - a)
    recorder.stop()
    writer.join()
    spent = processor() - before
    status = recorder.status()
    assert status.bytes
    assert status.frames
    us = 1e6 * np.array(handing)
    return (
        f"{100 * spent / SECONDS:3.0f} % of a core, {status.bytes / status.frames / 1e3:4.0f} kB a frame, "
        f"{status.dropped} of {n} dropped; handing over {np.median(us):.0f} us (99 %: {np.percentile(us, 99):.0f})"
    )


def main() -> None:
    """A line per size, kind of picture and what is kept."""
    for size in SIZES:
        made = prepare(SimulationOptions(motion="play", seconds=0.5, fps=FPS, noise=4.0, seed=1, size=size))
        colour = [f.frame.image for f in simulate(made)]
        grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in colour]
        subject = ball_subject(made.scene.rig(), made.scene.pose, Configuration())
        for kind, images in (("grey", grey), ("colour", colour)):
            for everything in (False, True):
                settings = replace(RecordSettings(), everything=everything, megabytes=1e5, free_megabytes=0.0)
                with tempfile.TemporaryDirectory() as folder:
                    text = measured(images, subject, settings, Path(folder) / "made")
                print(f"{size[0]}x{size[1]} {kind:6s} {'everything' if everything else 'ball and targets':16s}: {text}")


if __name__ == "__main__":
    main()
