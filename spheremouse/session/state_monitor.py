"""State and reason of a run. The worker updates them between two frames; changes are logged."""

import time
from collections.abc import Callable

from spheremouse.output.rate_limited_logger import strip_digits
from spheremouse.session.captures import Captures
from spheremouse.session.control.status import State
from spheremouse.session.outputs import Outputs
from spheremouse.session.timing import Arrivals
from spheremouse.session.worker import Worker
from spheremouse.tracker import Status


def derive_state(
    tracker: Status = Status.SEARCHING,
    *,
    starting: str = "",
    camera: str = "",
    paused: str = "",
    targets: str = "",
    ball: str = "",
    output: str = "",
) -> tuple[State, str]:
    """Return state and reason. The texts are reasons, empty without trouble.

    The first fault on the way from the camera to the pointer counts.
    """
    lost = {Status.SEARCHING: "the ball is not found yet", Status.LOST: "the ball is not recognised"}.get(tracker, "")
    for state, reason in (
        (State.STARTING, starting),
        (State.NO_CAMERA, camera),
        (State.PAUSED, paused),
        (State.SEARCHING_TARGETS, targets),
        (State.LOST, lost and (ball or lost)),
        (State.FAILED_OUTPUT, output),
    ):
        if reason:
            return state, reason
    return State.TRACKING, ball or "the ball is followed"


def log_line(before: tuple[State, str], now: tuple[State, str], event: str) -> str:
    """Return the log line for the states and reasons `before` and `now`; empty if there is nothing to log.

    A change of the state comes first, then the tracker's `event`, then another reason. Reasons that differ in their
    numbers alone count as equal. In TRACKING and LOST another reason alone is not logged.
    """
    (old, why_before), (state, why) = before, now
    if state is not old:
        return f"{state}: {why}"
    if event:
        return event
    if state in (State.TRACKING, State.LOST) or strip_digits(why) == strip_digits(why_before):
        return ""
    return f"{state}: {why}"


_STATUS_EVERY = 20.0  # s between two lines for systemd without a change
# States in which the ball may turn without being seen
_STATES_WITHOUT_BALL = (State.NO_CAMERA, State.SEARCHING_TARGETS, State.LOST)


class StateMonitor:
    """State, reason and since when. Called by the worker's thread; attributes may be read by others."""

    def __init__(
        self,
        worker: Worker,
        captures: Captures,
        arrivals: Arrivals,
        outputs: Outputs,
        *,
        log: Callable[[str], None],
        notify: Callable[[str], None],
    ) -> None:
        """`log` takes lines for the log, `notify` the state as one line for systemd."""
        self._worker, self._captures, self._arrivals, self._outputs = worker, captures, arrivals, outputs
        self._log, self._notify, self._notify_at = log, notify, 0.0
        self.starting = "the program starts"  # why nothing is tracked yet; empty once it can be
        self.paused = ""  # by what; empty while it is not
        self._updated = time.monotonic()
        self.state, self.reason, self.since = State.STARTING, self.starting, self._updated
        self.unseen = 0.0  # s in which the ball may have turned without being seen
        self._seen_once = False

    def update(self, now: float) -> bool:
        """Update the state and log its changes; True if frames have just stopped."""
        if self.state in _STATES_WITHOUT_BALL and self._seen_once:
            self.unseen += now - self._updated
        self._updated = now
        before, (state, reason) = (self.state, self.reason), self._derive_state(now)
        self._seen_once |= state is State.TRACKING
        if state is not before[0]:
            self.since = now
        lines = self._worker.adapter.take_messages()
        for text in filter(None, (log_line(before, (state, reason), lines.change), *lines.more)):
            self._log(text)
        other = state is not before[0] or strip_digits(reason) != strip_digits(before[1])
        self.state, self.reason = state, reason
        if other or now >= self._notify_at:
            self._notify_at = now + _STATUS_EVERY
            self._notify(f"{state}: {reason}; {self._arrivals.rate(now):.0f} frames/s")
        return state is State.NO_CAMERA and before[0] is not state

    def _derive_state(self, now: float) -> tuple[State, str]:
        worker, captures, starting = self._worker, self._captures, self.starting
        if not starting and captures.attempts <= 1 and worker.seen == 0 and captures.opening:
            starting = captures.trouble
        return derive_state(
            worker.adapter.status,
            starting=starting,
            camera=captures.trouble or worker.trouble or self._arrivals.trouble(now),
            paused=self.paused,
            targets=worker.adapter.waiting,
            ball=worker.adapter.reason,
            output=self._outputs.failed,
        )
