"""Measure the time that the serial output takes, against a simulated board in its own process."""

import math
import multiprocessing
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.output import Report
from spheremouse.output.serial import BAUD, Serial, Statistics
from spheremouse.output.serial.simulator import Simulator
from spheremouse.tracker import unknown

_INTERVAL = 4e-3  # s, of a camera with 250 frames a second
_MAX_SHARE = 0.05  # of the interval, that sending may add


@dataclass(frozen=True, slots=True)
class Measured:
    """Times in s, one a motion."""

    call: Array  # duration of `send`
    latency: Array  # from the call of `send` to the board's USB report
    rate: float  # motions/s, as sent
    reports: int  # of the board
    exact: bool  # the sum arrived
    line: Statistics

    def figures(self, damage: float, baud: int | None) -> dict[str, Any]:
        """Return the figures that --json writes; `damage` is a fraction."""
        return {
            "rate": self.rate,
            "motions": len(self.call),
            "reports": self.reports,
            "exact": self.exact,
            "damage": damage,
            "baud": baud,
            "call_us": _quantiles(self.call),
            "latency_us": _quantiles(self.latency),
            "round_trip_us": {"median": _us(self.line.round_trip[0]), "p99": _us(self.line.round_trip[1])},
            "call_share_of_250_Hz": float(np.median(self.call)) / _INTERVAL,
            "latency_share_of_250_Hz": float(np.median(self.latency)) / _INTERVAL if len(self.latency) else None,
        }

    def lines(self) -> list[str]:
        """Return the figures as lines of text."""
        found = self.figures(0.0, None)
        motions = f"{found['motions']} motions at {self.rate:.1f}/s, {self.reports} reports"
        text = [f"{motions}; the sum is {'exact' if self.exact else 'OFF'}"]
        for name, key in (("in send()", "call_us"), ("to the board's report", "latency_us")):
            times = "none arrived"
            if (q := found[key]) is not None:
                times = f"median {q['median']:.0f} µs, 99 % {q['p99']:.0f} µs, worst {q['max']:.0f} µs"
            text.append(f"{name:22} {times}")
        if (share := found["latency_share_of_250_Hz"]) is not None:
            bound = f"(limit: {100 * _MAX_SHARE:.0f} % at most)"
            text.append(f"median latency {100 * share:.1f} % of a 250 Hz interval {bound}")
        return [*text, f"line: {self.line}"]


def measure(rate: float, motions: int, damage: float = 0.0, baud: int | None = None) -> Measured:
    """Send `motions` of one count each at `rate` per second to a simulated board."""
    here, there = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_board, args=(there, damage, baud), daemon=True)
    process.start()
    try:
        port: str = here.recv()
        output = Serial(lambda: port, BAUD, "none", lambda _: None)
        sent, call = np.empty(motions), np.empty(motions)
        one = Report((1, 0, 0), (0.0, 0.0, 0.0), unknown(0.0))
        start = time.monotonic() + 0.1
        for k in range(motions):
            _sleep_until(start + k / rate)
            sent[k] = time.monotonic()
            output.send(one)
            call[k] = time.monotonic() - sent[k]
        end = time.monotonic() + 1.0
        while not output.settled and time.monotonic() < end:
            time.sleep(0.001)
        line = output.statistics()
        output.close()
        here.send("end")
        stamps, moved = here.recv()
    finally:
        process.terminate()
        process.join()
    arrived = np.searchsorted(moved, np.arange(1, motions + 1))  # the first report with the k-th count
    known = arrived < len(stamps)
    exact = bool(len(moved) and moved[-1] == motions)
    rate = (motions - 1) / (sent[-1] - sent[0])
    return Measured(call, stamps[arrived[known]] - sent[known], rate, len(stamps), exact, line)


def _sleep_until(end: float) -> None:
    while (left := end - time.monotonic()) > 0.0:
        time.sleep(left)


def _board(connection: Connection, damage: float, baud: int | None) -> None:
    stamps: list[float] = []
    moved: list[int] = []

    def record(counts: list[int]) -> None:
        stamps.append(time.monotonic())
        moved.append(counts[0])

    with Simulator(damage=damage, baud=baud, on_move=record) as simulator:
        connection.send(simulator.port)
        connection.recv()
    connection.send((np.array(stamps), np.array(moved)))


def _us(seconds: float) -> float | None:
    return None if math.isnan(seconds) else 1e6 * seconds


def _quantiles(seconds: Array) -> dict[str, float] | None:
    if not len(seconds):
        return None
    median, p99 = np.quantile(seconds, (0.5, 0.99)).tolist()
    return {"median": 1e6 * median, "p99": 1e6 * p99, "max": 1e6 * float(np.max(seconds))}
