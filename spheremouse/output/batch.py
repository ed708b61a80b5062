"""Files that get the reports of half a second at once: to format each alone takes five times as long."""

import time
from math import inf

from spheremouse.output import Output, Report

PERIOD_S = 0.5  # s between two writes
MAX_WAIT_S = 1.0  # s between two writes in a run of a recording, where no thread calls them


class BatchOutput(Output):
    """Keeps reports, and writes them each period. Derive an output from it and override `write`.

    The first report is written at once, since it proves that the file can be written. A reader of a stream gets each
    report at once.
    """

    def __init__(self, *, at_once: bool) -> None:
        self._reports: list[Report] = []  # not written yet
        self._at_once, self.period = at_once, inf if at_once else PERIOD_S
        self._written = 0.0  # s, monotonic

    def write(self, reports: list[Report]) -> None:
        """Write reports. Raise OutputError if that fails, or OutputClosed if the reader is gone."""
        raise NotImplementedError

    def send(self, report: Report) -> None:
        """Keep a report, or write all if they are due. An empty report means that they are."""
        if report.samples or self._at_once:
            self._reports.append(report)
        if self.blocks or not report.samples or time.monotonic() > self._written + MAX_WAIT_S:
            self.write_kept()

    def write_kept(self) -> None:
        """Write what is kept."""
        reports, self._reports = self._reports, []
        self._written = time.monotonic()
        if reports:
            self.write(reports)
            self.blocks = self._at_once
