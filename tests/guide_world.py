"""The page's guide before a practice camera: `calibrate practice` made its pictures, which differ from step to step.

As a program: `guide_world.py FOLDER page ...` serves the page, which takes FOLDER/python for its Python. That runs
`guide_world.py FOLDER child -m spheremouse ...`: a command with the practice camera, and with a pointer that writes
its moves.
"""

import os
import shlex
import subprocess
import sys
import time
from pathlib import Path

import cv2
import view_world
from raw_picture import RawPicture

from spheremouse.capture.nodes import Node
from spheremouse.output import Output, Report

FPS = 10.0  # of photos and gestures
SHOWN = 5  # frames of each photo
STILL = 40  # frames at rest before and after the gestures, while a command starts
HERE = Path(__file__)


def prepare(folder):
    """Make the pictures of the camera, its node and its lasting name, and the Python of the page."""
    practice = ("calibrate", "practice", folder / "practice", "--size", "960x540", "--photos", 12, "--boards", 18)
    subprocess.run([sys.executable, "-m", "spheremouse", *map(str, practice), "--seed", "3"], check=True)
    program = folder / "python"
    words = shlex.join((sys.executable, str(HERE), str(folder), "child"))
    program.write_text(f'#!/bin/sh\nexec {words} "$@"\n')
    program.chmod(0o755)
    (folder / "video0").touch()
    (folder / "usb-practice-camera").symlink_to("video0")


def moves(folder):
    """Return the moves of the pointer, (x, y) counts each."""
    path = folder / "pointer"
    lines = path.read_text().splitlines() if path.exists() else []
    return [tuple(map(int, line.split())) for line in lines]


class Page(view_world.Server):
    """The page of an empty folder."""

    def __init__(self, folder):
        super().__init__(folder)
        prepare(folder)
        self.cabinet = folder / "cabinet"
        self.start_page(HERE, folder, "page", "--cabinet", self.cabinet)


def pictures(folder, words):
    """Return the pictures for a command, and for how many frames it gets each."""
    practice = folder / "practice"
    if "photos" in words:
        part = "board" if "camera" in words else "device"
        return [cv2.imread(str(path)) for path in sorted((practice / part).glob("*.jpg"))], SHOWN
    video, found = cv2.VideoCapture(str(practice / "film" / "video.mkv")), []
    while (read := video.read())[0]:
        found.append(read[1])
    return [*[found[0]] * STILL, *found, *[found[-1]] * STILL], 1


class Camera:
    """Shows the pictures one after the other, and begins again. Only the newest can be fetched."""

    fps = FPS

    def __init__(self, pictures, shown):
        self._pictures, self._shown = pictures, shown
        self._begin, self._next, self._number = time.monotonic(), 1, 0

    def next(self, timeout):
        now = time.monotonic()
        due = max(self._next, int((now - self._begin) * FPS))
        stamp = self._begin + due / FPS
        if stamp - now > timeout:
            return None
        time.sleep(max(0.0, stamp - now))
        self._next = due + 1
        picture = self._pictures[self._number // self._shown % len(self._pictures)].copy()
        self._number += 1
        return RawPicture(picture, cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), stamp, self._number)

    def describe(self):
        return "the practice camera"

    def close(self):
        return None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


class Pointer(Output):
    """Writes the moves of the pointer into a file."""

    def __init__(self, path):
        self._file = path.open("a")

    def send(self, report: Report) -> None:
        if any(report.counts[:2]):
            print(*report.counts[:2], file=self._file, flush=True)


def child(folder, words):
    from spheremouse import commands
    from spheremouse.capture import nodes, v4l2
    from spheremouse.output import uinput

    node = Node(folder / "video0", "practice camera", folder / "usb-practice-camera")
    nodes.nodes = lambda *_: [node]
    v4l2.largest_size = lambda *_: None
    v4l2.open_camera = lambda *_: Camera(*pictures(folder, words))
    uinput.open = lambda _: Pointer(folder / "pointer")
    sys.argv = ["spheremouse", *words]
    commands.main()


def page(folder, words):
    from spheremouse import commands

    os.chdir(folder)
    sys.executable = str(folder / "python")
    sys.argv = ["spheremouse", "view", *words]
    commands.main()


if __name__ == "__main__":
    folder, role, *rest = sys.argv[1:]
    if role == "page":
        page(Path(folder), rest)
    else:
        child(Path(folder), rest[2:])
