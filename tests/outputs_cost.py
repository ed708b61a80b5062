"""Measure what outputs cost.

python -m tests.outputs_cost [OUTPUT ...] publishes 100 tracked samples a second to one output after another, each as
in a run. Each round has a third of a second of each output and one without, in a random order. The table has the
processor time of this process for each sample, less that without an output in the same round: the median and its
interval of 95 %. A sample is made when it is published, as by a tracker, so its numbers are in the processor's cache.
Receivers are other processes, and not counted. `{port}` in an OUTPUT is a free port, `{folder}` a new folder. `watch`
is a client of `ctl watch`, `gamepad` writes its events to the null device, and `thread` does nothing in a thread. An
OUTPUT with spaces is several outputs of one run, and the table has the time for each of them.
"""

import argparse
import multiprocessing
import os
import socket
import tempfile
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from scipy.stats import quantile_test

from spheremouse.output import Output, Report, open_output
from spheremouse.output.counts import OutputCounter
from spheremouse.output.gamepad import Gamepad
from spheremouse.output.pointer import PointerSettings
from spheremouse.output.reporter import OutputThread
from spheremouse.output.response import COUNTS_RESPONSE, STICK_RESPONSE
from spheremouse.output.sample import Sample
from spheremouse.session.control.server import ControlServer
from spheremouse.session.outputs import RunOutput
from spheremouse.session.settings import ControlSettings
from spheremouse.tracker import Status, unknown
from tests.reporting import free_port

FPS = 60.0  # frames/s
SAMPLES_PER_S = 100.0  # to measure the cost
WARM_UP, COUNT = 5, 30  # samples of each round that are not measured, and that are
OUTPUTS = (
    "thread",
    "null",
    "text:{folder}/samples.json",
    "text:{folder}/fictrac.txt,format=fictrac",
    "csv:{folder}/table.csv",
    "parquet:{folder}/table.parquet",
    "udp:{port}",
    "osc:{port}",
    "tcp:{port}",
    "ws:{port}",
    "lsl:spheremouse",
    "gamepad",
    "spacenav:{folder}/spnav.sock",
    "watch:{folder}/control.sock",
    "text:{folder}/samples.json udp:{port} tcp:{port} ws:{port}",
)
GREETINGS = {  # of a receiver
    "ws": "GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n",
    "watch": '{"command": "watch", "interval": 60, "samples": true}\n',
}
UNIX = ("spacenav", "watch")  # outputs with a socket in a folder
DATAGRAMS = ("osc", "udp")


def report(k):
    """Return the report number k of a ball that is tracked, with other numbers in each."""
    rng = np.random.default_rng(k)
    A = 1e-4 * rng.normal(size=(12, 12))
    estimate = unknown(k / FPS, k, Status.TRACKING)._replace(
        rate=rng.normal(size=6),
        covariance=A @ A.T,
        increment=0.01 * rng.normal(size=6),
        increment_covariance=(A @ A.T)[:6, :6],
        confirmed=True,
        statistics={"discs_used": 14, "discs_seen": 15, "discs_known": 40, "nis": float(rng.chisquare(20))},
    )
    sample = Sample(estimate, wall=1.7e9 + k / FPS, latency=0.011)
    return Report((20, -20, 3), (20 * FPS, -20 * FPS, 0.0), k / FPS, (sample,))


def connect(kind, place, buffer=1 << 18):
    """Return a socket that gets what an output sends, with a receive buffer of some bytes."""
    client = socket.socket(
        socket.AF_UNIX if kind in UNIX else socket.AF_INET,
        socket.SOCK_DGRAM if kind in DATAGRAMS else socket.SOCK_STREAM,
    )
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
    if kind in DATAGRAMS:
        client.bind(place)
    else:
        client.connect(place)
        client.sendall(GREETINGS.get(kind, "").encode())
    return client


def read(kind, place):
    """Read what an output sends."""
    client = connect(kind, place)
    while client.recv(65536):
        pass


@contextmanager
def receiver(spec):
    """Run the receiver of an output in another process, if it needs one."""
    kind, _, rest = spec.partition(":")
    if kind not in (*UNIX, *DATAGRAMS, "tcp", "ws"):
        yield
        return
    place = rest.split(",")[0]
    arguments = (kind, place if kind in UNIX else ("127.0.0.1", int(place)))
    process = multiprocessing.get_context("spawn").Process(target=read, args=arguments)
    process.start()
    time.sleep(5.0)  # until it has loaded its modules
    try:
        yield
    finally:
        process.kill()
        process.join()


def median(values):
    """Return the median of some values, and the ends of its interval of 95 %."""
    return np.median(values), *quantile_test(values, p=0.5).confidence_interval(0.95)


class Thread(Output):
    """Does nothing, in a thread of its own."""

    def send(self, report):
        pass


class NullDevice:
    """The null device in place of /dev/uinput."""

    def __init__(self):
        self.fd = os.open(os.devnull, os.O_WRONLY)

    def close(self):
        os.close(self.fd)


@contextmanager
def subscriber(spec):
    """Yield the function that publishes a report to an output's thread, or to the control socket."""
    kind, _, rest = spec.partition(":")
    if kind == "watch":
        with ControlServer(Path(rest), ControlSettings(), lambda pending: pending.answer({})) as server:
            yield lambda report, taken: server.submit(report)
        return
    open_it = {"gamepad": lambda: Gamepad(NullDevice(), STICK_RESPONSE), "thread": Thread}.get(
        kind, lambda: open_output(spec)
    )
    output = RunOutput(spec, OutputThread(open_it, PointerSettings(), print), OutputCounter(COUNTS_RESPONSE))
    yield lambda report, taken: output.submit(report, taken, wanted=True)
    output.thread.close()


def processor_time(publish):
    """Return the processor time of this process, s a sample, to publish reports at `SAMPLES_PER_S`."""
    spent, start = 0.0, time.monotonic()
    for k in range(WARM_UP + COUNT):
        made, taken = report(k), start + k / SAMPLES_PER_S
        before = time.process_time()
        for submit in publish:
            submit(made, taken)
        time.sleep(max(0.0, taken + 1.0 / SAMPLES_PER_S - time.monotonic()))
        spent += time.process_time() - before if k >= WARM_UP else 0.0
    return spent / COUNT


def cost(specs, rounds):
    rng = np.random.default_rng()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        publish = {"": []}
        for k, spec in enumerate(specs):
            several = [one.format(port=free_port(), folder=f"{folder}/{k}") for one in spec.split()]
            os.mkdir(f"{folder}/{k}")
            publish[spec] = [stack.enter_context(subscriber(one)) for one in several]
            for one in several:
                stack.enter_context(receiver(one))
            processor_time(publish[spec])  # loads code, and connects
        spent = {spec: [] for spec in publish}
        for _ in range(rounds):
            for spec in rng.permutation(list(publish)).tolist():
                spent[spec].append(processor_time(publish[spec]))
    print("| output | a sample | 95 % interval of the median |\n| --- | --- | --- |")
    for spec in specs:
        middle, low, high = median(1e3 * (np.array(spent[spec]) - spent[""]) / len(publish[spec]))
        name = spec.replace("{port}", "PORT").replace("{folder}/", "")
        print(f"| `{name}` | {middle:.3f} ms | {low:.3f} to {high:.3f} ms |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("outputs", nargs="*", default=OUTPUTS)
    parser.add_argument("--rounds", type=int, default=20)
    given = parser.parse_args()
    cost(given.outputs, given.rounds)


if __name__ == "__main__":
    main()
