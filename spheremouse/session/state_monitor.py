"""State and reason of a run, updated at each turn of the loop, and logged when they change."""

import time
from collections.abc import Callable

from spheremouse.capture.fetch import Capture
from spheremouse.output.rate_limited_logger import strip_digits
from spheremouse.session.arrivals import Arrivals
from spheremouse.session.outputs import Outputs
from spheremouse.session.states import Conditions, State, derive_state, news
from spheremouse.session.worker import Worker

_STATUS_EVERY = 20.0  # s between two lines for systemd where nothing changes
_UNSEEN = (State.NO_CAMERA, State.SEARCHING_TARGETS, State.LOST)  # in which the ball may turn without being seen


class StateMonitor:
    """State, reason and since when. Called by the worker's thread; attributes may be read by others."""

    def __init__(
        self,
        worker: Worker,
        capture: Capture,
        arrivals: Arrivals,
        outputs: Outputs,
        *,
        say: Callable[[str], None],
        tell: Callable[[str], None],
    ) -> None:
        """`say` takes lines for the log, `tell` how it is in one line for systemd."""
        self._worker, self._capture, self._arrivals, self._outputs = worker, capture, arrivals, outputs
        self._say, self._tell, self._tell_at = say, tell, 0.0
        self.starting = "the program is being made ready"  # why nothing is tracked yet; empty once it can be
        self.paused = ""  # by what; empty while it is not
        self._judged = time.monotonic()
        self.state, self.reason, self.since = State.STARTING, self.starting, self._judged
        self.unseen = 0.0  # s in which the ball may have turned without being seen
        self._seen_once = False

    def update(self, now: float) -> bool:
        """Update the state and log its changes; True if frames have just stopped."""
        if self.state in _UNSEEN and self._seen_once:
            self.unseen += now - self._judged
        self._judged = now
        before, (state, reason) = (self.state, self.reason), derive_state(self._facts(now))
        self._seen_once |= state is State.TRACKING
        if state is not before[0]:
            self.since = now
        told = self._worker.follower.take_news()
        for text in filter(None, (news(before, (state, reason), told.change), *told.more)):
            self._say(text)
        other = state is not before[0] or strip_digits(reason) != strip_digits(before[1])
        self.state, self.reason = state, reason
        if other or now >= self._tell_at:
            self._tell_at = now + _STATUS_EVERY
            self._tell(f"{state}: {reason}; {self._arrivals.rate(now):.0f} frames/s")
        return state is State.NO_CAMERA and before[0] is not state

    def _facts(self, now: float) -> Conditions:
        worker, capture, starting = self._worker, self._capture, self.starting
        if not starting and capture.attempts <= 1 and worker.seen == 0 and capture.opening:
            starting = capture.trouble
        return Conditions(
            starting=starting,
            camera=capture.trouble or worker.trouble or self._arrivals.trouble(now),
            paused=self.paused,
            targets=worker.follower.waiting,
            ball=worker.follower.reason,
            output=self._outputs.pointer.failed or "",
            tracker=worker.follower.status,
        )
