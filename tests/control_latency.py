"""Measure how long `ctl set` takes: `python -m tests.control_latency [--socket PATH | --source SPEC]`.

Without `--socket` it starts a daemon of its own, on a recorded or simulated source at its own pace, without an output.
It prints the times of `set` and of `status`, and the frames that the daemon skipped meanwhile.
"""

import argparse
import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from spheremouse.errors import ControlError
from spheremouse.session.control.client import Client

PATIENCE = 300.0  # s
MAX_PAUSE = 0.05  # s between two requests, at random, so that they meet every phase of a frame


@contextlib.contextmanager
def daemon(folder: Path, source: str) -> Iterator[Path]:
    path = folder / "s"
    words = ["run", "--source", source, "--realtime", "--output", "null", "--set", f"control.socket={path}"]
    process = subprocess.Popen([sys.executable, "-m", "spheremouse", *words], stderr=subprocess.DEVNULL)
    try:
        yield path
    finally:
        process.terminate()
        process.wait(60.0)


def wait_for_tracking(path: Path, remedy: str = "") -> None:
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        with contextlib.suppress(ControlError), Client(path) as client:
            if client.status().state == "tracking":
                return
        time.sleep(0.2)
    raise SystemExit(f"{path}: no daemon tracks there{remedy}")


def measure(client: Client, name: str, ask: Callable[[int], object], requests: int) -> None:
    """Print the quantiles of the times of `ask`, and the frames skipped meanwhile."""
    rng, times, before = np.random.default_rng(0), list[float](), client.status()
    for k in range(requests):
        time.sleep(rng.uniform(0.0, MAX_PAUSE))
        begun = time.perf_counter()
        ask(k)
        times.append(time.perf_counter() - begun)
    after = client.status()
    skipped, frames = (getattr(after, key) - getattr(before, key) for key in ("skipped", "frames"))
    p50, p99 = 1e3 * np.quantile(times, [0.5, 0.99])
    print(f"{name}: {p50:.1f} ms (median), {p99:.1f} ms (99 %), {1e3 * max(times):.1f} ms (longest); ", end="")
    stages = [ms for name, ms in (after.stages_ms or {}).items() if name != "wait"]
    frame = [sum(getattr(ms, key) for ms in stages) for key in ("p50", "p99")]
    print(f"{skipped} of {frames + skipped} frames skipped; a frame takes {frame[0]:.1f} ms, {frame[1]:.1f} ms (99 %)")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.control_latency", description=__doc__)
    parser.add_argument("--socket", type=Path, metavar="PATH", help="of a daemon that tracks")
    parser.add_argument("--source", default="synthetic:motion=play,seconds=3600", metavar="SPEC", help="of its own")
    parser.add_argument("--requests", type=int, default=200, metavar="N", help="of each kind")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        path = given.socket or stack.enter_context(daemon(Path(folder), given.source))
        wait_for_tracking(path, "; start one, or leave --socket out")
        client = stack.enter_context(Client(path))
        ways = {
            "nothing": lambda _: None,
            "status": lambda _: client.status(),
            "set motion.scale_x": lambda k: client.ask("set", assignments=[f"motion.scale_x={1 + k % 2}"]),
            "set so3.acceleration_sigma": lambda k: client.ask(
                "set", assignments=[f"so3.acceleration_sigma={20 + k % 2}"]
            ),
        }
        for name, ask in ways.items():
            measure(client, name, ask, given.requests)
        client.ask("reload")
    return 0


if __name__ == "__main__":
    sys.exit(main())
