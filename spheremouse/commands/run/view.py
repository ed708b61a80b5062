"""View of a run for people: status line on the terminal, overlay in a file, and summary."""

from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

from spheremouse.ball.pose import describe
from spheremouse.output import Report
from spheremouse.session import offline
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.overlay.drawing import Overlay
from spheremouse.session.overlay.file import OverlayFile
from spheremouse.session.screen import StatusLine, Tally
from spheremouse.session.tracker_adapter import FrameResult, TrackerAdapter


class Counting(offline.View, Protocol):
    """Shows tracked frames, and counts them."""

    tally: Tally


class RunView:
    """Shows the balls of a run on the terminal, and draws them into a file."""

    def __init__(
        self, stack: ExitStack, overlay: Path | None, fps: float | None, *, status: bool, verbose: bool = False
    ) -> None:
        """Show a `status` line, `verbose` details, and write an `overlay` at the rate `fps`; `stack` closes both."""
        self.tally, self._verbose = Tally(), verbose
        self.overlay = None if overlay is None else stack.enter_context(OverlayFile(overlay, fps))
        self._screen = stack.enter_context(StatusLine(status))
        self._drawing: Overlay | None = None

    def log(self, text: str) -> None:
        """Print one or more lines, which stay."""
        self._screen.log(text)

    def show(self, result: FrameResult, report: Report, adapter: TrackerAdapter) -> None:
        """Show the line, and add a frame of the first camera to the overlay."""
        self.tally.add(report.counts, sum(result.seconds.values()))
        if self._verbose and self.tally.frames == 1 and isinstance(adapter, BallAdapter) and adapter.resection:
            self.log(describe(adapter.resection, adapter.rig))
        self._screen.show(result, self.tally)
        if self.overlay is not None and result.frame.camera == 0:
            marks, sample, image = adapter.annotations(result), result.samples[result.pointing], result.frame.image
            drawing = self._drawing = self._drawing or Overlay(self.overlay.scale(image.shape[1]))
            drawing.remember(marks)
            self.overlay.show(lambda: drawing.draw(image, marks, sample, self.tally.counts))
