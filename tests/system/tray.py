"""The tray on a desktop: real daemon, real panel, real clicks.

    .venv/bin/python -m pytest tests/system/tray.py

Skips where Xvfb, trayer, xdotool, dbus, pystray or PyGObject (Debian: python3-gi gir1.2-ayatanaappindicator3-0.1) are
missing.
"""

import contextlib
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from desk import Desktop, end, gtk, missing, process, until

from spheremouse.errors import ControlError
from spheremouse.session.control.client import Client

NEEDS = missing() or ("" if gtk() else "needs PyGObject: python3-gi gir1.2-ayatanaappindicator3-0.1")
pytestmark = pytest.mark.skipif(bool(NEEDS), reason=NEEDS)

PROGRAM = [sys.executable, "-m", "spheremouse"]
REINIT, PAUSE, RECORD, QUIT = 1, 2, 3, 4  # among the entries that can be chosen


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """A long recording."""
    folder = tmp_path_factory.mktemp("films") / "long"
    command = [*PROGRAM, "simulate", str(folder), "--fps", "5", "--seconds", "100"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return folder


@pytest.fixture
def desk(tmp_path):
    with contextlib.ExitStack() as stack:
        yield Desktop(stack, tmp_path)


class World:
    """Where daemon and tray meet: a socket, and a folder for what they write."""

    def __init__(self, desk, folder):
        self.desk, self.folder = desk, folder
        self.socket = folder / "control.sock"

    def daemon(self, source, output="null", *more):
        settings = [f"control.socket={self.socket}", f"record.folder={self.folder / 'recordings'}"]
        command = [*PROGRAM, "run", "--source", source, "--output", output, "--realtime", *more]
        log = (self.folder / "daemon.log").open("a")
        return process(*command, *(w for s in settings for w in ("--set", s)), stdout=log, stderr=log)

    def tray(self):
        log = (self.folder / "tray.log").open("a")
        command = [*PROGRAM, "tray", "--socket", str(self.socket)]
        return process(*command, env=self.desk.env, stdout=log, stderr=log)

    def status(self):
        try:
            with Client(self.socket) as client:
                return client.ask("status")
        except ControlError:
            return {"state": "no-daemon"}

    def shows(self, state, seconds=40.0):
        """Whether daemon and icon come to say so."""
        said = until(lambda: self.status()["state"] == state, seconds)
        seen = until(lambda: self.desk.state() == state, 10.0)
        assert (said, seen) == (True, True), (self.status()["state"], self.desk.state(), self.said())
        return True

    def said(self):
        return (self.folder / "tray.log").read_text()


@pytest.fixture
def world(desk, tmp_path):
    return World(desk, tmp_path)


def test_the_menu_pauses_reinitialises_records_and_quits(world, film):
    with world.tray() as tray:
        assert world.shows("no-daemon")
        with world.daemon(f"dataset:{film}"):
            assert world.shows("tracking")
            assert "icon by appindicator: a click opens the menu" in world.said()

            world.desk.choose(PAUSE)
            assert world.shows("paused")
            world.desk.choose(PAUSE)  # is now Resume
            assert world.shows("tracking")

            assert until(lambda: world.status()["pose"]["age_s"] > 3.0)
            posed = world.status()["pose"]["age_s"]
            world.desk.choose(REINIT)
            assert until(lambda: world.status()["pose"]["age_s"] < posed)
            assert world.shows("tracking")

            world.desk.choose(RECORD)
            assert until(lambda: world.status()["recording"] is not None)
            folder = Path(world.status()["recording"]["folder"])
            assert until(lambda: world.status()["recording"]["frames"] > 3)
            assert until(lambda: world.said().count("\n") >= 1)
            world.desk.choose(RECORD)  # is now: end the recording
            assert until((folder / "scene.json").exists)
            assert until(lambda: f"recorded into {folder}" in world.said())
            assert until(lambda: f"recorded into {folder}" in world.desk.notices())

        assert world.shows("no-daemon")
        with world.daemon(f"dataset:{film}"):  # a new one, on the same socket
            assert world.shows("tracking")
        assert tray.poll() is None
        assert world.shows("no-daemon")
        world.desk.choose(1)  # all that needs a daemon is grey: Quit
        assert tray.wait(20) == 0


def test_the_icon_comes_back_with_the_panel(world):
    """Also at login, where the panel is not there yet."""
    world.desk.end_panel()
    with world.tray() as tray:
        world.desk.start_panel()
        assert until(lambda: world.desk.state() == "no-daemon"), world.said()
        world.desk.end_panel()
        assert until(lambda: world.desk.state() == "")
        world.desk.start_panel()
        assert until(lambda: world.desk.state() == "no-daemon"), world.said()
        assert end(tray) == 0
