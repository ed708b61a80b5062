"""`spheremouse log-mouse`: log the reports of the old trackball while the camera records."""

import shlex
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

_MAX_SECONDS = 3600.0


def log_mouse(
    out: Annotated[Path, typer.Option("--out", metavar="FILE.csv", help="The log to write.", show_default=False)],
    device: Annotated[
        str | None,
        typer.Option(
            metavar="PATH|NAME",
            help="Node (/dev/input/eventN), or part of the mouse's name.  [default: the only connected mouse]",
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option(metavar="S", min=0.1, max=_MAX_SECONDS, help="Stop after S seconds.")
    ] = 600.0,
    grab: Annotated[bool, typer.Option("--grab", help="Keep the mouse's motion from the desktop meanwhile.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Log the reports of a mouse or trackball, for `spheremouse match`.

    The kernel stamps them by the clock of the frames. The mouse goes on working. If several mice are connected, the
    command lists them. The log ends with Ctrl-C, after --seconds, or when the mouse is unplugged, and is then complete.
    """
    from spheremouse.capture.mouse import Listener, choose, mice
    from spheremouse.capture.signals import SignalHandler
    from spheremouse.errors import SourceError
    from spheremouse.files.mouse_log import MAX_REPORTS, LogFile

    if not sys.platform.startswith("linux"):
        raise SourceError("log-mouse: works on Linux alone, because it reads event devices")
    mouse = choose(device, mice())
    with SignalHandler() as signals, Listener(mouse, grab) as listener:
        with LogFile(out, f"device {mouse.name}", force) as file:
            print(f"listening to {mouse}; move the ball, end with Ctrl-C", file=sys.stderr, flush=True)
            end = time.monotonic() + seconds
            problem = listener.listen(
                file.add, lambda: signals.asked or time.monotonic() >= end or file.reports >= MAX_REPORTS
            )
        if problem:
            print(f"{problem}: the log ends there", file=sys.stderr)
        if file.reports >= MAX_REPORTS:
            print(f"the log ends after {MAX_REPORTS} reports, the largest number", file=sys.stderr)
    x, y = file.counts
    print(f"{out}: {file.reports} reports in {file.last - (file.first or 0.0):.1f} s, {x} counts in x and {y} in y")
    if file.reports == 0:
        print(f"nothing moved it: is {mouse.name} the mouse that lies under the ball?")
    else:
        print(f"next: spheremouse match RECORDING {shlex.quote(str(out))}")
