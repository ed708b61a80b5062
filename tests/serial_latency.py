"""Measure what sending to a board costs: python -m tests.serial_latency [--rate HZ] [--seconds S].

The board is simulated in its own process. The table has the duration of `send` and the time from a call of `send` to
the board's USB report, pseudo-terminal and simulator included.
"""

import argparse
import multiprocessing
import time

import numpy as np

from spheremouse.output import open_output
from tests.reporting import report
from tests.simulated_board import Simulator


def board(connection):
    reports = [(0.0, 0)]
    with Simulator(on_move=lambda moved: reports.append((time.monotonic(), moved[0]))) as simulator:
        connection.send(simulator.port)
        connection.recv()
    connection.send(reports)


def main():
    """Send one count each time."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--rate", type=float, default=1000.0, help="motions/s")
    parser.add_argument("--seconds", type=float, default=10.0)
    arguments = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=board, args=(there,), daemon=True)
    process.start()
    called, took = [], []
    with open_output(f"serial:{here.recv()}") as output:  # its closing waits until all counts are confirmed
        start = time.monotonic()
        for k in range(int(arguments.rate * arguments.seconds)):
            time.sleep(max(0.0, start + k / arguments.rate - time.monotonic()))
            called.append(time.monotonic())
            output.send(report(1))
            took.append(time.monotonic() - called[-1])
    here.send("end")
    when, moved = np.array(here.recv()).T
    process.join()
    if moved[-1] != len(called):
        raise SystemExit(f"the sum is off: {moved[-1]:.0f} of {len(called)} counts arrived")
    latency = when[np.searchsorted(moved, np.arange(1, len(called) + 1))] - called
    for name, seconds in (("in send()", took), ("to the report", latency)):
        median, slow = np.quantile(seconds, (0.5, 0.99)) * 1e6
        print(f"{name:14} median {median:.0f} µs, 99 % {slow:.0f} µs")


if __name__ == "__main__":
    main()
