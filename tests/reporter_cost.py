"""Measure what the reporter costs and how late it is: python -m tests.reporter_cost [--seconds S].

A camera of 60 Hz without pictures films a ball that rolls on evenly, so that every report has counts. The output does
nothing. Beside it there is nothing, or a thread that computes in Python without a pause. The table has the processor
time of the reporter's thread, its reports per second, and the times, median and 99 %, from `submit` to `send` and by
which a report is late.
"""

import argparse
import sys
import threading
import time
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from spheremouse.output import Output
from spheremouse.output.pointer import PointerSettings
from spheremouse.output.reporter import OutputThread
from tests.reporting import report

FPS = 60.0
HEAD = ("beside it", "Hz", "switch interval", "of a core", "reports/s", "submit to send", "late")


@dataclass
class Sink(Output):
    paced = True

    times: list[float] = field(default_factory=list)
    frames: list[bool] = field(default_factory=list)
    submitted: dict[float, float] = field(default_factory=dict)  # s, by stamp
    waited: list[float] = field(default_factory=list)

    def send(self, report):
        now = time.monotonic()
        submitted = self.submitted.pop(report.stamp, None)
        self.times.append(now)
        self.frames.append(submitted is not None)
        if submitted is not None:
            self.waited.append(now - submitted)


def measure(loop: bool, rate: float, seconds: float) -> list[str]:
    """Return the cells of a row; `loop`: another thread computes in Python all the time."""
    sink, over = Sink(), threading.Event()
    reporter = OutputThread(lambda: sink, PointerSettings(rate=rate), lambda text: print(text, file=sys.stderr))

    def compute() -> None:
        while not over.is_set():
            sum(range(1000))

    thread = threading.Thread(target=compute if loop else over.wait)
    clock = time.pthread_getcpuclockid(reporter._thread.ident)
    start, processor = time.monotonic(), time.clock_gettime(clock)
    thread.start()
    for k in range(int(seconds * FPS)):
        stamp = start + k / FPS
        time.sleep(max(0.0, stamp - time.monotonic()))
        sink.submitted[stamp] = time.monotonic()
        reporter.submit(report(20, -20, stamp=stamp, counts_rate=(20.0 * FPS, -20.0 * FPS, 0.0)), stamp)
    share = (time.clock_gettime(clock) - processor) / (time.monotonic() - start)
    over.set()
    thread.join()
    reporter.close()
    late = np.diff(sink.times)[~np.array(sink.frames[1:])] - 1.0 / rate
    times = [np.percentile(values, (50, 99)) for values in (sink.waited, late)]
    cells = [f"{abs(1e3 * p50):.2f} / {abs(1e3 * p99):.2f} ms" for p50, p99 in times]
    return [f"{100.0 * share:.1f} %", f"{len(sink.times) / seconds:.0f}", *cells]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each row")
    seconds = parser.parse_args().seconds
    print(f"| {' | '.join(HEAD)} |\n|{' --- |' * len(HEAD)}")
    for loop, rate, switch in product((False, True), (250.0, 1000.0), (0.005, 0.0005)):
        sys.setswitchinterval(switch)
        cells = ["a Python loop" if loop else "nothing", f"{rate:.0f}", f"{1e3 * switch:g} ms"]
        print("| " + " | ".join(cells + measure(loop, rate, seconds)) + " |", flush=True)


if __name__ == "__main__":
    main()
