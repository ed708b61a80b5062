"""The pictures of docs/tray.md: the tray's real process on a desktop without a screen, asked for each state in turn.

    python docs/tray_figures.py

Writes docs/images/tray-*.png. The daemon is a control socket that says what it is told. Needs what tests/system/tray.py
needs, PyGObject included.
"""

import contextlib
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "system"))
from desk import SIDE, Desk, gtk, missing, process, until  # noqa: E402

from spheremouse.commands.tray.view import NO_DAEMON  # noqa: E402
from spheremouse.session.control.protocol import Request  # noqa: E402
from spheremouse.session.control.reply import Reply  # noqa: E402
from spheremouse.session.control.server import ControlServer  # noqa: E402
from spheremouse.session.control.status import STATES  # noqa: E402
from spheremouse.session.settings.control import ControlSettings  # noqa: E402

IMAGES = ROOT / "docs" / "images"


def main() -> None:
    """All pictures anew."""
    if missing():
        sys.exit(f"tray_figures.py: {missing()}")
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        path = gtk(folder)
        if path is None:
            sys.exit("tray_figures.py: needs PyGObject: python3-gi gir1.2-ayatanaappindicator3-0.1")
        desk = Desk(stack, folder)
        socket = folder / "control.sock"
        command = [sys.executable, "-m", "spheremouse", "tray", "--socket", str(socket)]
        stack.enter_context(process(*command, env=desk.env | {"PYTHONPATH": str(path)}))
        keep(desk, NO_DAEMON)
        state = "tracking"

        def handle(_: Request, reply: Reply) -> None:
            reply({"state": state, "reason": "the ball turns", "fps": 59.9})

        with ControlServer(socket, ControlSettings(), handle, lambda _: None):
            for state in STATES:  # `handle` reads it
                keep(desk, state)
            state = "tracking"
            until(lambda: desk.state() == state)
            desk.choose(1, folder / "menu.png")
            from PIL import Image

            with Image.open(folder / "menu.png") as picture:
                picture.crop(picture.getbbox()).quantize(64).save(IMAGES / "tray-menu.png", optimize=True)
    print(f"written: {IMAGES}/tray-*.png")


def keep(desk: Desk, state: str) -> None:
    """The tray once it shows the state."""
    if not until(lambda: desk.state() == state):
        sys.exit(f"tray_figures.py: the tray does not show {state}")
    picture = desk.picture().crop((0, 0, SIDE + 2, SIDE))
    picture.quantize(64).save(IMAGES / f"tray-{state}.png", optimize=True)


if __name__ == "__main__":
    main()
