"""A desktop for docs/tray_figures.py: an X server without a screen, a panel with a tray, and a session bus.

Needs Xvfb, trayer, xdotool and dbus (Debian: xvfb trayer xdotool dbus), and python-xlib, which pystray brings.
"""

import contextlib
import importlib.util
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from PIL import Image, ImageChops, ImageStat

from spheremouse.commands.tray.view import STATES, icon

PROGRAMS = ("Xvfb", "trayer", "xdotool", "dbus-daemon")
SIDE = 32  # px, of the panel


def missing() -> str:
    """What is not installed, in words; empty where all is there."""
    names = [p for p in PROGRAMS if shutil.which(p) is None]
    names += [m for m in ("pystray", "Xlib") if importlib.util.find_spec(m) is None]
    return f"needs {', '.join(names)}" if names else ""


def gtk() -> bool:
    """Whether the system has PyGObject and its indicators."""
    probe = "import gi; gi.require_version('Gtk', '3.0'); gi.require_version('AyatanaAppIndicator3', '0.1')"
    return subprocess.run(["/usr/bin/python3", "-c", probe], capture_output=True, check=False).returncode == 0


def until(what: Callable[[], object], seconds: float = 30.0) -> bool:
    end = time.monotonic() + seconds
    while not what():
        if time.monotonic() > end:
            return False
        time.sleep(0.1)
    return True


@contextlib.contextmanager
def process(*command: str, **options: object) -> Iterator[subprocess.Popen[str]]:
    running = subprocess.Popen(command, text=True, **options)  # pyright: ignore
    try:
        yield running
    finally:
        running.terminate()
        try:
            running.wait(20)
        except subprocess.TimeoutExpired:
            running.kill()
            running.wait()


class Desktop:
    """The desktop; `env` is for programs that are to run on it."""

    def __init__(self, stack: contextlib.ExitStack, ground: tuple[int, int, int]) -> None:
        read, write = os.pipe()
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        stack.enter_context(
            process(
                "Xvfb", "-displayfd", str(write), "-screen", "0", "480x320x24", "-noreset", pass_fds=(write,), **quiet
            )
        )
        os.close(write)
        with os.fdopen(read) as pipe:
            self.display = f":{pipe.readline().strip()}"
        own = {k: v for k, v in os.environ.items() if k not in ("WAYLAND_DISPLAY", "DBUS_SESSION_BUS_ADDRESS")}
        bus = stack.enter_context(
            process(
                "dbus-daemon", "--session", "--nofork", "--print-address=1", stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL, env=own | {"DISPLAY": self.display}
            )
        )  # fmt: skip
        assert bus.stdout is not None
        address = bus.stdout.readline().strip()
        self.env = own | {"DISPLAY": self.display, "DBUS_SESSION_BUS_ADDRESS": address, "NO_AT_BRIDGE": "1"}
        tint = "0x{:02x}{:02x}{:02x}".format(*ground)
        command = ["trayer", "--edge", "top", "--align", "left", "--widthtype", "request", "--height", str(SIDE)]
        command += ["--transparent", "true", "--alpha", "0", "--tint", tint, "--SetDockType", "true"]
        stack.enter_context(process(*command, env=self.env, **quiet))

    def picture(self) -> Image.Image:
        from Xlib import X
        from Xlib.display import Display

        display = Display(self.display)
        try:
            root = display.screen().root
            size = root.get_geometry()
            raw = root.get_image(0, 0, size.width, size.height, X.ZPixmap, 0xFFFFFFFF)
            return Image.frombytes("RGB", (size.width, size.height), raw.data, "raw", "BGRX")
        finally:
            display.close()

    def state(self) -> str:
        """The state whose icon is in the tray; empty where it is none of them."""
        seen = self.picture().crop((0, 0, SIDE + 8, SIDE))
        best, far = "", 0.06
        for state in STATES:
            for size in (22, 24, 30, 32):
                drawn = icon(state, 64).resize((size, size), Image.Resampling.LANCZOS)
                for x in range(5):
                    for y in range((SIDE - size) // 2 - 1, (SIDE - size) // 2 + 2):
                        part = seen.crop((x, y, x + size, y + size))
                        flat = part.copy()
                        flat.paste(drawn, mask=drawn)
                        off = sum(ImageStat.Stat(ImageChops.difference(part, flat)).mean) / 3 / 255
                        if off < far:
                            best, far = state, off
        return best

    def choose(self, place: int, picture: Path | None = None) -> None:
        """Open the menu and take the entry `place` (from 1) among those that can be chosen."""
        before = self.picture()
        self._do("mousemove", str(SIDE // 2), str(SIDE // 2), "click", "1")
        assert until(lambda: _differ(before, self.picture()), 10.0), "no menu opens"
        time.sleep(0.5)
        for _ in range(place):
            self._do("key", "Down")
            time.sleep(0.1)
        if picture is not None:
            self.picture().save(picture)
        self._do("key", "Return")

    def _do(self, *command: str) -> None:
        subprocess.run(["xdotool", *command], env=self.env, check=True)


def _differ(a: Image.Image, b: Image.Image) -> bool:
    """Whether more than an icon has changed."""
    box = ImageChops.difference(a, b).getbbox()
    return box is not None and box[3] > 2 * SIDE
