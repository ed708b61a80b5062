"""One picture of what the tracker sees, as PNG: the overlay over what a recording would keep."""

from dataclasses import replace
from pathlib import Path

from spheremouse.ball.state import Epoch, Tracker, current
from spheremouse.errors import OutputError
from spheremouse.session.overlay.ball import Overlay, target_marks
from spheremouse.session.overlay.file import write_picture
from spheremouse.session.record.places import FILE
from spheremouse.session.record.privacy import kept, masked


def snapshot(
    path: Path, epoch: Epoch, tracker: Tracker, counts: tuple[int, int, int] = (0, 0, 0), *, everything: bool = False
) -> Path:
    """Write an epoch's picture with what the tracker makes of it; black but for ball and targets unless `everything`.

    Takes some hundredths of a second; the epoch's image must stay as it is meanwhile. `counts` is their sum so far.
    Raises OutputError where the file is there already or cannot be written.
    """
    if path.exists():
        raise OutputError(f"{path}: is there already; give another name")
    tracker = current(epoch.state, tracker)
    keep = None if everything else kept(tracker.rig, tracker.pose, tracker.settings)
    shown = replace(epoch, frame=replace(epoch.frame, image=masked(epoch.frame.image, keep)))
    enlarge = max(1, round(1280 / tracker.rig.camera.width))
    overlay = Overlay(tracker, target_marks(tracker.rig, tracker.pose, None), enlarge)
    overlay.remember(shown.state)
    write_picture(path, overlay.draw(shown, counts), FILE)
    return path
