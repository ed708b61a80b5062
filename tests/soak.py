"""A long session with everything that goes wrong in one: `python -m tests.soak [--short] [--frames N] [--seed S]`.

Two sessions of the default tracker, one from pictures (a film of the simulated far scene, rendered once and played
forwards and backwards, so that the truth is known and a frame costs nothing) and one from detections, and short ones of
the published trackers. Between spells of ordinary play comes a fault: black, white and noisy frames, a lens cap, frozen
and dropped frames, clocks that jump, hands, another brightness, a frame of the wrong size.

What must hold, always: nothing is raised but SourceError for the frame of the wrong size; no number is nan; no motion
while the ball is not tracked; counts sum to the rotations sent within one; memory stays flat. And of the default
tracker: within 2 s of the end of a fault it tracks, and its attitude is right, unless it has said that it was reset.
"""

import argparse
import math
import sys
import time
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.detections import Detections, no_detections
from spheremouse.ball.events import NewMap, Recognised
from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Tracker, TrackState
from spheremouse.ball.track import advance, step
from spheremouse.errors import SourceError
from spheremouse.geometry.camera import InteriorOrientation, Pose, project
from spheremouse.geometry.rotation import Array, exp, log
from spheremouse.output.counts import Counter as Counts
from spheremouse.output.counts import MotionSettings
from spheremouse.output.rate_limited_logger import strip_digits
from spheremouse.session import messages
from spheremouse.session.offline import initialise
from spheremouse.session.timing import memory_mb
from spheremouse.simulate.ball.events import HandVisit, PlacedHand, draw_hand, place_hand
from spheremouse.simulate.ball.scene import default_scene, spread_directions
from spheremouse.tracker import Event, Frame, Status, Step
from tests.daemon_world import Film

DT = 1.0 / 30.0
RESUMED = 2.0  # s after a fault, by the stamps, until the ball must be tracked again
RIGHT = math.radians(1.0)  # error of an attitude that counts as right
GROWTH = 12.0  # MB that resident memory may grow after the warm-up: heaps fragment, leaks go on
MASKS = 100  # look-alikes: the simulated room has fewer

SESSIONS = ("so3 on detections", "so3 on pictures", "ekf1 on detections", "ekf2 on detections")
FAULTS = {  # frames that each lasts, from and to
    "black": (1, 60),
    "white": (1, 60),
    "noise": (1, 60),
    "cap": (1, 400),
    "frozen": (1, 60),
    "dropped": (1, 90),
    "clock on": (1, 1),
    "clock back": (1, 1),
    "stutter": (1, 30),
    "hands": (20, 200),
    "light": (5, 200),
    "grey": (1, 60),
    "wrong size": (1, 5),
}


class World(Protocol):
    """A ball that turns, and what is seen of it."""

    tracker: Tracker
    faults: tuple[str, ...]

    @property
    def attitude(self) -> Array:
        """True R_obj_ball, (3, 3)."""
        ...

    def turn(self) -> None: ...

    def step(self, state: TrackState, stamp: float, fault: str | None) -> Step[TrackState]:
        """Look at the ball through the fault, and track it."""
        ...


class Pictures:
    """A film from rest to rest, played to its end, backwards to its beginning, and so on, with rests between."""

    faults = tuple(FAULTS)

    def __init__(self, settings: Settings, rng: np.random.Generator, length: int) -> None:
        self._rng = rng
        film = Film.render(length)
        self._film, self._true, rig = film.colour, film.attitude, film.rig
        self._hands = _hands()
        still = [Frame(self._film[0], k * DT, k) for k in range(3)]
        start = initialise(iter(still), rig, replace(settings, pose=replace(settings.pose, frames=3)))
        self.tracker = build(rig, start.pose, settings)
        self._noise = [rng.integers(0, 256, self._film[0].shape, dtype=np.uint8) for _ in range(4)]
        self._place, self._way, self._rest = 0, 1, 30
        self._frozen: NDArray[np.uint8] | None = None
        self._light = 0.0

    @property
    def attitude(self) -> Array:
        return self._true[self._place]

    def turn(self) -> None:
        if self._rest:
            self._rest -= 1
            return
        self._place += self._way
        if self._place in (0, len(self._film) - 1):
            self._way, self._rest = -self._way, int(self._rng.integers(1, 60))

    def step(self, state: TrackState, stamp: float, fault: str | None) -> Step[TrackState]:
        return step(state, Frame(self._look(fault), stamp, 0), self.tracker)

    def _look(self, fault: str | None) -> NDArray[np.uint8]:
        image, rng = self._film[self._place], self._rng
        if fault != "frozen":
            self._frozen = None
        if fault != "light":
            self._light = float(rng.choice([-50.0, 50.0]))
        match fault:
            case "black":
                return np.zeros_like(image)
            case "white":
                return np.full_like(image, 255)
            case "noise":
                return self._noise[int(rng.integers(len(self._noise)))]
            case "cap":
                return self._noise[int(rng.integers(len(self._noise)))] // 32
            case "frozen":
                self._frozen = image if self._frozen is None else self._frozen
                return self._frozen
            case "hands":
                return _behind(self._hands[self._place % len(self._hands)], image)
            case "light":
                return np.asarray(cv2.add(image, np.full(4, self._light)), dtype=np.uint8)
            case "grey":
                return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
            case "wrong size":
                return image[: -int(rng.integers(1, 400))]
        return image


def _hands() -> list[list[PlacedHand]]:
    hand, scene = draw_hand(), default_scene()
    visits = (HandVisit(0.0, 30.0, True), HandVisit(0.0, 30.0, False))
    return [[p for v in visits if (p := place_hand(hand, v, scene, 0.3 + 0.1 * k)) is not None] for k in range(20)]


def _behind(hands: list[PlacedHand], image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    image = image.copy()
    for hand in hands:
        part = image[hand.place] * (1.0 - hand.paint[..., 3:]) + hand.paint[..., :3]
        image[hand.place] = np.clip(part, 0, 255).astype(np.uint8)
    return image


_POINTS_RIG = Rig(
    InteriorOrientation(640, 480, 640.0, 640.0, 320.0, 240.0),
    Ball(0.6),
    Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3)),
    0.02,
)
_POINTS_POSE = Pose(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.array([0.0, 0.0, 2.35]))
_BOLTS = np.array([[300.0, 100.0], [250.0, 380.0], [420.0, 250.0], [200.0, 200.0]])  # px
_SIGMA = 0.05  # px


class Points:
    """A ball that is turned this way and that, at random and without end, seen as its discs' centres and four bolts."""

    faults = tuple(f for f in FAULTS if f not in ("white", "light", "grey", "wrong size"))  # black stands for them

    def __init__(self, settings: Settings, rng: np.random.Generator) -> None:
        self._rng = rng
        self.tracker = build(_POINTS_RIG, _POINTS_POSE, settings)
        self._discs = spread_directions(26, 0.2, np.random.default_rng(0))
        self.attitude = np.eye(3)
        self._rate, self._pull = np.zeros(3), np.zeros(3)  # rad/s; what the rate is drawn towards
        self._rest = 30
        self._frozen: Detections | None = None

    def turn(self) -> None:
        if self._rest > 0:
            self._rest -= 1
        elif self._rng.random() < DT / 1.5:
            self._pull = 0.6 * self._rng.standard_normal(3)
            if self._rng.random() < 0.2:
                self._pull, self._rest = np.zeros(3), int(self._rng.integers(30, 90))
        before = self._rate
        self._rate = before + (self._pull - before) * (1.0 - math.exp(-DT / 0.25))
        self.attitude = exp(0.5 * (before + self._rate) * DT) @ self.attitude

    def step(self, state: TrackState, stamp: float, fault: str | None) -> Step[TrackState]:
        return advance(state, stamp, self._look(fault), self.tracker)

    def _look(self, fault: str | None) -> Detections:
        rng = self._rng
        if fault != "frozen":
            self._frozen = None
        if fault in ("black", "cap"):
            return no_detections()
        if fault == "noise":
            return self._detected(rng.uniform((120, 40), (520, 440), (int(rng.integers(0, 60)), 2)))
        p = self._discs @ self.attitude.T
        uv = project(_POINTS_POSE.to_cam(_POINTS_RIG.ball.radius * p[p[:, 2] > 0.35]), _POINTS_RIG.camera)[0]
        uv = np.concatenate([uv, _BOLTS])
        if fault == "hands":
            uv = uv[rng.random(len(uv)) < 0.4]
        seen = self._detected(uv + _SIGMA * rng.standard_normal(uv.shape))
        if fault == "frozen":
            self._frozen = seen if self._frozen is None else self._frozen
            return self._frozen
        return seen

    @staticmethod
    def _detected(uv: Array) -> Detections:
        return Detections(uv, np.tile(_SIGMA**2 * np.eye(2), (len(uv), 1, 1)), np.full(len(uv), 50.0))


@dataclass
class Report:
    name: str
    frames: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    slowest_resume: float = 0.0  # s
    worst_error: float = 0.0  # rad, of an attitude that is due to be right
    most_discs: int = 0
    most_masks: int = 0
    growth: float = 0.0  # MB after the warm-up
    seconds: float = 0.0


@dataclass
class Judge:
    world: World
    report: Report
    judged: bool  # is the attitude to be right?
    seed: int
    # true attitude @ reference = the estimate; more than one after a failure, for the tracker may find back
    references: list[Array] = field(default_factory=lambda: [np.eye(3)])
    pointer: Counts = field(init=False)
    exact: Array = field(default_factory=lambda: np.zeros(3))  # counts as they should be
    counts: Array = field(default_factory=lambda: np.zeros(3))
    good_since: float | None = None  # s, stamp of the first good frame after the last fault
    resumed: bool = False
    history: deque[str] = field(default_factory=lambda: deque(maxlen=6))  # faults and events until now

    def __post_init__(self) -> None:
        self.pointer = Counts(MotionSettings().matrix(self.world.tracker.rig.radius_m))

    def fail(self, frame: int, text: str) -> None:
        self.report.failures.append(
            f"{self.report.name}, seed {self.seed}, frame {frame}: {text}\n         before: {' | '.join(self.history)}"
        )

    def begin_fault(self, frame: int, fault: str, length: int) -> None:
        self.report.faults[fault] += 1
        self.history.append(f"{frame} {fault} for {length} frames")
        self.good_since, self.resumed = None, False

    def look(self, frame: int, fault: str | None, stamp: float, made: Step[TrackState]) -> None:
        state, estimate, events = made
        counts = self.pointer.counts(estimate)[0]
        f: Any = state.filter
        numbers = (
            f.attitude, f.rate, f.covariance, f.discs, estimate.increment[:3], estimate.rate, estimate.covariance
        )  # fmt: skip
        if not all(np.all(np.isfinite(n)) for n in (*numbers, getattr(f, "joint", 0.0))):
            self.fail(frame, "a number that is not finite")
        if np.abs(f.attitude @ f.attitude.T - np.eye(3)).max() > 1e-9:
            self.fail(frame, "the attitude is no rotation")
        if np.diag(f.covariance).min() < 0.0:
            self.fail(frame, "a negative variance")
        if state.status is not Status.TRACKING and (any(counts) or np.any(estimate.increment[:3])):
            self.fail(frame, f"motion {counts} while {state.status}")
        self.exact += self.pointer.matrix @ estimate.increment[:3]
        self.counts += counts
        sent = self.exact - self.pointer.matrix @ self.pointer.withheld
        if np.abs(sent - self.counts).max() > 1.0 + 1e-6:
            self.fail(frame, f"counts {self.counts} are not the integral {sent} of the rotations sent")
            self.exact = self.counts.copy()
        if events:
            self.report.events[strip_digits(messages.line(events).partition(";")[0])] += 1
            self.history.append(f"{frame} {messages.line(events)}")
        self.report.most_discs = max(self.report.most_discs, len(f.discs))
        self.report.most_masks = max(self.report.most_masks, len(state.lookalikes.masks))
        if self.judged:
            self._attitude(frame, fault, stamp, state, events)

    def _attitude(
        self, frame: int, fault: str | None, stamp: float, state: TrackState, events: tuple[Event, ...]
    ) -> None:
        true = self.world.attitude
        if NewMap() in events:
            self.references = [true.T @ state.filter.attitude]
        error = min(float(np.linalg.norm(log(state.filter.attitude @ (true @ R).T))) for R in self.references)
        if any(isinstance(e, Recognised) for e in events) and fault is None and error > RIGHT:
            self.fail(frame, f"says the attitude is kept, and it is wrong by {math.degrees(error):.1f} deg")
        if fault is not None:
            return
        if self.good_since is None or stamp < self.good_since:
            self.good_since = stamp
        good_for = stamp - self.good_since
        right = state.status is Status.TRACKING and len(state.filter.used) >= 2 and error < RIGHT
        if right and not self.resumed:
            self.resumed = True
            self.report.slowest_resume = max(self.report.slowest_resume, good_for)
        if good_for < RESUMED:
            return
        if right:
            self.report.worst_error = max(self.report.worst_error, error)
            return
        used, wrong = len(state.filter.used), math.degrees(error)
        self.fail(
            frame, f"{good_for:.2f} s after the fault {state.status}, {used} discs used, wrong by {wrong:.1f} deg"
        )
        self.references.append(true.T @ state.filter.attitude)  # told; from here on it is to be right again
        self.good_since = None


def spells(faults: tuple[str, ...], frames: int, rng: np.random.Generator) -> Iterator[tuple[str | None, int]]:
    """What comes when: a fault or None, and for how many frames. Most faults have time to heal, some follow at once."""
    yield None, 150
    left = frames - 150
    due: list[str] = []
    while left > 0:
        due = due or [str(f) for f in rng.permutation(faults)]
        fault = due.pop()
        low, high = FAULTS[fault]
        length = int(np.exp(rng.uniform(np.log(low), np.log(high + 1))))
        yield fault, length
        pause = int(rng.integers(1, 30)) if rng.random() < 0.2 else int(rng.integers(65, 150))
        yield None, pause
        left -= length + pause


def session(world: World, name: str, frames: int, seed: int, judged: bool) -> Report:
    """Play `frames` frames with faults; what was wrong stands in the report."""
    rng = np.random.default_rng([seed, 1])
    report = Report(name)
    judge = Judge(world, report, judged, seed)
    state = begin(world.tracker, 0.0)
    clock, offset, settled, began = 0.0, 0.0, math.nan, time.perf_counter()
    for fault, length in spells(world.faults, frames, rng):
        if fault is not None:
            judge.begin_fault(report.frames, fault, length)
        for _ in range(length):
            world.turn()
            clock += DT
            report.frames += 1
            if fault == "dropped":
                continue
            if fault == "clock on":
                offset += float(10.0 ** rng.uniform(-2, 5))
            elif fault == "clock back":
                offset -= float(10.0 ** rng.uniform(-2, 5))
            stamp = clock + offset
            if fault == "stutter":  # stamps that repeat, or are late or early by some frames
                stamp += float(rng.choice([-3.0, -1.0, 0.0, 2.0])) * DT
            through = None if fault in ("clock on", "clock back", "stutter") else fault
            try:
                made = world.step(state, stamp, through)
            except SourceError as e:
                if fault != "wrong size" or "calibrated" not in str(e):
                    judge.fail(report.frames, f"SourceError: {e}")
                continue
            except Exception as e:
                judge.fail(report.frames, f"{type(e).__name__}: {e}")
                state = begin(world.tracker, stamp)
                judge.references = [world.attitude.T]
                continue
            if fault == "wrong size":
                judge.fail(report.frames, "a frame of the wrong size was taken")
            judge.look(report.frames, fault, stamp, made)
            state = made.state
        if math.isnan(settled) and report.frames > 0.3 * frames:
            settled = memory_mb()
    report.growth = memory_mb() - settled
    if report.growth > GROWTH:
        report.failures.append(f"{name}, seed {seed}: memory grew by {report.growth:.1f} MB after the warm-up")
    if report.most_masks > MASKS:
        report.failures.append(f"{name}, seed {seed}: {report.most_masks} look-alikes masked")
    report.seconds = time.perf_counter() - began
    return report


def show(report: Report) -> None:
    print(f"{report.name}: {report.frames} frames in {report.seconds:.0f} s")
    print("  faults: " + ", ".join(f"{n} {name}" for name, n in sorted(report.faults.items())))
    for text, n in report.events.most_common():
        print(f"  {n:6d}  {text}")
    print(
        f"  slowest to resume {report.slowest_resume:.2f} s; largest error when due to be right "
        f"{math.degrees(report.worst_error):.2f} deg; at most {report.most_discs} discs, {report.most_masks} masks; "
        f"memory grew by {report.growth:.1f} MB"
    )
    for text in report.failures[:20]:
        print(f"  FAILED {text}")
    if len(report.failures) > 20:
        print(f"  FAILED and {len(report.failures) - 20} more")
    sys.stdout.flush()


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--short", action="store_true", help="5000 frames, in half a minute")
    parser.add_argument("--frames", type=int, metavar="N", help="of all sessions together; default 100000")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--only", choices=SESSIONS, help="one session, with its share of the frames")
    args = parser.parse_args()
    frames = args.frames or (5_000 if args.short else 100_000)
    if frames < 2_000:
        parser.error("--frames: at least 2000")
    seed = args.seed
    failed = 0
    for name in SESSIONS if args.only is None else (args.only,):
        kind, _, what = name.partition(" on ")
        settings = Settings(tracker=kind)  # pyright: ignore[reportArgumentType]
        rng = np.random.default_rng([seed, 2])
        world: World = (
            Points(settings, rng) if what == "detections" else Pictures(settings, rng, 90 if args.short else 150)
        )
        share = 0.45 if kind == "so3" else 0.05
        report = session(world, name, round(share * frames), seed, judged=kind == "so3")
        show(report)
        failed += len(report.failures)
    print("soak: " + (f"{failed} failures" if failed else "nothing was wrong"))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
