"""`spheremouse log-mouse`: log the reports of the old trackball while the camera records."""

import shlex
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

_MAX_SECONDS = 600.0


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
    ] = _MAX_SECONDS,
    grab: Annotated[bool, typer.Option("--grab", help="Keep the mouse's motion from the desktop meanwhile.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Log the reports of a mouse or trackball, for `spheremouse match`.

    The kernel stamps them by the clock of the frames. The mouse goes on working. If several mice are connected, the
    command lists them. The log ends with Ctrl-C, after --seconds, or when the mouse is unplugged, and is then complete.
    """
    from spheremouse.calibrate.outputs import check_outputs
    from spheremouse.capture.mouse import Listener, choose, mice
    from spheremouse.capture.signals import SignalHandler
    from spheremouse.errors import SourceError
    from spheremouse.files.mouse_log import MouseReport, write_log

    if not sys.platform.startswith("linux"):
        raise SourceError("log-mouse: works on Linux alone, because it reads event devices")
    check_outputs([out], [], force=force)
    mouse, reports = choose(device, mice()), list[MouseReport]()
    with SignalHandler() as signals, Listener(mouse, grab) as listener:
        print(f"listening to {mouse}; move the ball, end with Ctrl-C", file=sys.stderr, flush=True)
        end = time.monotonic() + seconds
        problem = listener.listen(reports.append, lambda: signals.stop_requested or time.monotonic() >= end)
        write_log(out, f"device {mouse.name}", reports)
    if problem:
        print(f"{problem}: the log ends there", file=sys.stderr)
    x, y = (sum(map(abs, counts)) for counts in list(zip(*reports, strict=True))[1:])
    moves = len(reports) - 2  # without the first and the last, which are empty
    print(f"{out}: {moves} reports in {reports[-1].stamp - reports[0].stamp:.1f} s, {x} counts in x and {y} in y")
    if not moves:
        print(f"nothing moved it: is {mouse.name} the mouse that lies under the ball?")
    else:
        print(f"next: spheremouse match RECORDING {shlex.quote(str(out))}")
