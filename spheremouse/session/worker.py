"""Decode, check and track each frame of a camera; measure times and count faults.

One thread calls it, and it never waits. Other threads read its attributes.
"""

import time
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import replace

from spheremouse.capture.newest import Arrival, ContiguousBuffer
from spheremouse.errors import DamagedFrameError, SourceError, internal_error_text
from spheremouse.session.timing import FrameTimes
from spheremouse.session.tracker_adapter import FrameResult, TrackerAdapter
from spheremouse.tracker import Frame, Status

# Internal errors in so many s that end the process; the service manager restarts it
_MAX_FAULTS, _FAULT_WINDOW_S = (5, 60.0)
_MAX_DAMAGED_S = 1.0  # s of damaged frames alone that are reported


class Worker:
    """Tracks raw frames."""

    def __init__(self, adapter: TrackerAdapter, log: Callable[[str], None], cameras: int = 1) -> None:
        """`cameras` is the number of cameras whose frames come."""
        self.adapter, self._log = adapter, log
        self.refused: dict[int, str] = {}  # reasons why the last frames of these cameras could not be used
        self.frames_of = [0] * cameras  # frames of each camera that were tracked
        self.trouble = ""  # reason why no frame can be used
        self.times: defaultdict[str, FrameTimes] = defaultdict(FrameTimes)  # of each stage; the worker's alone
        self.stages: dict[str, tuple[float, float]] = {}  # s: median and 99 % of each, by `update_stages`
        self.untracked: Frame | None = None  # the present one, if it was decoded and not tracked
        self.unfit = False  # frames arrive that cannot be used, for example of another size
        self.frames = 0  # tracked
        self.seen = 0  # processed
        self.damaged = 0
        self.lost = 0  # times
        self.last_good_at = time.monotonic()  # when a frame last could be used
        self._as_contiguous = ContiguousBuffer()
        self._faults: deque[float] = deque(maxlen=_MAX_FAULTS)

    def work(self, arrival: Arrival, colour: bool = False) -> FrameResult | None:
        """Track a raw frame; in `colour`, even if tracking needs none.

        Return None if it was not tracked: it is damaged, cannot be used, or came too early. The frame of the result,
        and `untracked`, are valid until the raw frame is released. Clear `untracked` then.
        """
        raw, begun = arrival.raw, time.monotonic()
        self.seen += 1
        self.unfit = False
        try:
            frame = self.untracked = self._as_contiguous(
                raw.frame(colour or self.adapter.wants_colour(raw.stamp, arrival.camera))
            )
            if arrival.camera:
                frame = replace(frame, camera=arrival.camera)
            decoded, before = time.monotonic(), self.adapter.status
            made = self.adapter.follow(frame)
        except DamagedFrameError as e:
            self.damaged += 1
            if begun - self.last_good_at > _MAX_DAMAGED_S:
                self.trouble = f"nothing but damaged frames for {begun - self.last_good_at:.0f} s ({e})"
        except SourceError as e:
            self.refused[arrival.camera] = str(e)
            if len(self.refused) == len(self.frames_of):
                self.trouble, self.unfit = str(e), True
        except Exception:
            if self._too_many_faults(begun):
                raise
        else:
            self.trouble, self.last_good_at = "", decoded
            self.refused.pop(arrival.camera, None)
            if made is not None:
                self.untracked = None
                self._count(made, before, {"wait": begun - arrival.taken, "decode": decoded - begun})
            return made
        return None

    def update_stages(self) -> None:
        """Update the times of the stages."""
        self.stages = {
            name: (times.recent_quantile(0.5), times.recent_quantile(0.99)) for name, times in self.times.items()
        }

    def _count(self, result: FrameResult, before: Status, waited: dict[str, float]) -> None:
        self.frames += 1
        self.frames_of[result.frame.camera] += 1
        if self.adapter.status is Status.LOST and before is not Status.LOST:
            self.lost += 1
        now = time.monotonic()
        for name, seconds in (*waited.items(), *result.seconds.items()):
            self.times[name].add(seconds, now)

    def _too_many_faults(self, now: float) -> bool:
        """Log an internal error and restart the tracker. Return True if there were too many."""
        self._log(internal_error_text())
        self.adapter.restart("an internal error; the ball is searched again")
        self._faults.append(now)
        return len(self._faults) == _MAX_FAULTS and now - self._faults[0] < _FAULT_WINDOW_S
