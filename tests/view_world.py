"""A service on a film with its page process, for tests of the page.

As a program: `spheremouse run` with the film, forth and back at 30 Hz, as its v4l2 camera.
"""

import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import daemon_process
import numpy as np
from daemon_world import Film

from spheremouse.session.control.client import Client, NoDaemonError

PATIENCE = 30.0  # s
FPS = 30.0
HERE = Path(__file__).parent
SETTINGS = """\
# kept by `save`
motion: {scale_x: 1.0}
profiles:
  evening: {discs.contrast: 0.2, motion.scale_y: 2}
"""


def wait_for(what, condition, patience=PATIENCE):
    """Return the first true result of the condition."""
    end = time.monotonic() + patience
    while not (found := condition()):
        assert time.monotonic() < end, f"{what}: not within {patience} s"
        time.sleep(0.02)
    return found


def start(*words, stderr=subprocess.DEVNULL):
    paths = os.pathsep.join(map(str, (HERE.parent, HERE)))
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": paths}
    return subprocess.Popen([sys.executable, *map(str, words)], env=environment, stderr=stderr)


def end(process):
    process.terminate()
    process.wait(PATIENCE)


class Server:
    """A page process; the daemon, if there is one, has its socket in the same folder."""

    def __init__(self, folder):
        self.folder, self.socket = folder, folder / "s"
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/"
        self._token = folder / "token"

    def start_page(self, *words):
        """Start the page process by a program and its arguments."""
        options = ("--port", self.port, "--socket", self.socket, "--token-file", self._token)
        self._page = start(*(words or ("-m", "spheremouse", "view")), *options)
        wait_for("the page process answers", self._answers)

    def end_page(self):
        end(self._page)

    def signal_page(self, number):
        self._page.send_signal(number)

    def _answers(self):
        try:
            with urllib.request.urlopen(self.url) as reply:
                return reply.status == 200
        except OSError:
            return False

    @property
    def owner_url(self):
        assert self._page.poll() is None, f"the page process ended with {self._page.returncode}"
        return f"{self.url}?token={self._token.read_text().strip()}"

    def owns(self, url):
        """True if a request stays in the browser or goes to the page process."""
        return url.startswith((self.url, self.url.replace("http", "ws", 1), "blob:", "data:"))


class Service(Server):
    """A service on a film, and its page process."""

    def __init__(self, folder):
        super().__init__(folder)
        daemon_process.prepare(folder, Film.render())
        with (folder / "config.yaml").open("a") as file:
            file.write(SETTINGS)
        shutil.copytree(HERE / "data/far26_clip", folder / "clip")
        self.start_daemon()
        self.start_page()

    def start_daemon(self):
        self._daemon = start(__file__, self.folder)

    def end_daemon(self):
        end(self._daemon)

    def status(self):
        """Return the daemon's status as a dictionary; empty if none answers."""
        try:
            return self.ask("status")
        except NoDaemonError:
            return {}

    def reach(self, **values):
        wait_for(str(values), lambda: values.items() <= self.status().items())

    def ask(self, command, **arguments):
        with Client(self.socket) as client:
            return client.ask(command, **arguments)

    def reset(self):
        """Give up all changes."""
        self.ask("reload")

    def close(self):
        self.end_page()
        self.end_daemon()


def main(folder):
    """Run the daemon of `daemon_process.prepare`."""
    from spheremouse import commands as cli
    from spheremouse.capture import v4l2

    pictures = np.load(Path(folder) / "film.npy")
    v4l2.open_camera = lambda *_: daemon_process.Camera(pictures, FPS)
    sys.argv = ["spheremouse", "run", "--config", str(Path(folder) / "config.yaml")]
    cli.main()


if __name__ == "__main__":
    main(*sys.argv[1:])
