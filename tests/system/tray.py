"""The tray on a desktop: real daemon, real panel, real clicks. Pictures go to $TRAY_PICTURES where it is set.

    .venv/bin/python -m pytest tests/system/tray.py

Skips where Xvfb, trayer, xdotool, dbus, pystray or PyGObject (Debian: python3-gi gir1.2-ayatanaappindicator3-0.1) are
missing.
"""

import contextlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image, ImageChops

sys.path.insert(0, str(Path(__file__).parent))
from desk import SIDE, Desktop, end, gtk, missing, process, until

from spheremouse.capture import open_source
from spheremouse.errors import ControlError
from spheremouse.files.rig import save_rig
from spheremouse.session.control.client import Client

NEEDS = missing() or ("" if gtk() else "needs PyGObject: python3-gi gir1.2-ayatanaappindicator3-0.1")
pytestmark = pytest.mark.skipif(bool(NEEDS), reason=NEEDS)

PROGRAM = [sys.executable, "-m", "spheremouse"]
REINIT, PAUSE, RECORD, QUIT = 1, 2, 3, 4  # among the entries that can be chosen


@pytest.fixture(scope="module")
def films(tmp_path_factory):
    """Recordings: a long one, one in the dark, one where the light goes out."""
    folder = tmp_path_factory.mktemp("films")
    dark = ["--dim", "0", "--dim-seconds", "100"]
    for name, options in (
        ("long", ["--seconds", "100"]),
        ("dark", ["--seconds", "12", *dark, "--dim-at", "0"]),
        ("lost", ["--seconds", "30", *dark, "--dim-at", "10"]),
    ):
        command = [*PROGRAM, "simulate", str(folder / name), "--fps", "5", *options]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    with open_source(f"dataset:{folder / 'long'}") as source:
        save_rig(folder / "rig.yaml", source.rig)
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
        """Whether daemon and icon come to say so; the picture is kept."""
        said = until(lambda: self.status()["state"] == state, seconds)
        seen = until(lambda: self.desk.state() == state, 10.0)
        self.keep(f"{state}.png")
        assert (said, seen) == (True, True), (self.status()["state"], self.desk.state(), self.said())
        return True

    def said(self):
        return (self.folder / "tray.log").read_text()

    def keep(self, name, picture=None):
        if "TRAY_PICTURES" in os.environ:
            kept = Path(os.environ["TRAY_PICTURES"]) / name
            (picture or self.desk.picture()).crop((0, 0, 240, 120)).save(kept)


@pytest.fixture
def world(desk, tmp_path):
    return World(desk, tmp_path)


def test_the_menu_pauses_reinitialises_records_and_quits(world, films, tmp_path):
    with world.tray() as tray:
        assert world.shows("no-daemon")
        with world.daemon(f"dataset:{films / 'long'}"):
            assert world.shows("tracking")
            assert "icon by appindicator: a click opens the menu" in world.said()

            world.desk.choose(PAUSE, tmp_path / "menu.png")
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
        with world.daemon(f"dataset:{films / 'long'}"):  # a new one, on the same socket
            assert world.shows("tracking")
        assert tray.poll() is None
        assert world.shows("no-daemon")
        world.desk.choose(1)  # all that needs a daemon is grey: Quit
        assert tray.wait(20) == 0
    if "TRAY_PICTURES" in os.environ:
        shutil.copy(tmp_path / "menu.png", os.environ["TRAY_PICTURES"])


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


@pytest.mark.parametrize("ground", [(46, 52, 54), (240, 240, 240)], ids=["dark", "light"])
def test_around_the_icon_is_the_panel_whatever_its_colour(tmp_path, ground):
    with contextlib.ExitStack() as stack:
        desk = Desktop(stack, tmp_path, ground)
        tray = stack.enter_context(World(desk, tmp_path).tray())
        assert until(lambda: desk.state() == "no-daemon")
        panel = Image.new("RGB", (SIDE - 8, SIDE), ground)  # what the tray is not as wide as
        seen = (
            ImageChops.difference(desk.picture().crop((0, 0, *panel.size)), panel)
            .convert("L")
            .point(lambda v: 255 * (v > 12))
        )
        x0, y0, x1, y1 = seen.getbbox()
        assert x1 - x0 >= 20
        assert seen.histogram()[255] < 0.85 * (x1 - x0) * (y1 - y0)  # a disc has 0.79 of its square
        assert end(tray) == 0
