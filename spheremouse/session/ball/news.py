"""Status and log texts about the ball: its events, withheld motion, and missing discs."""

from concurrent.futures import Future

from spheremouse.ball.detect.diagnosis import Absence, why_no_disc
from spheremouse.ball.events import MotionReleased, MotionWithheld
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.output.rate_limited_logger import strip_digits
from spheremouse.session import messages
from spheremouse.session.ball.looking import Elsewhere, begun
from spheremouse.tracker import Frame, Status, Step

_FEW = 3  # discs: with this many in view, the picture is not the cause
_AFTER = 1.0  # s without tracking before the first diagnosis: hands pass in less
_EVERY = 2.0  # s between two diagnoses


class BallNews:
    """Texts about the ball for status and log.

    One thread calls the methods. Other threads may read `reason`.
    """

    def __init__(self, elsewhere: Elsewhere) -> None:
        """Create the texts; `elsewhere` runs the diagnosis of a picture in another thread."""
        self.reason = ""  # for the status: the state of the ball; empty if there is nothing to report
        self._known, self._log = "", ""
        self._missing = MissingDiscs(elsewhere)

    def add(self, made: Step[TrackState], frame: Frame, tracker: Tracker) -> None:
        """Update the texts from one frame and the tracker's step for it."""
        state, events = made.state, made.events
        lines = [messages.line(events)] if events else []
        if lasting := [e for e in events if not isinstance(e, MotionWithheld | MotionReleased)]:
            self._known = messages.reason(lasting)
        missing, new = self._missing.look(state, frame, tracker)
        if new:
            lines.append(missing)
        if lines:
            self._log = "; ".join(lines)
        withheld = state.withheld
        if withheld is not None and withheld.announced:
            self.reason = messages.withheld(frame.stamp - withheld.since, withheld.doubt)
        else:
            self.reason = missing or self._known

    def restart(self, reason: str) -> None:
        """Set `reason` when the search for the ball starts again."""
        self.reason = self._known = reason

    def take(self) -> str:
        """Return the last log line since the previous call, and clear it; empty if there is none."""
        log, self._log = self._log, ""
        return log


class MissingDiscs:
    """Periodic diagnosis of the picture while the ball is not tracked."""

    def __init__(self, elsewhere: Elsewhere) -> None:
        self._elsewhere = elsewhere
        self._forget()

    def look(self, state: TrackState, frame: Frame, tracker: Tracker) -> tuple[str, bool]:
        """Return the reason for the missing discs, and True if it is new.

        The reason is empty while discs are in view, and until the first diagnosis is complete.
        """
        points, stamp = len(state.points), frame.stamp
        if state.status is Status.TRACKING:
            self._forget()
            return "", False
        since = self._since = stamp if self._since is None else min(self._since, stamp)
        due = stamp - since >= _AFTER and not 0.0 <= stamp - self._looked < _EVERY
        if due and points < _FEW and self._looking is None:
            self._looked, self._seen, image = stamp, points, frame.image.copy()
            self._looking = begun(
                lambda: why_no_disc(image, tracker.rig, tracker.pose, tracker.settings.discs), self._elsewhere
            )
        if self._looking is not None and self._looking.done():
            looked, self._looking = self._looking, None
            self._absence = looked.result()
        if self._absence is None or points >= _FEW:
            return "", False
        told, self._told = self._told, messages.why_absent(self._absence)[0]
        return messages.no_discs(self._seen, stamp - since, self._absence), strip_digits(told) != strip_digits(
            self._told
        )

    def _forget(self) -> None:
        self._since: float | None = None  # s, stamp of the first frame in which the ball was not tracked
        self._looked = -float("inf")  # s, stamp of the last frame with a diagnosis
        self._looking: Future[Absence] | None = None
        self._seen = 0  # discs in that frame
        self._absence: Absence | None = None
        self._told = ""
