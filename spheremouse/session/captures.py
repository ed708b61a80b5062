"""The capture threads of a run, one for each camera, which the state of the run sees as one."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from spheremouse.capture import OpenCamera
from spheremouse.capture.fetch import Capture
from spheremouse.capture.newest import LatestFrame
from spheremouse.errors import SpheremouseError
from spheremouse.output.rate_limited_logger import strip_digits
from spheremouse.session.process.threads import begin

_REPORTED_AFTER_S = 0.5  # s; a shorter trouble of one camera of two is not logged


class _Trouble(NamedTuple):
    """Trouble of a camera, as it is logged."""

    text: str  # empty: the camera takes part
    since: float  # s
    logged: str  # text of the last line about it


class Captures:
    """The capture threads of one or two cameras. Other threads may read the properties."""

    def __init__(
        self, cameras: Iterable[OpenCamera], latest: LatestFrame, log: Callable[[str], None], patience: float
    ) -> None:
        """Create the threads; `patience`, s, is the longest time without a frame. `log` may be called by any thread."""
        self._log = log
        self.each = tuple(Capture(open_it, latest, log, patience, k) for k, open_it in enumerate(cameras))
        self.first = self.each[0]  # the capture of the first camera
        self._troubles = [_Trouble("", 0.0, "")] * len(self.each)

    def start(self, claim: Callable[[int | None], None]) -> None:
        """Start the threads. `claim` requests real-time scheduling for one."""
        for capture in self.each:
            begin(capture)
            claim(capture.native_id)

    @property
    def main(self) -> int:
        """Number of the first camera that gives frames; 0 if none does."""
        return next((k for k, capture in enumerate(self.each) if not capture.trouble and not capture.finished), 0)

    @property
    def trouble(self) -> str:
        """Reason why no camera gives frames; empty while one does."""
        return self.first.trouble if all(capture.trouble for capture in self.each) else ""

    @property
    def opening(self) -> bool:
        """True during the first attempt of all cameras."""
        return all(capture.opening for capture in self.each)

    @property
    def attempts(self) -> int:
        """Number of attempts to open a camera."""
        return max(capture.attempts for capture in self.each)

    @property
    def dropped(self) -> int:
        """Number of frames that the drivers dropped."""
        return sum(capture.dropped for capture in self.each)

    @property
    def restarts(self) -> int:
        """Number of times that the frames of a camera resumed."""
        return sum(capture.restarts for capture in self.each)

    @property
    def finished(self) -> bool:
        """True at the end of all recordings."""
        return all(capture.finished for capture in self.each)

    @property
    def failure(self) -> SpheremouseError | None:
        """The error that ended a recording."""
        return next((capture.failure for capture in self.each if capture.failure is not None), None)

    def trouble_of(self, camera: int) -> str:
        """Return the reason why a camera gives no frames; empty if it does."""
        capture = self.each[camera]
        return "its recording has ended" if capture.finished else capture.trouble

    def log_changes(self, now: float, troubles: Iterable[str]) -> None:
        """Log which of two cameras takes no part any more, or takes part again, by their `troubles`, at `now` (s).

        A trouble of both is one of the run, which `StateMonitor` logs.
        """
        troubles = list(troubles)
        for k, text in enumerate(troubles):
            before = self._troubles[k]
            since = now if bool(text) is not bool(before.text) else before.since
            logged = before.logged
            if now - since > _REPORTED_AFTER_S and strip_digits(text) != strip_digits(logged) and not all(troubles):
                self._log(f"camera {k + 1}: {text}; the other goes on" if text else f"camera {k + 1} takes part again")
                logged = text
            self._troubles[k] = _Trouble(text, since, logged)

    def reopen(self) -> None:
        """Reopen the cameras because their frames are unusable."""
        for capture in self.each:
            capture.reopen()

    def close(self) -> None:
        """End the threads and release the cameras."""
        for capture in self.each:
            capture.close()
