"""What clients that ask and hang up cost a daemon that tracks: `python -m tests.control_hang_ups [--seconds S]`.

A real daemon in this process, on a simulated camera of 30 pictures a second; in other processes clients that send one
kind of request and close, as fast as they are served, as another user of the daemon's group (with --owner: as the
daemon's own). Shown are what was asked, frames per second beside those of the same daemon left alone, the most threads
and the growth of memory, and how long the operator waited for `set` in the midst of it.
"""

import argparse
import contextlib
import grp
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from spheremouse.errors import ControlError
from spheremouse.session.ball import follower
from spheremouse.session.control.client import Client
from tests.daemon_world import Film, RawFrame, World
from tests.soak import resident

FPS = 30.0
MEMBER = 54321  # a uid that nobody has
KINDS = ("status", "record", "snapshot", "reload", "reinit", "set", "pause")
CLIENT = """
import json, os, socket, sys, time
path, kind, seconds, uid, gid, way = sys.argv[1:]
if int(uid):
    os.setgroups([]); os.setgid(int(gid)); os.setuid(int(uid))
message = {"command": kind, **({"assignments": ["motion.scale_x=2"]} if kind == "set" else {})}
line, end, asked = json.dumps(message).encode() + b"\\n", time.time() + float(seconds), 0
while time.time() < end:
    with socket.socket(socket.AF_UNIX) as c:
        c.settimeout(5.0)
        try:
            c.connect(path)
            c.sendall(line)
            asked += 1
            if way == "answered":
                c.recv(4096)
            elif way == "served":
                time.sleep(0.03)
        except OSError:
            pass
print(asked)
"""


class Paced(World):
    """Its camera gives a picture every 1/30 s, whatever becomes of them."""

    due = 0.0

    def next(self, timeout: float) -> RawFrame | None:
        self.due = max(self.due + 1.0 / FPS, time.monotonic() - 1.0 / FPS)
        time.sleep(max(0.0, self.due - time.monotonic()))
        self._free.set()  # the driver has buffers
        return super().next(timeout)


def rate(world: World, seconds: float) -> float:
    """Frames per second over so long."""
    before, begun = world.daemon.status()["frames"], time.monotonic()  # pyright: ignore
    time.sleep(seconds)
    return (world.daemon.status()["frames"] - before) / (time.monotonic() - begun)  # pyright: ignore


def wait(world: World) -> float:
    """Seconds that the operator waits for `set`."""
    asked = time.monotonic()
    with contextlib.suppress(ControlError), Client(world.socket) as operator:
        operator.ask("set", assignments=["motion.scale_y=1"])
    return time.monotonic() - asked


def flood(world: World, kind: str, seconds: float, way: str, clients: int, owner: bool) -> str:
    """Let clients do it; a line of what that cost: frames for one half of the time, the operator's wait for the other,
    for what the operator asks is work too."""
    member, gid = (0, 0) if owner else (MEMBER, world.socket.stat().st_gid)
    words = [sys.executable, "-I", "-c", CLIENT, str(world.socket), kind, str(seconds), str(member), str(gid), way]
    memory, begun = resident(), time.monotonic()
    crowd = [subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd="/") for _ in range(clients)]
    time.sleep(1.0)
    fps = rate(world, 0.5 * seconds - 1.0)
    most, threads, waits = resident(), threading.active_count(), []
    while any(c.poll() is None for c in crowd):
        waits.append(wait(world))
        most, threads = max(most, resident()), max(threads, threading.active_count())
        time.sleep(0.2)
    took = time.monotonic() - begun
    number = sum(int(c.communicate()[0] or 0) for c in crowd)
    with contextlib.suppress(ControlError):
        world.client.ask("resume")
    waits.sort()
    return (
        f"{kind} ({way}): {number} asked in {took:.0f} s; {fps:.1f} frames/s, {threads} threads at most, "
        f"+{most - memory:.0f} MB; set took {waits[len(waits) // 2]:.2f} s (median), {waits[-1]:.2f} s (longest)"
    )


def main() -> int:
    """Try each kind and print a line of it."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.control_hang_ups", description=(__doc__ or "").split("\n\n")[0]
    )
    parser.add_argument("--seconds", type=float, default=8.0, metavar="S", help="for each kind")
    parser.add_argument("--owner", action="store_true", help="the clients are the daemon's own user's")
    parser.add_argument("--clients", type=int, default=4, metavar="N")
    parser.add_argument("--kind", action="append", choices=KINDS)
    parser.add_argument("--way", action="append", choices=("at once", "served", "answered"), help="when they hang up")
    args = parser.parse_args()
    film = Film.render()
    follower.open_output = lambda spec: world.open_output(spec)  # noqa: PLW0108  it is made later
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        world = Paced(film, folder)
        group = next(g.gr_name for g in grp.getgrall() if g.gr_gid not in (0, os.getegid()))
        world.start((f"control.group={group}",))
        world.reach("tracking")
        try:
            for kind in args.kind or KINDS:
                for way in args.way or ("served", "answered"):
                    quiet = rate(world, 3.0)
                    alone = statistics.median(wait(world) for _ in range(5))
                    line = flood(world, kind, args.seconds, way, args.clients, args.owner)
                    print(f"left alone {quiet:.1f} frames/s, set {alone:.2f} s; {line}", flush=True)
        finally:
            world.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
