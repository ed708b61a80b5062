"""`spheremouse run` with a film as its v4l2 camera, for tests that need a process of its own."""

import codecs
import itertools
import os
import resource
import sys
import time
from pathlib import Path

import numpy as np

from spheremouse.files.rig import rig_text
from tests.raw_picture import RawPicture

CONFIG = """\
schema: 2
source: v4l2:{folder}/video0
output: "null"
rig: rig.yaml
realtime: "off"
pose: {{frames: 2}}
control: {{socket: {folder}/s}}
record: {{folder: {folder}}}
"""


def prepare(folder, film):
    (folder / "config.yaml").write_text(CONFIG.format(folder=folder))
    (folder / "rig.yaml").write_text(rig_text(film.rig))
    (folder / "video0").touch()
    np.save(folder / "film.npy", np.array(film.colour))


class Camera:
    """Plays the film back and forth."""

    def __init__(self, images, fps=100.0):
        self._places, self._images = itertools.cycle([*range(len(images)), *range(len(images) - 2, 0, -1)]), images
        self._sequence, self._due, self._interval = 0, time.monotonic(), 1.0 / fps

    def next(self, timeout):
        self._due = max(self._due + self._interval, time.monotonic() - self._interval)
        time.sleep(max(0.0, self._due - time.monotonic()))
        self._sequence += 1
        return self.raw(self._images[next(self._places)], time.monotonic(), self._sequence)

    def raw(self, image, stamp, sequence):
        return RawPicture(image, image, stamp, sequence)

    def describe(self):
        return "a film"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


class AnothersCamera(Camera):
    """From the first picture on process and folder are another user's, who may begin no thread more: what the daemon
    needs has begun by then. Root's daemon would not listen in another's folder."""

    def __init__(self, pictures, uid, folder):
        super().__init__(pictures)
        self._uid, self._folder = uid, folder
        codecs.lookup("ascii")  # read from a file that is another's, perhaps, when it is first used

    def next(self, timeout):
        if os.geteuid() != self._uid:
            for path in (self._folder, *self._folder.iterdir()):
                os.chown(path, self._uid, self._uid)
            os.setgroups([])
            os.setgid(self._uid)
            os.setuid(self._uid)  # of all threads
            resource.setrlimit(resource.RLIMIT_NPROC, (1, 1))
        return super().next(timeout)


def main(folder, uid=""):
    """As the command line does it; as the user of that number, where one is given."""
    from spheremouse import commands as cli
    from spheremouse.capture import v4l2

    folder = Path(folder)
    pictures = np.load(folder / "film.npy")
    v4l2.open_camera = lambda *_: AnothersCamera(pictures, int(uid), folder) if uid else Camera(pictures)
    sys.argv = ["spheremouse", "run", "--config", str(folder / "config.yaml")]
    cli.main()
