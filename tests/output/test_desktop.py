"""The desktop's pointer: what is made of counts, what is said where there is none, and a real X server's pointer."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock, call

import pytest
from reporting import refused, report

from spheremouse.errors import OutputError
from spheremouse.output import desktop
from spheremouse.output.desktop import Desktop

REPOSITORY = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("third", "counts", "calls"),
    [
        ("none", (3, -2, 900), [call.move(3, -2)]),
        ("none", (0, 0, 900), []),
        ("wheel", (0, 5, 119), [call.move(0, 5)]),
        ("wheel", (0, 0, -250), [call.scroll(0, -2)]),
        ("wheel", (1, 0, 120), [call.move(1, 0), call.scroll(0, 1)]),
        ("none", (10**9, -(10**9), 0), [call.move(10_000, -10_000)]),
    ],
)
def test_it_moves_the_pointer_and_scrolls_whole_notches(third, counts, calls):
    pointer = Mock()
    with Desktop(pointer, third) as output:
        output.send(report(*counts))
    assert pointer.method_calls == calls


def test_a_desktop_that_goes_away_is_one_line():
    pointer = Mock()
    pointer.move.side_effect = ConnectionError("Display connection closed\nby server")
    with pytest.raises(OutputError, match=r"any more: Display connection closed by server$"):
        Desktop(pointer, "none").send(report(1))


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="X11 and Wayland")
def test_what_is_missing_is_said(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "XDG_SESSION_TYPE"):
        monkeypatch.delenv(name, raising=False)
    assert "DISPLAY is not set" in refused("desktop")
    monkeypatch.setenv("DISPLAY", ":4711")  # Wayland sessions have an X server for old programs
    monkeypatch.setenv("XDG_SESSION_TYPE", "wayland")
    assert "on Wayland no program may move the pointer; use uinput" in refused("desktop")
    (finding,) = desktop.probe("")
    assert (finding.text, finding.advice[:10]) == ("on Wayland no program may move the pointer", "use uinput")


# ---- a real X server ----

needs_x = pytest.mark.skipif(
    not (shutil.which("Xvfb") and shutil.which("xdotool")),
    reason="needs Xvfb and xdotool",
)

PROGRAM = """
import sys
from spheremouse.errors import OutputError
from spheremouse.tracker import unknown
from spheremouse.output import Report, open_output

try:
    with open_output("desktop:third=wheel") as output:
        print("open", flush=True)
        for line in sys.stdin:
            counts = tuple(map(int, line.split()))
            output.send(Report(counts, None, 0.0))
            print("sent", flush=True)
except OutputError as e:
    print(e, flush=True)
"""


@pytest.fixture
def display():
    """A screen of 1280 x 1024 that nobody sees; its name, and the server's process."""
    read, write = os.pipe()
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x1024x24", "-nolisten", "tcp"]
    with subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL) as server:
        os.close(write)
        with os.fdopen(read) as number:
            name = number.readline().strip()  # empty where the server ended
        if not name:
            pytest.skip("Xvfb does not start here")
        yield f":{name}", server
        server.terminate()


def program(name) -> Any:
    env = {k: v for k, v in os.environ.items() if k not in ("WAYLAND_DISPLAY", "XDG_SESSION_TYPE")}
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        env={**env, "DISPLAY": name},
        cwd=REPOSITORY,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
    )


def place(name):
    """Where the X server says that the pointer is."""
    said = subprocess.run(
        ["xdotool", "getmouselocation", "--shell"], env={"DISPLAY": name}, capture_output=True, text=True, check=True
    ).stdout
    found = dict(line.split("=") for line in said.splitlines())
    return int(found["X"]), int(found["Y"])


@needs_x
def test_the_pointer_of_a_real_x_server_moves_by_the_counts(display):
    name, server = display
    with program(name) as process:
        assert process.stdout.readline() == "open\n"
        subprocess.run(["xdotool", "mousemove", "600", "500"], env={"DISPLAY": name}, check=True)

        def send(*counts):
            process.stdin.write(" ".join(map(str, counts)) + "\n")
            return process.stdout.readline()

        x, y = 600, 500
        for k in range(50):
            dx, dy = 7 * k % 23 - 11, 5 * k % 17 - 8
            x, y = x + dx, y + dy
            assert send(dx, dy, 7) == "sent\n"
        assert place(name) == (x, y)
        assert send(100_000, 0, 0) == "sent\n"  # a screen has edges
        assert place(name) == (1279, y)
        server.kill()
        server.wait()
        assert send(1, 0, 0).startswith("desktop: the pointer cannot be moved any more: ")


@needs_x
def test_a_server_that_does_not_answer():
    with program(":4711") as process:
        said, _ = process.communicate(timeout=60)
    assert said == (
        "desktop: the X11 display :4711 does not answer or refuses; check DISPLAY and XAUTHORITY, or use uinput\n"
    )
