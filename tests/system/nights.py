"""Twenty nights: a guest is suspended to memory while the daemon runs, and the ball is turned meanwhile.

    .venv/bin/python tests/system/nights.py [--nights N]

The host makes the film and starts the guest; the guest's real-time clock wakes it. What must hold: the daemon tracks
again within 3 s of frames at 30 Hz, and nothing is sent for the time asleep. Between the nights the wall clock is set
an hour forwards and back. QEMU's 9p does not survive a night, so the process holds all its files in memory and ends at
once.
"""

import ctypes
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

REPOSITORY = Path(__file__).parents[2]
sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "tests")]

import daemon_world  # noqa: E402
from daemon_world import Film, World  # noqa: E402

from spheremouse.session import outputs, timing  # noqa: E402

WITHIN, FPS = 3.0, 30.0  # s from the wake to tracking, in frames of a usual camera: the guest is slow
ASLEEP = 3  # s
CLOSE = 3.0  # counts
SLOW = ("loss.lost_after=1.8", "loss.reset_after=6.0")  # as film.py: the guest's frames come slowly
RTC, POWER = Path("/sys/class/rtc/rtc0/wakealarm"), Path("/sys/power/state")
MCL_CURRENT, MCL_FUTURE = 1, 2


class Cabinet(World):
    """Frames by the monotonic clock, as a camera's."""

    waits = threading.Event()  # the camera, for the end of a night

    def next(self, timeout):
        if self.hang is not None:
            self.waits.set()
            self.hang.wait()
        self.stamp = time.monotonic() - 1.0 / 30.0  # a frame's interval is added
        return super().next(timeout)

    def true_counts(self, since=-np.inf, until=np.inf):
        """Counts, (3,), of the true motion between two stamps, except while the guest gave no frame for long.

        The daemon then reports that no camera sends frames, and leaves that motion out.
        """
        stamps = sorted(stamp for stamp in tuple(self.shown) if since <= stamp <= until)
        steps = [super(Cabinet, self).true_counts(a, b) for a, b in pairwise(stamps) if b - a < timing.MAX_FRAME_GAP_S]
        return np.sum([np.zeros(3), *steps], axis=0)


def sleep() -> None:
    """Suspend to memory."""
    RTC.write_text("0")
    RTC.write_text(f"+{ASLEEP}")
    POWER.write_text("mem")


def accounted(world: Cabinet) -> np.ndarray:
    """Counts, (3,), that were sent, or that became unsent because the guest stood still for longer than they keep."""
    return world.counts + world.daemon.status().outputs[0].unsent


def night(world: Cabinet, place: int, asleep) -> tuple[float, int]:
    """Turn the ball during `asleep`; s and frames from its end until the daemon tracks a frame from after it."""
    world.waits.clear()
    world.hang = threading.Event()
    world.until(lambda: world.waits.is_set() and world.out == 0, "the frame before is done")
    world.place = place
    asleep()
    woke, frames = time.monotonic(), world.produced
    go_on, world.hang = world.hang, None
    go_on.set()
    world.until(lambda: world.state == "tracking" and max(world.states, default=0.0) > woke, "tracking after a night")
    return time.monotonic() - woke, world.produced - frames


def in_guest(film: Film, nights: int) -> list[str]:
    folder = Path(tempfile.mkdtemp(dir="/dev/shm"))
    outputs.open_output = lambda spec: world.open_output(spec)  # noqa: PLW0108  it is made later
    world, failures = Cabinet(film, folder, pace=0.02), []
    world.start(SLOW)
    world.reach("tracking")
    world.turn()
    real = timing.time_asleep
    timing.time_asleep = lambda: real() + 10.0  # from now on; once without a night, for what is loaded late
    night(world, 20, lambda: None)
    if ctypes.CDLL(None).mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
        failures.append("mlockall failed")
    world.turn(2)
    for k in range(nights):
        before, begun = world.counts, real()
        seconds, frames = night(world, [15, 40, 28, 6][k % 4], sleep)
        world.settle()
        sent = np.abs(world.counts - before).max()
        print(
            f"night {k + 1}: slept {real() - begun:.1f} s, tracked after {seconds:.2f} s, "
            f"{frames} frames; {sent:g} counts",
            flush=True,
        )
        if frames > WITHIN * FPS or sent > CLOSE or real() - begun < 1.0:
            failures.append(f"night {k + 1}")
        time.clock_settime(time.CLOCK_REALTIME, time.time() + (-3600.0 if k % 2 else 3600.0))
        lost, since = world.daemon.status().lost_count, max(world.shown)
        before = accounted(world)
        world.turn(4)
        for _ in range(100):  # the last counts come late
            off = np.abs(accounted(world) - before - world.true_counts(since)).max()
            if off <= CLOSE:
                break
            time.sleep(0.1)
        if off > CLOSE or world.daemon.status().lost_count != lost:
            failures.append(f"clock step {k + 1}: {off:.1f} counts off")
    print(*[line for line in world.said if "slept" in line][-2:], sep="\n")
    return failures


def main() -> None:
    nights = int(sys.argv[sys.argv.index("--nights") + 1]) if "--nights" in sys.argv else 20
    if "IN_VM" not in os.environ:
        with tempfile.TemporaryDirectory() as name:
            film = Film.render()
            np.savez(Path(name) / "film.npz", colour=film.colour, grey=film.grey, attitude=film.attitude)
            guest = [sys.executable, __file__, "--nights", str(nights), "--film", f"{name}/film.npz"]
            os.environ["OMP_NUM_THREADS"] = "1"
            run = [
                str(REPOSITORY / "tests/system/run_in_vm.sh"),
                "--timeout",
                "900",
                "env",
                "OMP_NUM_THREADS=1",
                *guest,
            ]
            sys.exit(subprocess.run(run, check=False).returncode)
    from spheremouse.simulate.ball.scene import default_scene

    daemon_world.PATIENCE = 300.0
    scene = default_scene()
    data = np.load(sys.argv[sys.argv.index("--film") + 1])
    film = Film(list(data["colour"]), list(data["grey"]), data["attitude"], replace(scene.rig(), pose=scene.pose))
    failures = in_guest(film, nights)
    print(f"nights: {nights}, failures: {', '.join(failures) or 'none'}", flush=True)
    time.sleep(1.0)  # the serial line's
    with open(
        "/dev/port", "r+b", buffering=0
    ) as port:  # as run_in_vm.sh ends a guest; its shell may find no file any more
        port.seek(0xF4)
        port.write(bytes([2 if failures else 1]))


if __name__ == "__main__":
    main()
