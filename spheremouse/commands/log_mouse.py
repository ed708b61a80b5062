"""`spheremouse log-mouse`: write down what the old trackball says while the camera records."""

import os
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

_MOST_SECONDS = 3600.0


def log_mouse(
    out: Annotated[Path, typer.Option("--out", metavar="FILE.csv", help="The log to write.", show_default=False)],
    device: Annotated[
        str | None,
        typer.Option(
            metavar="PATH|NAME",
            help="Node (/dev/input/eventN), or part of the mouse's name.  [default: the only mouse that is there]",
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option(metavar="S", min=0.1, max=_MOST_SECONDS, help="Stop after S seconds.")
    ] = 600.0,
    grab: Annotated[bool, typer.Option("--grab", help="Keep the mouse's motion from the desktop meanwhile.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Log the reports of a mouse or trackball, for `spheremouse match`.

    Time stamps are the kernel's, by the clock that frames are stamped with. The mouse goes on working. Where several
    are there they are listed. Ends with Ctrl-C, after --seconds, or when the mouse is unplugged; what came until then
    is in the file.
    """
    from spheremouse.capture.mouse import Listener, choose, mice
    from spheremouse.capture.signals import SignalHandler
    from spheremouse.errors import SourceError
    from spheremouse.files.mouse_log import MOST, LogFile

    if not sys.platform.startswith("linux"):
        raise SourceError("log-mouse: reads the event devices of Linux; on other systems there are none")
    mouse = choose(device, mice())
    with SignalHandler() as stopping, Listener(mouse, grab) as listener:
        with LogFile(out, f"device {mouse.name}", force) as file:
            print(f"listening to {mouse}; move the ball, end with Ctrl-C", file=sys.stderr, flush=True)
            end = time.monotonic() + seconds
            why = listener.listen(file.add, lambda: stopping.asked or time.monotonic() >= end or file.reports >= MOST)
        if why:
            print(f"{why}: the log ends there", file=sys.stderr)
        if file.reports >= MOST:
            print(f"that are {MOST} reports, the most that a log may have", file=sys.stderr)
    x, y = file.counts
    print(f"{out}: {file.reports} reports in {file.last - (file.first or 0.0):.1f} s, {x} counts in x and {y} in y")
    if file.reports == 0:
        print(f"nothing moved it: is {mouse.name} the mouse that lies under the ball?")
    else:
        print(f"next: spheremouse match RECORDING {_quoted(out)}")


def _quoted(path: Path) -> str:
    text = os.fspath(path)
    return f"'{text}'" if " " in text else text
