"""View of a run for people: status line on the terminal, overlay in a file, and summary."""

from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

from spheremouse.ball.pose import describe
from spheremouse.output import Report
from spheremouse.session import offline
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.overlay.file import OverlayFile
from spheremouse.session.overlay.marks import target_marks
from spheremouse.session.overlay.wand import WandOverlay
from spheremouse.session.run_config import RunConfig
from spheremouse.session.screen import StatusLine, Tally, ball_line, pose_lines
from spheremouse.session.tracker_adapter import FrameResult, TrackerAdapter
from spheremouse.session.wand.adapter import WandAdapter
from spheremouse.wand.state import WandTracker


class Counting(offline.View, Protocol):
    """Shows tracked frames, and counts them."""

    tally: Tally


class View(Counting, Protocol):
    """Also has the overlay, if there is one."""

    overlay: OverlayFile | None


class BallView:
    """Shows the ball in its frame."""

    def __init__(self, wanted: bool, overlay: OverlayFile | None, stack: ExitStack, verbose: bool = False) -> None:
        """Show a line if it is `wanted`; `stack` closes it. `verbose` prints all details of the pose."""
        self.tally, self._verbose = Tally(), verbose
        self._screen = stack.enter_context(StatusLine(wanted))
        self.overlay = overlay

    def log(self, text: str) -> None:
        """One or more lines, which stay."""
        self._screen.log(text)

    def show(self, made: FrameResult, report: Report, adapter: TrackerAdapter) -> None:
        """Line and overlay."""
        self.tally.add(report.counts, sum(made.seconds.values()))
        if self._verbose and self.tally.frames == 1 and isinstance(adapter, BallAdapter) and adapter.resection:
            self.log(describe(adapter.resection, adapter.rig))
        self._screen.show(ball_line, made.epoch, self.tally)
        if self.overlay is not None:
            assert isinstance(adapter, BallAdapter)
            tracker = adapter.tracker
            assert tracker is not None
            if self.tally.frames == 1:
                self.overlay.begin(tracker, target_marks(tracker.rig, tracker.pose, adapter.resection))
            self.overlay.add(made.epoch, lambda: self.tally.counts)


class WandView:
    """Shows balls in a hand."""

    def __init__(self, wanted: bool, overlay: OverlayFile | None, stack: ExitStack, verbose: bool = False) -> None:
        """Show lines if they are `wanted`; `stack` closes them."""
        self.tally = Tally()
        self._screen = stack.enter_context(StatusLine(wanted))
        self.overlay = overlay
        self._pen: tuple[WandTracker, WandOverlay] | None = None

    def log(self, text: str) -> None:
        """One or more lines, which stay."""
        self._screen.log(text)

    def show(self, made: FrameResult, report: Report, adapter: TrackerAdapter) -> None:
        """Line and overlay."""
        self.tally.add(report.counts, sum(made.seconds.values()))
        self._screen.show(pose_lines, made.frame.stamp, made.epoch.poses, self.tally)
        if self.overlay is not None:
            assert isinstance(adapter, WandAdapter)
            tracker = adapter.tracker
            if self._pen is None or self._pen[0] is not tracker:
                self._pen = tracker, WandOverlay(tracker, adapter.points, self.overlay.scale(tracker.camera.width))
            _, pen = self._pen
            pen.remember(made.epoch)
            self.overlay.show(lambda: pen.draw(made.epoch, self.tally.counts))


def view(
    plan: RunConfig, wanted: bool, overlay: Path | None, fps: float | None, stack: ExitStack, verbose: bool
) -> View:
    """Return the view of a run; `fps` is the frame rate of its video."""
    file = None if overlay is None else stack.enter_context(OverlayFile(overlay, fps))
    kind = WandView if plan.configuration.tracker == "wand" else BallView
    return kind(wanted, file, stack, verbose)
