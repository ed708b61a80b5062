"""Measure how a faulty receiver changes the intervals at which the other receivers get reports.

python -m tests.outputs_faults [FOLDER] runs `spheremouse run --replay` of a recording with eight outputs. It reads the
reports of a mouse by UDP, and frames by UDP and by TCP. Each round has a spell without a fault and one of each fault,
in a random order:

- killed: clients of `tcp`, `ws`, `spacenav` and `osc` are killed without a goodbye and started again, once a
  second.
- slow: clients of `tcp`, `ws` and `spacenav`, and the reader of a pipe, read one byte a second. They connect again when
  they are dropped.

The table has the 99 % quantile of the intervals between two arrivals in a spell without a fault, and its change by each
fault in the same round. It has the median over the rounds, since other programs disturb, too, and its interval of 95 %.
On a busy machine, run it with the priority of `chrt --rr 5`.
"""

import argparse
import contextlib
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.outputs_cost import connect, median
from tests.reporting import free_port, until

SETTLE = 0.5  # s of each spell that are not measured
SMALL_BUFFER = 4096  # bytes, of a receiver with a fault
LIFE = 1.0  # s, of a client that is killed


def be_killed(places, _):
    """Start a process that reads from every output until a signal kills it, again and again."""
    while True:
        if (child := os.fork()) == 0:
            signal.setitimer(signal.ITIMER_REAL, LIFE)
            with selectors.DefaultSelector() as selector:
                for kind, place in places.items():
                    selector.register(connect(kind, place, SMALL_BUFFER), selectors.EVENT_READ)
                while True:
                    for key, _ in selector.select():
                        key.fileobj.recv(65536)
        os.waitpid(child, 0)


def be_slow(places, pipe):
    """Read a byte a second from every output and from a pipe until the end of the process."""
    clients = {kind: connect(kind, place, SMALL_BUFFER) for kind, place in places.items()}
    while True:
        time.sleep(1.0)
        os.read(pipe, 1)
        for kind, client in tuple(clients.items()):
            with contextlib.suppress(ConnectionError):
                if client.recv(1):
                    continue
            client.close()
            clients[kind] = connect(kind, places[kind], SMALL_BUFFER)


def be_idle(*_):
    """Have no fault."""
    signal.pause()


FAULTS = {"none": be_idle, "killed": be_killed, "slow": be_slow}


@contextlib.contextmanager
def forked(function, *arguments):
    """Run a function in a child process, and kill it at the end."""
    if (child := os.fork()) == 0:
        try:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # also if the measurement has another one
            os.nice(10)
            function(*arguments)
        finally:
            os._exit(1)
    try:
        yield
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def intervals(sockets, seconds):
    """Return the intervals, s, between two arrivals at each socket."""
    times, start = [[] for _ in sockets], time.monotonic()
    with selectors.DefaultSelector() as selector:
        for k, one in enumerate(sockets):
            selector.register(one, selectors.EVENT_READ, k)
        while time.monotonic() < start + seconds:
            for key, _ in selector.select(0.1):
                key.fileobj.recv(65536)
                times[key.data].append(time.monotonic())
    return [np.diff([t for t in one if t > start + SETTLE]) for one in times]


def measure(folder, rounds, seconds):
    """Return the intervals, s, by fault and receiver, a list for each round."""
    rng = np.random.default_rng()
    with tempfile.TemporaryDirectory() as scratch, contextlib.ExitStack() as stack:
        tcp, ws, osc, place = free_port(), free_port(), free_port(), f"{scratch}/spnav"
        os.mkfifo(f"{scratch}/pipe")
        pipe = os.open(f"{scratch}/pipe", os.O_RDWR)
        mouse, frames = free_port(), free_port()
        read = [stack.enter_context(connect("udp", ("127.0.0.1", port))) for port in (mouse, frames)]
        outputs = [f"udp:{mouse},format=reports", f"udp:{frames}", f"tcp:{tcp}", f"ws:{ws}", f"osc:{osc}"]
        outputs += [f"spacenav:{place}", f"text:{scratch}/pipe", f"csv:{scratch}/table.csv"]
        words = ["--replay", "--no-status", "--source", f"dataset:{folder}"]
        words += ["--set", "motion.counts_per_mm=20", "--set", f"control.socket={scratch}/s"]
        words += [word for output in outputs for word in ("--output", output)]
        command = [sys.executable, "-m", "spheremouse", "run", *words]
        daemon = stack.enter_context(subprocess.Popen(command, stderr=subprocess.DEVNULL))
        stack.callback(daemon.terminate)
        until(lambda: os.path.exists(place))
        time.sleep(5.0)  # until the ball is tracked
        places = {kind: ("127.0.0.1", port) for kind, port in (("tcp", tcp), ("ws", ws), ("osc", osc))}
        read.append(stack.enter_context(connect("tcp", places["tcp"])))
        places["spacenav"] = place
        found = {name: [] for name in FAULTS}
        for _ in range(rounds):
            for name in rng.permutation(list(FAULTS)).tolist():
                with forked(FAULTS[name], places, pipe):
                    found[name].append(intervals(read, seconds))
        return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each spell")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.folder
        if folder is None:
            folder = Path(scratch) / "simulated"
            words = f"simulate {folder} --fps 30 --motion play --seconds 20 --noise 3"
            subprocess.run([sys.executable, "-m", "spheremouse", *words.split()], check=True, stderr=subprocess.DEVNULL)
        found = measure(folder, given.rounds, given.seconds)
    print("| receiver | without a fault | killed | slow |\n| --- | --- | --- | --- |")
    for k, name in enumerate(("reports by UDP", "frames by UDP", "frames by TCP")):
        p99 = {fault: np.array([np.quantile(one[k], 0.99) for one in spells]) for fault, spells in found.items()}
        cells = []
        for fault in ("killed", "slow"):
            middle, low, high = median(100.0 * (p99[fault] / p99["none"] - 1.0))
            cells.append(f"{middle:+.1f} % ({low:+.1f} to {high:+.1f})")
        print(f"| {name} | {1e3 * np.median(p99['none']):.2f} ms | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
