"""Hand-held balls before a live camera: the newest frame tracked, the pointer reported at a steady rate between frames.

Put together of the daemon's parts: a thread that fetches, threads that report, and this one, which tracks. A camera or
an output that fails is waited for. There is no control socket.
"""

import contextlib
import time
import traceback
from collections import deque
from collections.abc import Callable

import numpy as np

from spheremouse.capture import Camera
from spheremouse.capture.fetch import PATIENCE, Capture
from spheremouse.capture.newest import Arrival, Newest
from spheremouse.capture.owned import Owned
from spheremouse.capture.stopping import Stopping
from spheremouse.errors import DamagedFrameError, SourceError
from spheremouse.output.hand import Hand, Moved
from spheremouse.output.reporter import Reporter
from spheremouse.output.sparing import Sparing
from spheremouse.session.process import realtime, threads
from spheremouse.session.process.notify import Notifier
from spheremouse.session.settings import Configuration
from spheremouse.session.wand.messages import Told
from spheremouse.session.wand.offline import check_wand_frame, make_wand_ready
from spheremouse.session.wand.plan import Outputs
from spheremouse.tracker import Frame, Motion
from spheremouse.wand.state import WandEpoch, WandState, WandTracker
from spheremouse.wand.track import begin, step

_TICK = 0.25  # s; the longest wait for a shot
_COMPILING = 900.0  # s that a small computer may take for it
_USELESS = 5.0  # s of frames that cannot be used, after which the camera is opened anew
_DAMAGED = 1.0  # s of nothing but damaged frames that are told
_FAULTS, _FAULTS_WITHIN = 5, 60.0  # errors of our own in so many s that end the run

Show = Callable[[WandEpoch, Moved], None]


class WandLive:
    """One run. Everything is given back when `run` returns."""

    def __init__(
        self,
        tracker: WandTracker,
        configuration: Configuration,
        open_camera: Callable[[], Camera],
        outputs: Outputs,
        told: Told,
        *,
        say: Callable[[str], None],
        show: Show = lambda _, __: None,
        frames: int | None = None,
    ) -> None:
        """`say` takes lines from any thread; `show` sees each tracked frame; `frames` ends the run after so many."""
        self._tracker, self._configuration, self._outputs, self._told = tracker, configuration, outputs, told
        self._say, self._show, self._limit = Sparing(say), show, frames
        self._points = configuration.wand.points - 1
        self._hand = Hand(configuration.wand.pointing, self._points)
        self._ring = Newest()
        self._capture = Capture(open_camera, self._ring, say)
        self._state: WandState | None = None
        self._own = Owned()
        self._trouble = ""  # why no frame can be used
        self._good = self._cured = self._last = 0.0  # s: a frame could be used, was mended by reopening, came at all
        self._interrupted = True
        self._notifier = Notifier()
        self._faults: deque[float] = deque(maxlen=_FAULTS)
        self._reporters: list[Reporter] = []
        self.frames = self.seen = 0  # tracked, and worked on
        self.finished = False  # a recording is at its end

    def run(self, stopping: Stopping) -> None:
        """Until it is asked to stop, a recording ends, or whoever read an output has gone."""
        notifier = self._notifier
        with contextlib.ExitStack() as stack:
            stack.callback(notifier.stopping)
            notifier.ready()
            notifier.patience(_COMPILING)
            make_wand_ready()
            notifier.usual()
            first = self._configuration.realtime == "auto"
            realtime.prepare(first)
            quiet = stack.enter_context(contextlib.closing(realtime.Quiet()))
            for open_output in filter(None, (self._outputs.open_pointer, self._outputs.open_axes)):
                self._reporters.append(
                    Reporter(open_output, self._configuration.pointer, self._say, begin=threads.begin)
                )
                stack.callback(self._reporters[-1].close)
            self._capture.start()
            stack.callback(self._capture.close)
            if first:
                for thread in (self._capture, self._reporters[0]):
                    realtime.claim(thread.native_id)
            self._good = self._cured = self._last = time.monotonic()
            self._loop(stopping, quiet)

    @property
    def latency(self) -> tuple[float, float] | None:
        """s from a frame's stamp until its motion was sent: median, 99 %."""
        latency = self._reporters[0].status().latency if self._reporters else None
        return None if latency is None else (latency.p50, latency.p99)

    def _loop(self, stopping: Stopping, quiet: realtime.Quiet) -> None:
        while not stopping.asked and not any(r.ended for r in self._reporters):
            arrival = self._ring.take(_TICK)
            now = time.monotonic()
            if arrival is not None:
                self._last = now
                try:
                    self._work(arrival, now)
                finally:
                    arrival.shot.release()
                if self._limit is not None and self.frames >= self._limit:
                    break
            elif self._capture.finished:
                if self._capture.failure is not None:
                    raise self._capture.failure
                self.finished = True
                break
            self._look_after_camera(now)
            silent = now - self._last > PATIENCE
            self._notifier.progress(("attempts", self._capture.attempts) if silent else ("frames", self.seen))
            self._say.tend()
            quiet.rest(now)

    def _look_after_camera(self, now: float) -> None:
        """Say what is wrong with it; open it anew where its frames cannot be used."""
        trouble = "" if self._capture.opening else self._capture.trouble or self._trouble
        if not trouble and now - self._last > PATIENCE + 1.0:
            trouble = f"the camera has given no frame for {now - self._last:.0f} s"
        self._tell(self._told.camera(trouble))
        if trouble and not self._interrupted:
            self._interrupt(now)
        if self._trouble and not self._capture.trouble and now - max(self._good, self._cured) > _USELESS:
            self._cured = now
            self._capture.again()

    def _interrupt(self, now: float) -> None:
        """No frame can be used: the pointer is not carried on."""
        self._interrupted = True
        self._hand.interrupted()
        self._reporters[0].give(Motion(now, (0, 0, 0), np.zeros(3), np.zeros(3)), (0.0, 0.0, 0.0), now, False)

    def _work(self, arrival: Arrival, now: float) -> None:
        """A shot; what cannot be used is remembered as the trouble."""
        self.seen += 1
        try:
            frame = self._own(arrival.shot.frame(True))
            check_wand_frame(frame, self._tracker)
            self._trouble, self._good, self._interrupted = "", now, False
            self._track(frame, arrival.taken)
        except DamagedFrameError as e:
            if now - self._good > _DAMAGED:
                self._trouble = f"nothing but damaged frames for {now - self._good:.0f} s ({e})"
        except SourceError as e:
            self._trouble = str(e)
        except Exception:
            self._say("internal error, please report it:\n" + traceback.format_exc().rstrip())
            self._state = None
            self._hand.interrupted()
            self._faults.append(now)
            if len(self._faults) == _FAULTS and now - self._faults[0] < _FAULTS_WITHIN:
                raise

    def _track(self, frame: Frame, taken: float) -> None:
        start = time.perf_counter()
        before = self._state or begin(self._tracker, 0, frame.stamp)
        self._state, poses = step(before, frame, self._tracker)
        epoch = WandEpoch(frame, poses, self._state, time.perf_counter() - start)
        made = self._hand.move(epoch)
        for axes in self._outputs.axes:
            axes.expect(frame.stamp, poses)
        self._told.camera("")
        self._tell(self._told.frame(frame.stamp, poses, frame.image, self._points))  # before anything moves
        for reporter in self._reporters:
            reporter.give(made.motion, made.rate, taken, made.holds)
        self.frames += 1
        self._show(epoch, made)

    def _tell(self, lines: list[str]) -> None:
        for line in lines:
            self._say(line)
            self._notifier.status(line)
