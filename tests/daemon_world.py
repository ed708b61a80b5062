"""A cabinet for the daemon: a film of a simulated ball behind a scripted camera, and an output that writes down.

The camera gives frames as fast as they are taken, their stamps 1/30 s apart. The ball rests until it is asked to turn,
then plays the film forwards and backwards; what was shown is known, so that what is sent can be judged. Faults are
attributes, changed while it runs.
"""

import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.rig import Rig
from spheremouse.capture import Payload
from spheremouse.errors import ControlError, DamagedFrameError, OutputError, SourceError
from spheremouse.files.rig import rig_text
from spheremouse.geometry.rotation import Array, log
from spheremouse.output import Output
from spheremouse.output.counts import MotionSettings
from spheremouse.session.control.client import Client
from spheremouse.session.live_run import LiveRun
from spheremouse.session.run_config import CommandLineOverrides, RunConfig, read_run_config
from spheremouse.session.service import Daemon
from spheremouse.session.setup import Setup
from spheremouse.simulate.ball.profile import Gesture, Gestures
from spheremouse.simulate.ball.render import Renderer
from spheremouse.simulate.ball.scene import Scene, default_scene
from spheremouse.tracker import Frame
from tests.raw_picture import payload_of

DT = 1.0 / 30.0  # s between two stamps
PATIENCE = 30.0  # s, for what takes a fraction of one
CLOSE = 3.0  # counts: the estimate at either end, and rounding

CONFIG = """\
schema: 2
source: film:played
output: sink:quiet
rig: rig.yaml
realtime: "off"
pose: {frames: 3}
pointer: {horizon: 0}
control: {socket: %s}
record: {folder: %s, seconds: 20}
"""


@dataclass(frozen=True)
class Film:
    """Pictures from rest to rest, and what they show."""

    colour: list[NDArray[np.uint8]]
    grey: list[NDArray[np.uint8]]
    attitude: Array  # (n, 3, 3) R_obj_ball
    rig: Rig

    @classmethod
    @cache  # two seconds
    def render(cls) -> "Film":
        return cls.of(default_scene())

    @classmethod
    def of(cls, scene: Scene, length: int = 48, aside: Array | None = None, rendered: int | None = None) -> "Film":
        """`aside`: R_first_obj of a camera that stands there, and not in front. The attitudes are in its axes.

        `rendered`: pictures from the first on; None: all.
        """
        seconds = length * DT
        s = seconds / 5.0
        gestures = (
            Gesture(0.0, 2.5 * s, (0.6, 0.0, 0.8), 2.0 * s),
            Gesture(1.5 * s, 2.2 * s, (0.0, 1.0, 0.0), -1.3 * s),
            Gesture(2.8 * s, 2.2 * s, (0.9746794344808964, 0.0, -0.22360679774997896), 1.8 * s),
        )
        rng, profile = np.random.default_rng(0), Gestures(gestures, seconds, None if aside is None else aside.T)
        renderer = Renderer(scene)
        made = [renderer.frame(profile, seconds * k / (length - 1), k, rng) for k in range(rendered or length)]
        colour = [m.frame.image for m in made]
        grey = [np.asarray(cv2.cvtColor(c, cv2.COLOR_BGR2GRAY), dtype=np.uint8) for c in colour]
        return cls(colour, grey, np.array([m.attitude for m in made]), scene.rig())


class RawFrame:
    def __init__(self, world: "World", stamp: float, sequence: int, place: int, fault: str) -> None:
        self.stamp, self.sequence, self.place = stamp, sequence, place
        self._world, self._fault, self._out = world, fault, True

    def frame(self, colour: bool) -> Frame:
        assert self._out, "a raw frame that was given back is looked at"
        if self._fault == "damaged":
            self._world.damaged += 1
            raise DamagedFrameError("half of it is missing")
        if self._fault == "internal":
            raise ZeroDivisionError("as if we had made a mistake")
        image = self._world.image(self.place, colour, self._fault)
        if self._fault == "size":
            image = image[:240, :320]
        return Frame(np.asarray(image, dtype=np.uint8), self.stamp, self.sequence)

    def payload(self) -> Payload:
        assert self._out, "a raw frame that was given back is looked at"
        if self._fault == "damaged":
            raise DamagedFrameError("half of it is missing")
        return payload_of(self._world.image(self.place, self._world.colour_alone, self._fault))

    def release(self) -> None:
        if self._out:
            self._out = False
            self._world.given_back()


class World:
    """Everything outside of the daemon, and the daemon within it."""

    setup = Setup()
    colour_alone = False  # the camera gives no grey pictures
    second: "World | None" = None  # with the second camera
    saved: Path | None = None  # the file of saved settings of a service

    def __init__(self, film: Film, folder: Path, pace: float = 0.002) -> None:
        """`pace` s is rested between two frames, so that others get at the processor."""
        self.film, self.folder, self._pace = film, folder, pace
        # what goes wrong
        self.missing = ""  # why the camera cannot be opened, or has gone
        self.silent = False  # it gives no frames
        self.paced = False  # it gives a frame every DT, whether or not the ones before were released
        self.hang: threading.Event | None = None  # its driver hangs until it is set
        self.carried = False  # the pointer is carried on between frames
        self.fault = ""  # of the frames: damaged, internal, size, dark, hidden
        self.broken = ""  # why the output cannot send
        self.gate: threading.Event | None = None  # sending hangs until it is set
        # what was
        self.place, self._way, self.moves = 0, 1, 0
        self.sequence = 0
        self.produced = 0  # raw frames
        self.damaged = 0  # of those, damaged ones that the daemon looked at
        self.shown: dict[float, int] = {}  # stamp -> place in the film
        self.cameras = 0  # open now
        self.opened = 0
        self.out = 0  # raw frames not given back
        self._free = threading.Event()
        self._free.set()
        self._due = 0.0
        self.stamp = time.monotonic()
        self.sent: list[Any] = []  # motions
        self.outputs: list[str] = []  # opened
        self.device = False  # is the output's device open?
        self.said: list[str] = []
        self.states: dict[float, str] = {}  # stamp of a tracked frame -> state then
        self.frames: list[Any] = []  # counts of tracked frames
        self._lock = threading.Lock()
        self.error: BaseException | None = None
        self.stop_requested = False
        self.config = folder / "config.yaml"
        self.socket = folder / "s"
        if not self.config.exists():
            self.config.write_text(CONFIG % (self.socket, folder / "recordings"))
            (folder / "rig.yaml").write_text(rig_text(film.rig))
        self.daemon: Daemon | None = None
        self._thread: threading.Thread | None = None
        self.client = Client(self.socket)

    # ---- the camera ----

    def opener(self, plan: RunConfig) -> Callable[[], "World"]:
        """Of the camera of a plan with one."""
        return self.second.open_camera if self.second is not None and plan.source.endswith("side") else self.open_camera

    def open_camera(self) -> "World":
        if self.missing:
            raise SourceError(self.missing)
        return self

    def next(self, timeout: float) -> RawFrame | None:
        """The next frame, once the one before was looked at."""
        if self.hang is not None:
            self.hang.wait(PATIENCE)
        if self.missing:
            raise SourceError(self.missing)
        if self.paced:
            self._due = max(self._due + DT, time.monotonic() - DT)
            time.sleep(max(0.0, self._due - time.monotonic()))
        elif not self._free.wait(timeout):
            return None
        if self.silent:
            time.sleep(0.01)
            return None
        time.sleep(self._pace)
        if self.moves > 0:
            self.moves -= 1
            self.place += self._way
            if self.place in (0, len(self.film.grey) - 1):
                self._way = -self._way
        self.stamp += DT
        self.sequence += 1
        self.produced += 1
        self.shown[self.stamp] = self.place
        self._free.clear()
        with self._lock:
            self.out += 1
        return RawFrame(self, self.stamp, self.sequence, self.place, self.fault)

    def image(self, place: int, colour: bool, fault: str, film: Film | None = None) -> NDArray[np.uint8]:
        film = film or self.film
        image = (film.colour if colour else film.grey)[place]
        if fault == "dark":
            return np.zeros_like(image)
        if fault == "hidden" and colour:
            return np.asarray(cv2.cvtColor(film.grey[place], cv2.COLOR_GRAY2BGR), dtype=np.uint8)
        return image

    def given_back(self) -> None:
        with self._lock:
            self.out -= 1
            if self.out == 0:
                self._free.set()

    def describe(self) -> str:
        return "a film"

    def __enter__(self) -> "World":
        self.cameras += 1
        self.opened += 1
        return self

    def __exit__(self, *_: object) -> None:
        self.cameras -= 1

    # ---- the output ----

    def open_output(self, spec: str) -> Output:
        self.outputs.append(spec)
        if self.broken:
            raise OutputError(self.broken)
        return Sink(self)

    def received(self, report: Any) -> None:
        """Take a report that the output sends."""
        self.sent.append(report)

    @property
    def counts(self) -> Array:
        return np.sum([m.counts for m in self.sent], axis=0) if self.sent else np.zeros(3)

    # ---- the daemon ----

    def start(
        self,
        assignments: tuple[str, ...] = (),
        watch: Callable[[Any, Any, Any], None] | None = None,
        frames: int | None = None,
    ) -> Daemon:
        """The daemon, in a thread; what is counted begins with it."""
        self.produced, self.sent, self.outputs, self.states, self.frames = 0, [], [], {}, []
        overrides = CommandLineOverrides(self.config, assignments, saved=self.saved)

        def show(made: Any, report: Any, _: Any) -> None:
            assert self.daemon is not None
            self.states[made.frame.stamp] = str(self.daemon.status().state)
            self.frames.append(report.counts)

        plan, opener = read_run_config(overrides), self.opener
        parts = LiveRun(overrides, plan, self.setup, opener, self.said.append)  # pyright: ignore[reportArgumentType]
        self.daemon = Daemon(parts, show=show if watch is None else watch, frames=frames)
        self.stop_requested = False
        self._thread = threading.Thread(target=self._run, name="daemon")
        self._thread.start()
        return self.daemon

    def _run(self) -> None:
        assert self.daemon is not None
        try:
            self.daemon.run(self)  # pyright: ignore[reportArgumentType]  all it looks at is `stop_requested`
        except BaseException as e:
            self.error = e

    def stop(self) -> None:
        """End it, and see that nothing is left."""
        self.stop_requested = True
        self.join()
        assert self.cameras == 0
        assert self.out == 0
        assert not self.socket.exists()

    def join(self) -> None:
        assert self._thread is not None
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive(), "the daemon does not end"

    def ask(self, command: str, **arguments: Any) -> dict[str, Any]:
        return self.client.ask(command, **arguments)

    def refused(self, command: str, **arguments: Any) -> str:
        """Return the error of a request, which must be refused."""
        try:
            reply = self.ask(command, **arguments)
        except ControlError as e:
            return str(e)
        raise AssertionError(f"{command} was not refused but answered by {reply}")

    def try_to_ask(self, command: str) -> dict[str, Any]:
        """Return the reply to a request, {} if it is refused."""
        try:
            return self.ask(command)
        except ControlError:
            return {}

    def until_recorded(self, frames: int) -> None:
        """Wait until a recording has more than so many frames."""
        self.until(lambda: (self.ask("status")["recording"] or {}).get("frames", 0) > frames, "frames recorded")

    def logged(self, text: str) -> list[str]:
        return [line for line in self.said if text in line]

    def times_logged(self, text: str) -> int:
        more = (map(int, re.findall(r"\((\d+) more like it\)", line)) for line in self.logged(text))
        return sum(1 + sum(counted) for counted in more)

    @property
    def state(self) -> str:
        assert self.daemon is not None
        return str(self.daemon.status().state)

    def until(self, condition: Callable[[], Any], what: str = "") -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            if self._thread is not None and not self._thread.is_alive() and self.error is not None:
                raise self.error
            assert time.monotonic() < end, f"it never came to be: {what}; {self.state}; {self.said}"
            time.sleep(0.002)

    def reach(self, state: str) -> None:
        self.until(lambda: self.state == state, state)

    def turn(self, frames: int | None = None) -> None:
        """Let the ball turn for so many frames, by default to the film's other end; until they have been tracked."""
        self.moves = len(self.film.grey) - 1 if frames is None else frames
        self.until(lambda: self.moves == 0, "frames played")
        self.settle()

    def settle(self, frames: int = 2) -> None:
        n = self.produced + frames
        self.until(lambda: self.produced > n, "frames")

    # ---- laws ----

    def true_counts(self, since: float = -np.inf, until: float = np.inf) -> Array:
        """(3,) counts of the true motion between two stamps."""
        M = matrix(self.film.rig)
        places = [p for stamp, p in tuple(self.shown.items()) if since <= stamp <= until]
        R = self.film.attitude[places]
        turns = [log(b @ a.T) for a, b in pairwise(R)]
        return M @ np.sum(turns, axis=0) if turns else np.zeros(3)

    def check_counts(self) -> None:
        """All that was sent is the motion of all that was shown."""
        assert np.abs(self.counts - self.true_counts()).max() < CLOSE

    def check_next_turn(self, scale: tuple[float, float, float] = (1, 1, 1)) -> None:
        """What a turn sends from now on is its motion, times the scale."""
        before, since = self.counts, self.stamp
        self.turn()
        assert np.abs(self.counts - before - self.true_counts(since) * scale).max() < max(scale) * CLOSE

    def check_laws(self) -> None:
        """Nothing moved in any state but tracking; what frames gave was sent, or was counted as unsent."""
        assert self.daemon is not None
        for sent in self.sent:
            state = self.states.get(sent.stamp)
            assert state in (None, "tracking") or not any(sent.counts), f"{sent.counts} while {state}"
            assert state is not None or self.carried or not any(sent.counts), "a report that belongs to no frame"
        status = self.daemon.status()
        report = status.outputs[0]
        given = np.sum(self.frames, axis=0) if self.frames else np.zeros(3)
        assert np.array_equal(self.counts + report.unsent + left_over(self.daemon) - report.ahead, given)
        assert report.reports == sum(any(m.counts) for m in self.sent)
        taken = self.daemon.parts.worker.seen
        assert taken + (status.skipped or 0) == self.produced + (self.second.produced if self.second else 0)
        assert status.frames == len(self.frames)  # also across another rig, which has another worker


class Sink(Output):
    """An output that writes down."""

    paced = True

    def __init__(self, world: World) -> None:
        self.world = world

    def send(self, report: Any) -> None:
        gate = self.world.gate
        if gate is not None:
            gate.wait(PATIENCE)
        if self.world.broken:
            raise OutputError(self.world.broken)
        self.world.received(report)

    def __enter__(self) -> "Sink":
        assert not self.world.device, "opened before the one before was closed"
        self.world.device = True
        return self

    def __exit__(self, *_: object) -> None:
        time.sleep(0.05)
        self.world.device = False


def left_over(daemon: Daemon) -> Array:
    """(3,) counts still in the reporter's queue when it was closed."""
    return np.array(daemon.parts.outputs.main.thread.queued)


def matrix(rig: Rig) -> Array:
    return MotionSettings().matrix(rig.ball.radius)
