"""The pictures of docs/tray.md: the tray's real process on a desktop without a screen, asked for each state in turn.

    python docs/tray_figures.py

Writes docs/images/tray-*.png. A control socket with given states stands in for the daemon. It has the requirements of
tests/system/desk.py, and needs PyGObject (Debian: python3-gi gir1.2-ayatanaappindicator3-0.1).
"""

import contextlib
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "system"))
from desk import SIDE, Desktop, gtk, missing, process, until  # noqa: E402

from spheremouse.commands.tray.view import NO_DAEMON  # noqa: E402
from spheremouse.session.control.request_queue import PendingRequest  # noqa: E402
from spheremouse.session.control.server import ControlServer  # noqa: E402
from spheremouse.session.control.status import STATES  # noqa: E402
from spheremouse.session.settings import ControlSettings  # noqa: E402

IMAGES = ROOT / "docs" / "images"
DARK, LIGHT = (46, 52, 54), (240, 240, 240)  # panels


def main() -> None:
    """Write all pictures: each icon on a dark panel and on a light one, and the menu."""
    if missing():
        sys.exit(f"tray_figures.py: {missing()}")
    if not gtk():
        sys.exit("tray_figures.py: needs PyGObject: python3-gi gir1.2-ayatanaappindicator3-0.1")
    dark, light = pictures(DARK, menu=True), pictures(LIGHT)
    for state, left in dark.items():
        both = Image.new("RGB", (left.width + light[state].width, SIDE))
        both.paste(left)
        both.paste(light[state], (left.width, 0))
        both.quantize(64).save(IMAGES / f"tray-{state}.png", optimize=True)
    print(f"written: {IMAGES}/tray-*.png")


def pictures(ground: tuple[int, int, int], *, menu: bool = False) -> dict[str, Image.Image]:
    """Return pictures of the tray on a panel of this colour, by state. With `menu`, write one of the menu to a file."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        desk = Desktop(stack, ground)
        socket = folder / "control.sock"
        command = [sys.executable, "-m", "spheremouse", "tray", "--socket", str(socket)]
        stack.enter_context(process(*command, env=desk.env))
        found = {NO_DAEMON: seen(desk, NO_DAEMON)}
        state = "tracking"

        def handle(pending: PendingRequest) -> None:
            pending.answer({"state": state, "reason": "the ball turns", "fps": 59.9})

        with ControlServer(socket, ControlSettings(), handle, lambda _: None):
            for state in STATES:  # `handle` reads it
                found[state] = seen(desk, state)
            state = "tracking"
            until(lambda: desk.state() == state)
            if menu:
                desk.choose(1, folder / "menu.png")
                with Image.open(folder / "menu.png") as picture:
                    picture.crop(picture.getbbox()).quantize(64).save(IMAGES / "tray-menu.png", optimize=True)
    return found


def seen(desk: Desktop, state: str) -> Image.Image:
    """The tray once it shows the state."""
    if not until(lambda: desk.state() == state):
        sys.exit(f"tray_figures.py: the tray does not show {state}")
    return desk.picture().crop((0, 0, SIDE + 2, SIDE))


if __name__ == "__main__":
    main()
