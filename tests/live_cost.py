"""Measure what a live page costs the tracker: `python -m tests.live_cost [--rounds N] [--seconds S] [KIND ...]`.

A daemon of its own tracks a simulated ball, 640x480 in colour, at 60 Hz or `--fps`. Between two periods without a
client, a client disturbs it in one of the ways of `KINDS`. The table has the daemon's latency from a frame's arrival to
its report at the output, 99 % of a period, and the ratio to that of the periods before and after, since other programs
disturb, too. It also has the growth of memory (resident, without pages of files), and the frames skipped.

All kinds take two minutes once. `--rounds 3 --seconds 10` repeats them in longer periods, which scatter less.
"""

import argparse
import contextlib
import itertools
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from spheremouse.errors import ControlError
from spheremouse.files.rig import rig_text
from spheremouse.geometry import Array
from spheremouse.output import Output
from spheremouse.session import outputs
from spheremouse.session.control.client import Client
from spheremouse.session.live_run import LiveRun
from spheremouse.session.process import realtime
from spheremouse.session.run_config import CommandLineOverrides, read_run_config
from spheremouse.session.service import Daemon
from spheremouse.session.setup import Setup
from spheremouse.simulate.ball.scene import default_scene
from tests.daemon_latency import megabytes
from tests.daemon_process import Camera
from tests.daemon_world import Film

FPS = 60.0
PATIENCE = 300.0  # s, until the daemon tracks
SETTLE = 1.0  # s after a client
CONFIG = 'schema: 2\nsource: "synthetic:"\noutput: "null"\nrig: rig.yaml\nrealtime: auto\ncontrol: {{socket: {}/s}}\n'


# ---- the daemon's process ----


class Sink(Output):
    """Records the time of each report, and s since the arrival of its frame. It has the priority of a paced output."""

    def __init__(self):
        self.times: list[tuple[float, float]] = []

    def send(self, report):
        now = time.monotonic()
        if not self.times:
            realtime.claim(0)
        self.times.append((now, now - report.stamp))


def serve(folder: Path, camera_type: type[Camera] = Camera, fps: float = FPS) -> None:
    """Run the daemon until a client stops it; then write the times. The ball turns as fast at any rate."""
    film = Film.render() if fps == FPS else Film.of(default_scene(), round(48 * fps / FPS))
    sink = Sink()
    config = folder / "config.yaml"
    config.write_text(CONFIG.format(folder))
    (folder / "rig.yaml").write_text(rig_text(film.rig))
    outputs.open_output = lambda spec: sink
    camera, overrides = camera_type(film.colour, fps), CommandLineOverrides(config)
    parts = LiveRun(overrides, read_run_config(overrides), Setup(), lambda plan: lambda: camera, print)
    Daemon(parts).run(cast(Any, SimpleNamespace(stop_requested=False)))
    np.save(folder / "times.npy", np.array(sink.times))


# ---- the clients ----


def wait_for_tracking(path: Path) -> None:
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        with contextlib.suppress(ControlError), Client(path) as client:
            if client.status().state == "tracking":
                return
        time.sleep(0.2)
    raise SystemExit(f"{path}: no daemon tracks there")


def pictures(path: Path, end: float, interval: float = 1 / 15) -> None:
    """Read 15 pictures a second."""
    with Client(path) as client:
        due = time.monotonic()
        while time.monotonic() < end:
            client.picture()
            due = max(due + interval, time.monotonic())
            time.sleep(due - time.monotonic())


def page(path: Path, end: float) -> None:
    """Read pictures, samples, and the status twice a second, as a page does."""

    def samples() -> None:
        with Client(path) as client, contextlib.suppress(ControlError):
            for _ in client.sample_objects():
                if time.monotonic() > end:
                    return

    def status() -> None:
        with Client(path) as client:
            while time.monotonic() < end:
                client.status()
                time.sleep(0.5)

    threads = [threading.Thread(target=work) for work in (samples, status)]
    for thread in threads:
        thread.start()
    pictures(path, end)
    for thread in threads:
        thread.join()


def setting(*assignments: str, rate: float) -> Callable[[Path, float], None]:
    """Return a client that sets one of the assignments after another, about `rate` times a second.

    At the end it prints how long the replies took.
    """

    def work(path: Path, end: float) -> None:
        rng, replies = np.random.default_rng(), list[float]()
        with Client(path) as client:
            for assignment in itertools.cycle(assignments):
                begun = time.monotonic()
                due = begun + rng.uniform(0.5, 1.5) / rate  # so that requests meet every phase of a frame
                if due > end:
                    break
                client.ask("set", assignments=[assignment])
                replies.append(1e3 * (time.monotonic() - begun))
                time.sleep(max(0.0, due - time.monotonic()))
        p50, p99 = np.quantile(replies, (0.5, 0.99))
        print(f"set {assignments[0]}: {len(replies)} replies: {p50:.1f} ms, {p99:.1f} ms (99 %)", file=sys.stderr)

    return work


def connections(path: Path, end: float) -> None:
    """Open and drop 1,000 connections, each of which asks for pictures; every second one reads no reply."""
    begun = time.monotonic()
    for k in range(1000):
        with socket.socket(socket.AF_UNIX) as connection, contextlib.suppress(OSError):
            connection.settimeout(5.0)
            connection.connect(str(path))
            connection.sendall(b'{"command": "picture"}\n')
            if k % 2:
                connection.recv(100)
        time.sleep(max(0.0, begun + (end - begun) * k / 1000 - time.monotonic()))


def silent(path: Path, end: float) -> None:
    """Ask for pictures, samples and 200 settings, and read nothing."""
    with socket.socket(socket.AF_UNIX) as connection, contextlib.suppress(OSError):
        connection.connect(str(path))
        connection.sendall(b'{"command": "watch", "interval": 0.1, "samples": true}\n{"command": "picture"}\n')
        connection.settimeout(1.0)
        for _ in range(200):
            connection.sendall(b'{"command": "settings"}\n')
    time.sleep(max(0.0, end - time.monotonic()))


def dead(path: Path, end: float) -> None:
    """Read pictures in another process, which is killed in the middle."""
    code = f"""import pathlib, time
from spheremouse.session.control.client import Client
client = Client(pathlib.Path({str(path)!r}))
while True:
    client.picture()
    time.sleep(0.01)
"""
    with subprocess.Popen([sys.executable, "-c", code]) as process:
        time.sleep(max(0.0, 0.5 * (end - time.monotonic())))
        process.kill()
    time.sleep(max(0.0, end - time.monotonic()))


KINDS: dict[str, Callable[[Path, float], None]] = {
    "nothing": lambda path, end: time.sleep(end - time.monotonic()), "pictures": pictures, "page": page,
    "set": setting("motion.scale_x=2", "motion.scale_x=1", rate=20.0),
    "set-discs": setting("discs.polarity=dark", "discs.polarity=auto", rate=10.0), "connections": connections,
    "silent": silent, "dead": dead
}  # fmt: skip


# ---- the measurement ----


def memory(pid: int) -> float:
    """MB resident without pages of files."""
    return megabytes(pid)["RssAnon"]


def period(path: Path, pid: int, kind: str, seconds: float) -> tuple[str, float, float, float, int]:
    """Disturb the daemon. Return kind, begin, end, growth of memory in MB while disturbed, and skipped frames."""
    with Client(path) as client:
        before, skipped = memory(pid), client.status().skipped or 0
    begin, end = time.monotonic(), time.monotonic() + seconds
    most = [before]
    thread = threading.Thread(target=KINDS[kind], args=(path, end))
    thread.start()
    while thread.is_alive():
        thread.join(0.25)
        most.append(memory(pid))
    ended = time.monotonic()
    with Client(path) as client:
        skipped = (client.status().skipped or 0) - skipped
    time.sleep(0.0 if kind == "nothing" else SETTLE)
    return kind, begin, ended, max(most) - before, skipped


def percentiles(times: Array, latency: Array, periods: list[tuple[float, float]]) -> list[float]:
    """Return the latency, ms, that 99 % of each period's reports keep."""
    return [1e3 * float(np.percentile(latency[(times >= begin) & (times < end)], 99)) for begin, end in periods]


def ratio(p99: list[float], own: list[int]) -> str:
    """Return the ratio of disturbed periods to the mean of their neighbours, in words: median, lowest and highest."""
    ratios = [2.0 * p99[k] / (p99[k - 1] + p99[k + 1]) for k in own]
    return f"{np.median(ratios):.2f} ({min(ratios):.2f}, {max(ratios):.2f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=list(KINDS), metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=3.5, help="of each period")
    parser.add_argument("--priority", type=int, default=realtime.PRIORITY, help="of the daemon, above other programs")
    parser.add_argument("--fps", type=float, default=FPS, help="of the camera")
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve:
        realtime.PRIORITY = given.priority
        serve(given.serve, fps=given.fps)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        words = ("--serve", name, "--priority", str(given.priority), "--fps", str(given.fps))
        command = [sys.executable, "-m", "tests.live_cost", *words]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        path = folder / "s"
        wait_for_tracking(path)
        print(f"load {os.getloadavg()[0]:.1f}; {Client(path).status().scheduling}", file=sys.stderr)
        time.sleep(SETTLE)
        periods = [period(path, process.pid, "nothing", given.seconds)]
        for kind in given.kinds * given.rounds:
            periods += [period(path, process.pid, k, given.seconds) for k in (kind, "nothing")]
        status = Client(path).status()
        Client(path).ask("stop")
        process.wait(60.0)
        times, latency = np.load(folder / "times.npy").T
    p99 = percentiles(times, latency, [(begin, end) for _, begin, end, _, _ in periods])
    rate = np.count_nonzero((times >= periods[0][1]) & (times < periods[0][2])) / (periods[0][2] - periods[0][1])
    print(f"{status.fps:.1f} frames/s, {rate:.1f} reports/s; stages in ms: {status.stages_ms}", file=sys.stderr)
    head = ("client", "99 % of the latency", "ratio: median (lowest, highest)", "memory", "skipped")
    print(f"| {' | '.join(head)} |\n{'| --- ' * len(head)}|")
    for kind in dict.fromkeys(given.kinds):
        own = [k for k in range(1, len(periods), 2) if periods[k][0] == kind]
        grown, skipped = max(periods[k][3] for k in own), sum(periods[k][4] for k in own)
        latency = f"{np.median([p99[k] for k in own]):.2f} ms"
        cells = (kind, latency, ratio(p99, own), f"{grown:+.1f} MB", str(skipped))
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
