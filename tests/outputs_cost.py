"""Measure what outputs cost, and whether a bad receiver delays another output.

python -m tests.outputs_cost cost [OUTPUT ...] sends tracked samples to one output after another, first without a pause,
then 100 a second. The table has the processor time of this process for each sample, less that of the output `null`.
Receivers are other processes, and not counted. `{port}` in an OUTPUT is a free port, `{folder}` a new folder. An OUTPUT
with spaces is several outputs of one run, and the table has the time for each of them.

python -m tests.outputs_cost receivers sends the frames of a camera of 60 Hz to a paced output without a device and to
`udp`, `tcp` and `ws`, whose receivers misbehave. Each round has a run of each kind of receivers, in a random order,
since other programs disturb the runs, too. The table has the 99th percentile of the interval between reports of the
paced output, relative to the run with good receivers in the same round. Its interval of 95 % is that of the median.
"""

import argparse
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import quantile_test

from spheremouse.output import Output, Report, open_output
from spheremouse.output.pointer import PointerSettings
from spheremouse.output.reporter import OutputThread
from spheremouse.output.sample import Sample
from spheremouse.session.process import realtime
from spheremouse.tracker import Status, unknown

FPS, RATE = 60.0, 250.0  # frames/s, paced reports/s
OUTPUTS = (
    "text:{folder}/samples.json",
    "text:{folder}/counts.txt,format=counts",
    "text:{folder}/fictrac.txt,format=fictrac",
    "udp:{port}",
    "udp:{port},format=fictrac",
    "tcp:{port}",
    "ws:{port}",
    "text:{folder}/samples.json udp:{port} tcp:{port} ws:{port}",
)
GOOD = "read"
MODES = {
    "control": "read all, once more",
    "gone": "were killed after the first frames",
    "restart": "are killed and started again every second",
    "slow": "read a byte a second",
}
# Reads from a port, as the first words say, until it is killed. `os.fork` starts a receiver in a millisecond.
RECEIVER = r"""
import os, signal, socket, sys, time
kind, port, mode = sys.argv[1], int(sys.argv[2]), sys.argv[3]
GET = (b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
       b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n")
def receive():
    s = socket.socket(type=socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM)
    if mode == "slow":
        s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    if kind == "udp":
        s.bind(("127.0.0.1", port))
    else:
        while s.connect_ex(("127.0.0.1", port)):
            s.close(); time.sleep(0.02); s = socket.socket()
        if kind == "ws":
            s.sendall(GET)
    while s.recv(1 if mode == "slow" else 65536):
        if mode == "slow":
            time.sleep(1.0)
    time.sleep(1e6)
while True:
    child = os.fork()
    if not child:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        receive()
    signal.signal(signal.SIGTERM, lambda *_: (os.kill(child, signal.SIGKILL), os._exit(0)))
    time.sleep(0.75 if mode in ("restart", "gone") else 1e6)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.kill(child, signal.SIGKILL)
    os.wait()
    time.sleep(0.25 if mode == "restart" else 1e6)
"""


@dataclass
class Sink(Output):
    """A paced output that records the times of its reports."""

    paced = True
    times: list[float] = field(default_factory=list)

    def open(self):
        """Give the thread the priority that the daemon gives it."""
        realtime.claim(0)
        return self

    def send(self, report):
        self.times.append(time.monotonic())


def reports(count, fps):
    """Return reports of a ball that is tracked, with other numbers in each."""
    rng = np.random.default_rng(1)
    made = []
    for k in range(count):
        A = 1e-4 * rng.normal(size=(12, 12))
        estimate = unknown(k / fps, k, Status.TRACKING)._replace(
            rate=rng.normal(size=6),
            covariance=A @ A.T,
            increment=0.01 * rng.normal(size=6),
            increment_covariance=(A @ A.T)[:6, :6],
            confirmed=True,
            statistics={"discs_used": 14, "discs_seen": 15, "discs_known": 40, "nis": float(rng.chisquare(20))},
        )
        sample = Sample(estimate, wall=1.7e9 + k / fps, latency=0.011)
        made.append(Report((20, -20, 3), (20 * fps, -20 * fps, 0.0), k / fps, (sample,)))
    return made


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


@contextmanager
def receiver(spec, mode=GOOD, wait=0.5):
    """Run the receiver of an output in another process, if it needs one."""
    kind, _, rest = spec.partition(":")
    if kind not in ("udp", "tcp", "ws"):
        yield
        return
    with subprocess.Popen([sys.executable, "-c", RECEIVER, kind, rest.split(",")[0], mode]) as process:
        time.sleep(wait)
        try:
            yield
        finally:
            process.terminate()


def seconds_per_sample(specs, count, pause):
    """Return the processor time of this process, s a sample and output, with a pause, s, before each sample."""
    made = reports(count, FPS)
    with ExitStack() as stack:
        outputs = [stack.enter_context(open_output(spec)) for spec in specs]
        for spec in specs:
            stack.enter_context(receiver(spec))
        for report in made[:5]:  # compiles, and connects
            for output in outputs:
                output.send(report)
        made = reports(count, FPS)  # not encoded yet
        start, processor = time.monotonic(), time.process_time()
        for k, report in enumerate(made):
            time.sleep(max(0.0, start + k * pause - time.monotonic()))
            for output in outputs:
                output.send(report)
        return (time.process_time() - processor) / count / len(specs)


def cost(specs, count):
    """Print the cost of each output."""
    print("| output | one after another | 100 samples/s |\n| --- | --- | --- |")
    for spec in specs:
        cells = []
        for pause in (0.0, 0.01):
            with tempfile.TemporaryDirectory() as folder:
                idle = seconds_per_sample(["null"], count, pause)
                several = [one.format(port=free_port(), folder=folder) for one in spec.split()]
                spent = seconds_per_sample(several, count, pause)
            cells.append(f"{1e3 * (spent - idle / len(several)):.3f} ms")
        name = spec.replace("{port}", "PORT").replace("{folder}/", "")
        print(f"| `{name}` | {' | '.join(cells)} |", flush=True)


def p99_interval(mode, seconds):
    """Return the 99th percentile of the paced output's intervals, s, while receivers behave as a mode says."""
    specs = [f"{kind}:{free_port()}" for kind in ("udp", "tcp", "ws")]
    sink, settings = Sink(), PointerSettings(rate=RATE)
    threads = [OutputThread(sink.open, settings, print)]
    threads += [OutputThread(lambda spec=spec: open_output(spec), settings, print) for spec in specs]
    made = reports(int(seconds * FPS), FPS)
    with ExitStack() as stack:
        for spec in specs:
            stack.enter_context(receiver(spec, mode, wait=0.0))
        time.sleep(0.5)
        start = time.monotonic()
        for k, report in enumerate(made):
            stamp = start + k / FPS
            time.sleep(max(0.0, stamp - time.monotonic()))
            for thread in threads:
                thread.submit(report, stamp)
    for thread in threads:
        thread.close()
    return float(np.percentile(np.diff(sink.times), 99))


def receivers(seconds, rounds):
    """Print the intervals relative to those with good receivers."""
    realtime.claim(0)  # as the daemon's worker has it; the threads do not inherit it
    p99_interval(GOOD, 1.0)  # compiles
    rng, p99 = np.random.default_rng(), {mode: [] for mode in (GOOD, *MODES)}
    for _ in range(rounds):
        for mode in rng.permutation(list(p99)).tolist():
            p99[mode].append(p99_interval(mode, seconds))
    print(f"good receivers: 99 % of the intervals within {1e3 * np.median(p99[GOOD]):.2f} ms, median of {rounds} runs")
    print("| receivers of the others | ratio: median | 95 % interval of the median |\n| --- | --- | --- |")
    for mode, words in MODES.items():
        ratios = np.array(p99[mode]) / p99[GOOD]
        low, high = quantile_test(ratios, p=0.5).confidence_interval(0.95)
        print(f"| {words} | {np.median(ratios):.3f} | {low:.3f} to {high:.3f} |")


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["cost", "receivers"])
    parser.add_argument("outputs", nargs="*", default=OUTPUTS)
    parser.add_argument("--samples", type=int, default=1000, help="of each output")
    parser.add_argument("--seconds", type=float, default=2.0, help="of each run with receivers")
    parser.add_argument("--rounds", type=int, default=30, help="runs of each kind of receivers")
    given = parser.parse_args()
    if given.what == "cost":
        cost(given.outputs, given.samples)
    else:
        receivers(given.seconds, given.rounds)


if __name__ == "__main__":
    main()
