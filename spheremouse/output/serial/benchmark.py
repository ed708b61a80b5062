"""What the serial output costs: a simulated board in a process of its own says when each motion arrived there."""

import multiprocessing
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.output import Report
from spheremouse.output.serial import Serial, Statistics
from spheremouse.output.serial.simulator import Simulator
from spheremouse.tracker import no_motion


@dataclass(frozen=True, slots=True)
class Measured:
    """Times in s; one for each motion."""

    call: Array  # that `send` took
    latency: Array  # from the call of `send` to the board's USB report
    rate: float  # motions/s, as sent
    reports: int  # that the board made of them
    exact: bool  # whether the sum arrived
    line: Statistics


def measure(rate: float, motions: int, damage: float = 0.0, baud: int | None = None) -> Measured:
    """Send `motions` of one count each at `rate` per second to a simulated board."""
    here, there = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=_board, args=(there, damage, baud), daemon=True)
    process.start()
    try:
        port: str = here.recv()
        output = Serial(lambda: port, 115200, "none", lambda _: None)
        began, call = np.empty(motions), np.empty(motions)
        one = Report((1, 0, 0), (0.0, 0.0, 0.0), no_motion(0.0))
        start = time.monotonic() + 0.1
        for k in range(motions):
            _wait_until(start + k / rate)
            began[k] = time.monotonic()
            output.send(one)
            call[k] = time.monotonic() - began[k]
        took = began[-1] - began[0]
        until = time.monotonic() + 1.0
        while not output.settled and time.monotonic() < until:
            time.sleep(0.001)
        line = output.statistics()
        output.close()
        here.send("end")
        stamps, moved = here.recv()
    finally:
        process.terminate()
        process.join()
    arrived = np.searchsorted(moved, np.arange(1, motions + 1))  # the first report that holds the k-th count
    known = arrived < len(stamps)
    latency = stamps[arrived[known]] - began[known]
    exact = bool(len(moved) and moved[-1] == motions)
    return Measured(call, latency, (motions - 1) / took, len(stamps), exact, line)


def _wait_until(then: float) -> None:
    while (left := then - time.monotonic()) > 0.0:
        time.sleep(left)


def _board(connection: Connection, damage: float, baud: int | None) -> None:
    stamps: list[float] = []
    moved: list[int] = []

    def note(counts: list[int]) -> None:
        stamps.append(time.monotonic())
        moved.append(counts[0])

    with Simulator(damage=damage, baud=baud, on_move=note) as simulator:
        connection.send(simulator.port)
        connection.recv()
    connection.send((np.array(stamps), np.array(moved)))
