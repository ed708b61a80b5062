"""A month of the daemon, in minutes: `python -m tests.daemon_soak [--short] [--days D] [--seed S]`.

A real daemon, with its control socket, on a film that is played as fast as it takes it. Six times a day by the frames'
stamps comes a fault, then ordinary play at 30 Hz, then a pause of hours in a few frames, or a night without light. The
faults: a camera that goes, freezes, loses frames, is bumped or is not waited for; damaged frames, dark, white and noisy
ones, of another size, with a hand or without targets, with stamps that jump; an error as if of our own; an output that
fails or hangs; a full disk. Meanwhile somebody asks it things: status, reinit, pause, reload, also of a wrong file,
set, snapshots, recordings. One seed gives the same faults again.

What must hold, always: nothing is sent while the state is not tracking. Every frame was looked at or counted as
skipped, every damaged or lost frame is counted, every count was sent or is in the ledger. Over every spell of ordinary
play, 2 s after the fault before it, the counts are the integral of the true motion; in a pause they are 0. A ball that
cannot be seen is not tracked for long. Memory in use stays within 1 MB, threads and open files stay.
"""

import argparse
import ctypes
import gc
import os
import resource
import shutil
import sys
import tempfile
import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from spheremouse.capture import fetch as capture
from spheremouse.errors import ControlError, SourceError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, exp, log
from spheremouse.output import reporter
from spheremouse.output.reporter import ReporterStatus
from spheremouse.session import outputs, timing, worker
from spheremouse.session import service as run
from spheremouse.session.ball.map_keeper import MapKeeper
from spheremouse.session.control.client import Client
from spheremouse.simulate.ball.scene import default_scene
from tests.daemon_world import DT, Film, RawFrame, World, left_over, matrix

FAULTS = {  # frames from, to
    "damaged": (1, 30),
    "size": (1, 10),
    "dark": (1, 90),
    "white": (1, 60),
    "noise": (1, 60),
    "hand": (20, 200),
    "hidden": (1, 60),
    "internal": (1, 1),
    "stamps": (1, 5),
    "dropped": (1, 10),
    "rush": (5, 60),  # the camera does not wait for the daemon
    "gone": (1, 8),  # attempts to open it
    "silent": (1, 1),  # until it is opened again
    "broken": (1, 40),
    "hanging": (1, 20),
    "bumped": (1, 1),  # the camera, from one place to the other
    "disk": (60, 200),  # no file can grow
}
ASKED = (*["status"] * 3, "reinit", "pause", "reload", "set", "output", "snapshot", "record", "wrong")
BLIND = ("dark", "white", "noise", "night")  # nothing can be tracked
RESTS = ("pause", "night")
DAY = 86_400.0  # s
SPELLS_A_DAY = 6  # each with a fault, play and a rest; the last one is a night
NIGHT = 8 * 3600.0  # s
UNSEEN = 60  # frames without a ball after which it must be lost
OF_FRAMES = ("damaged", "size", "dark", "white", "noise", "hand", "hidden", "internal")
SETTLED = 60  # frames after a fault until all is as it was: lost_after, reset_after, and the map recognised
CLOSE, CLOSE_SHARE = 3.0, 0.01  # counts, and of the path: the estimate at either end
GROWTH, GROWTH_SHORT = 1.0, 40.0  # MB in use, from the middle to the last fifth
LONG = 10.0  # days from which on memory is judged as flat
EVERY = 0.05  # s between two things that somebody asks
BUMP, BUMP_DEGREES = np.array([0.010, -0.006, 0.008]), 0.6  # m; of the camera


class Cabinet(World):
    """A world that plays its own faults, and remembers sums only."""

    def __init__(self, films: tuple[Film, Film], folder: Path, days: float, seed: int) -> None:
        film = films[0]
        super().__init__(film, folder, pace=0.0)
        self._films, self._film = films, 0  # the camera in two places
        self._begun, self._days = self.stamp, days
        self.played = 0  # frames at 30 Hz
        self._rng = np.random.default_rng([seed, 1])
        self._spells = self._spell()
        self._spell_left, self._now, self._since = 150, "", 0
        self.faults: Counter[str] = Counter()
        self.failures: list[str] = []
        self.over = threading.Event()
        self.lost = self.tracked = 0
        self.total, self.given = np.zeros(3, np.int64), np.zeros(3, np.int64)
        self.reports = 0
        self.spells_judged = 0
        self.worst = 0.0  # counts
        # Stamp -> spell, place, ...
        self._spell_of: OrderedDict[float, tuple[int, int, bool, str, int]] = OrderedDict()
        self._state_of: OrderedDict[float, str] = OrderedDict()
        self._judged: tuple[int, int] | None = None  # spell and place of the last frame that counts
        self._error, self._path = np.zeros(3), 0.0
        self._spell_number = 0
        self._matrix = matrix(film.rig)
        n = len(film.grey)
        self._turns = [self._matrix @ log(film.attitude[k + 1] @ film.attitude[k].T) for k in range(n - 1)]
        self._rest = 0
        self._step = DT  # s between two stamps of a pause
        self._paused: tuple[int, Array] = (-1, np.zeros(3))  # spell, counts in it
        self._no_limit = resource.getrlimit(resource.RLIMIT_FSIZE)

    # ---- the camera, in the capture thread ----

    def _spell(self) -> Iterator[tuple[str, int]]:
        rng, due, number = self._rng, [], 0
        while True:
            due = due or [str(f) for f in rng.permutation(list(FAULTS))]
            fault = due.pop()
            low, high = FAULTS[fault]
            yield fault, int(np.exp(rng.uniform(np.log(low), np.log(high + 1))))
            yield "", int(rng.integers(1, 30)) if rng.random() < 0.2 else int(rng.integers(100, 250))
            number += 1
            yield "night" if number % SPELLS_A_DAY == 0 else "pause", int(rng.integers(5, 40))

    def open_camera(self) -> "Cabinet":
        if self._now == "gone":
            self._spell_left -= 1
            if self._spell_left <= 0:
                self._begin_spell()
            raise SourceError("unplugged")
        if self._now == "silent":
            self._begin_spell()
        return self

    def next(self, timeout: float) -> RawFrame | None:
        if self._now != "rush" and not self._free.wait(timeout):
            return None
        if self.days >= self._days:
            self.over.set()
            time.sleep(0.01)
            return None
        if self._spell_left <= 0:
            self._begin_spell()
        if self._now == "gone":
            raise SourceError("unplugged")
        if self._now == "silent":
            time.sleep(0.005)
            return None
        if self._now == "dropped":
            self.sequence += 1
            self.lost += 1
        self._spell_left -= 1
        return self._made()

    def _made(self) -> RawFrame:
        if self._now in RESTS:
            self.stamp += self._step
        elif self._rest:
            self._rest -= 1
        else:
            self.place += self._way
            if self.place in (0, len(self.film.grey) - 1):
                self._way, self._rest = -self._way, int(self._rng.integers(1, 30))
        self.stamp += DT
        if self._now == "stamps":
            self.stamp += float(self._rng.choice([-1.0, 1.0]) * 10.0 ** self._rng.uniform(-2, 4))
        self.sequence += 1
        self.produced += 1
        self.played += self._now not in RESTS
        self._since += 1
        judged = self._now in ("", "disk") and self._since > SETTLED
        with self._lock:
            self.out += 1
            self._spell_of[self.stamp] = (self._spell_number, self.place, judged, self._now, self._since)
            while len(self._spell_of) > 500:
                self._spell_of.popitem(last=False)
        self._free.clear()
        fault = "dark" if self._now == "night" else self._now if self._now in OF_FRAMES else ""
        return RawFrame(self, self.stamp, self.sequence, self.place + self._film * len(self.film.grey), fault)

    def image(self, place: int, colour: bool, fault: str, film: Film | None = None) -> NDArray[np.uint8]:
        number, place = divmod(place, len(self.film.grey))
        image = super().image(place, colour, fault, self._films[number])
        match fault:
            case "white":
                return np.full_like(image, 255)
            case "noise":
                return np.random.default_rng([self.sequence, 3]).integers(0, 256, image.shape, dtype=np.uint8)
            case "hand":  # it moves, and covers a third of the ball
                image, left = image.copy(), 200 + self.sequence % 120
                image[100:400, left : left + 130] = 120
        return image

    @property
    def days(self) -> float:
        return (self.stamp - self._begun) / DAY

    def _begin_spell(self) -> None:
        self._now, self._spell_left = next(self._spells)
        self._spell_number += 1
        self._since = 0
        if self._now:
            self.faults[self._now] += 1
        self._film ^= self._now == "bumped"
        length = NIGHT if self._now == "night" else self._rng.exponential((DAY - NIGHT) / (SPELLS_A_DAY - 1))
        self._step = length / max(self._spell_left, 1)
        full = (0, self._no_limit[1]) if self._now == "disk" else self._no_limit
        resource.setrlimit(resource.RLIMIT_FSIZE, full)
        self.broken = "unplugged too" if self._now == "broken" else ""
        gate, self.gate = self.gate, threading.Event() if self._now == "hanging" else None
        if gate is not None:
            gate.set()

    # ---- what comes of it ----

    def tracked_frame(self, made: Any, report: Any, _: Any) -> None:
        assert self.daemon is not None
        estimate, counts, state = made.epoch.estimate, report.counts, self.daemon.parts.monitor.state
        self.tracked += 1
        self.given += counts
        self._state_of[estimate.stamp] = str(state)
        while len(self._state_of) > 500:
            self._state_of.popitem(last=False)
        with self._lock:
            spell, place, judged, fault, since = self._spell_of[estimate.stamp]
        if fault in BLIND and since > UNSEEN and made.epoch.state.status == "tracking":
            self.fail(f"a ball that cannot be seen is tracked after {since} frames")
        if fault in RESTS:
            total = np.add(counts, self._paused[1] if self._paused[0] == spell else 0)
            self._paused = spell, total
            if np.abs(total).max() > CLOSE:
                self.fail(f"{total} in a pause")
        if not judged or made.epoch.state.status != "tracking":
            if judged:
                self.fail(f"{made.epoch.state.status} in an ordinary spell: {made.epoch.events}")
            self._judged = None
            return
        if self._judged is None or self._judged[0] != spell:
            self._error, self._path = np.zeros(3), 0.0
            self.spells_judged += 1
        else:
            before = self._judged[1]
            true = np.zeros(3) if before == place else self._turn(before, place)
            self._error = self._error + counts - true
            self._path += float(np.abs(true).sum())
            off = float(np.abs(self._error).max()) - CLOSE_SHARE * self._path
            self.worst = max(self.worst, off)
            if off > CLOSE:
                self.fail(f"counts are wrong by {self._error} over a path of {self._path:.0f}")
                self._error = np.zeros(3)
        self._judged = (spell, place)

    def _turn(self, before: int, place: int) -> Array:
        if place == before + 1:
            return self._turns[before]
        if place == before - 1:
            return -self._turns[place]
        R = self.film.attitude
        return self._matrix @ log(R[place] @ R[before].T)

    def received(self, report: Any) -> None:
        if not any(report.counts):
            return
        self.total += report.counts
        self.reports += 1
        state = None
        for _ in range(1000):  # a frame is given before it is shown
            state = self._state_of.get(report.stamp)
            if state is not None:
                break
            time.sleep(0.001)
        if state != "tracking":
            self.fail(f"{report.counts} were sent while {state}")

    def fail(self, text: str) -> None:
        if len(self.failures) < 50:
            before = " | ".join(self.said[-4:])
            self.failures.append(f"frame {self.produced}, {self._now or 'no fault'}: {text}\n         before: {before}")


class Somebody(threading.Thread):
    def __init__(self, cabinet: Cabinet, seed: int) -> None:
        super().__init__(name="somebody", daemon=True)
        self._client, self._cabinet = Client(cabinet.socket), cabinet
        self._rng = np.random.default_rng([seed, 2])
        self.asked: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.over, self.warm = threading.Event(), threading.Event()  # warm: all of it was asked once

    def run(self) -> None:
        for kind in sorted(set(ASKED)):
            self._ask(kind, always=True)
        self.warm.set()
        while not self.over.wait(EVERY):
            self._ask(ASKED[int(self._rng.integers(len(ASKED)))])

    def _ask(self, kind: str, always: bool = False) -> None:
        c, rng = self._client, self._rng
        self.asked[kind] += 1
        try:
            match kind:
                case "pause":
                    c.ask("pause")
                    self.over.wait(0.02)
                    c.ask("resume")
                case "set":
                    c.ask("set", assignments=[f"pointer.rate={int(rng.integers(125, 1000))}"])
                case "output":
                    if always or rng.random() < 0.1:
                        c.ask("set", assignments=[f"output=sink:{int(rng.integers(3))}"])
                case "snapshot":
                    if always or rng.random() < 0.1:
                        Path(c.ask("snapshot")["file"]).unlink()
                case "wrong":
                    self._replace_config("wrong.yaml")
                    try:
                        c.ask("reload")
                        self._cabinet.fail("a wrong configuration was applied")
                    finally:
                        self._replace_config("right.yaml")
                case "record":
                    if always or rng.random() < 0.1:
                        c.ask("record", seconds=30, folder="r")
                        self.over.wait(0.1)
                        shutil.rmtree(c.ask("record", stop=True)["folder"])
                case _:
                    c.ask(kind)
        except ControlError:
            self.refused[kind] += 1

    def _replace_config(self, name: str) -> None:
        """As an editor does; the disk may be full."""
        folder, config = self._cabinet.folder, self._cabinet.config
        os.link(folder / name, folder / "new.yaml")
        os.replace(folder / "new.yaml", config)


def soak(days: float, seed: int) -> list[str]:
    """Play so many days; what was wrong."""
    scene = default_scene()
    turn = exp(np.radians(BUMP_DEGREES) * np.array([0.6, 0.8, 0.0]))
    moved = replace(scene, pose=Pose(turn @ scene.pose.rotation, scene.pose.position + BUMP))
    films = Film.render(), Film.of(moved)
    outputs.open_output = lambda spec: cabinet.open_output(spec)  # noqa: PLW0108  it is made later
    capture.MAX_FRAME_GAP_S = timing.MAX_FRAME_GAP_S = 0.3
    capture.Capture.__init__.__defaults__ = (lambda _: None, 0.3)
    capture.BACK_OFF = reporter.RETRY_DELAYS = (0.005, 0.01)
    run._MAX_UNUSABLE_S = 0.5
    worker._FAULT_WINDOW_S = 0.0  # the process is not to end
    MapKeeper.__init__.__defaults__ = (1.0, *(MapKeeper.__init__.__defaults__ or ())[1:])
    with tempfile.TemporaryDirectory() as name:
        cabinet = Cabinet(films, Path(name), days, seed)
        cabinet.said = _Last()  # pyright: ignore[reportAttributeAccessIssue]
        text = cabinet.config.read_text()
        (cabinet.folder / "right.yaml").write_text(text)
        (cabinet.folder / "wrong.yaml").write_text(text + "discs: {contrast: much}\n")
        begun = time.monotonic()
        daemon = cabinet.start(watch=cabinet.tracked_frame)
        cabinet.reach("tracking")
        somebody = Somebody(cabinet, seed)
        somebody.start()
        figures: list[Figure] = []
        while not cabinet.over.wait(1.0):
            if cabinet.error is not None:
                raise cabinet.error
            if somebody.warm.is_set():
                files = len(os.listdir("/proc/self/fd"))
                figures.append(Figure(cabinet.days, memory_in_use(), threading.active_count(), files))
        seconds = time.monotonic() - begun
        somebody.over.set()
        somebody.join(60.0)
        restarts = daemon.status().camera_restarts
        cabinet.stop()
        resource.setrlimit(resource.RLIMIT_FSIZE, cabinet._no_limit)
        _ledger(cabinet, daemon)
    _flat(cabinet, figures)
    print(
        f"daemon: {cabinet.days:.1f} days by the stamps, of which {cabinet.played * DT / 3600.0:.2f} h at 30 Hz; "
        f"{cabinet.produced} frames in {seconds:.0f} s, {restarts} restarts of the camera; seed {seed}"
    )
    print("  faults: " + ", ".join(f"{n} {f}" for f, n in sorted(cabinet.faults.items())))
    print(
        "  asked: " + ", ".join(f"{n} {k} ({somebody.refused[k]} refused)" for k, n in sorted(somebody.asked.items()))
    )
    print(
        f"  tracked {cabinet.tracked}, damaged {cabinet.damaged}, lost by the driver {cabinet.lost}, "
        f"skipped {daemon.parts.ring.skipped}; {cabinet.reports} reports, unsent {daemon.parts.outputs.unsent}"
    )
    print(
        f"  {cabinet.spells_judged} ordinary spells; counts wrong by {max(cabinet.worst, 0.0):.2f} at most, beyond 1 %"
    )
    return cabinet.failures


class Figure(NamedTuple):
    days: float
    memory: float  # MB in use
    threads: int
    files: int


def memory_in_use() -> float:
    """Return the MB that malloc has given out, the least of some readings, since pictures come and go.

    PYTHONMALLOC=malloc makes that all memory of Python; the process's size would hide it. Without a cache for each
    thread (GLIBC_TUNABLES), no freed memory counts.
    """
    gc.collect()
    least = np.inf
    for _ in range(20):
        info = _mallinfo2()
        least = min(least, info.field_7 + info.field_4)  # uordblks, hblkhd
        time.sleep(0.002)
    return least / 1e6


class _Mallinfo2(ctypes.Structure):
    _fields_ = [(f"field_{k}", ctypes.c_size_t) for k in range(10)]  # malloc/malloc.h


_mallinfo2 = ctypes.CDLL(None).mallinfo2
_mallinfo2.restype = _Mallinfo2


def _ledger(cabinet: Cabinet, daemon: Any) -> None:
    report: ReporterStatus = daemon.parts.outputs.status()[0][1]
    sent = cabinet.total + report.unsent + left_over(daemon) - report.ahead
    laws = {
        "sent + unsent - ahead": (sent.tolist(), cabinet.given.tolist()),
        "reports": (report.reports, cabinet.reports),
        "looked at + skipped": (daemon.parts.worker.seen + daemon.parts.ring.skipped, cabinet.produced),
        "tracked": (daemon.parts.worker.frames, cabinet.tracked),
        "damaged": (daemon.parts.worker.damaged, cabinet.damaged),
        "lost by the driver": (daemon.parts.captures.dropped, cabinet.lost),
    }
    for name, (there, here) in laws.items():
        if there != here:
            cabinet.fail(f"{name}: {there}, should be {here}")


def _flat(cabinet: Cabinet, figures: list[Figure]) -> None:
    """Judge the least of each part. In the first half the times of 10,000 frames and reports fill up (timing.py)."""
    tenths = [[f.memory for f in figures if int(10.0 * f.days / cabinet.days) == k] for k in range(10)]
    print("  MB in use, least of each tenth: " + ", ".join(f"{min(t):.1f}" for t in tenths if t))
    middle = [f for f in figures if 0.5 * cabinet.days < f.days <= 0.7 * cabinet.days] or figures
    end = [f for f in figures if f.days > 0.8 * cabinet.days] or figures
    for name, growth in (("memory", GROWTH if cabinet.days > LONG else GROWTH_SHORT), ("threads", 3), ("files", 6)):
        before, after = (min(getattr(f, name) for f in part) for part in (middle, end))
        print(f"  {name}: {before:.1f} in the middle, {after:.1f} at the end")
        if after - before > growth:
            cabinet.fail(f"{name} grew from {before:.1f} to {after:.1f}")


class _Last(list[str]):
    def append(self, text: str) -> None:
        super().append(text)
        del self[:-50]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.daemon_soak", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--short", action="store_true", help="1.5 days, in some 15 s")
    parser.add_argument("--days", type=float, default=30.0, metavar="D", help="by the stamps; default 30, in minutes")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    args = parser.parse_args()
    if os.environ.get("PYTHONMALLOC") != "malloc":
        exact = {"PYTHONMALLOC": "malloc", "GLIBC_TUNABLES": "glibc.malloc.tcache_count=0"}
        os.execve(sys.executable, sys.orig_argv, {**os.environ, **exact})
    with threadpool_limits(1):
        failures = soak(1.5 if args.short else args.days, args.seed)
    for text in failures[:20]:
        print(f"  FAILED {text}")
    print("daemon soak: " + (f"{len(failures)} failures" if failures else "nothing was wrong"))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
