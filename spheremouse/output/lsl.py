"""`lsl:[NAME]`: a stream of the Lab Streaming Layer, one sample a ball and frame, for EEG and motion laboratories.

The channels are the numeric columns of a table. The time stamp is the mid-exposure on LSL's clock. A recording that is
not played at its own pace has the time of sending.
"""

import math
import platform
import sys
import time
from collections.abc import Sequence
from typing import Any

from spheremouse.errors import OutputError, has_control_characters
from spheremouse.finding import Finding, ok
from spheremouse.output import Output, Report
from spheremouse.output.columns import Column, columns, rows
from spheremouse.output.extras import import_extra


class Lsl(Output):
    """Sends samples to an LSL outlet. The first frame determines the channels."""

    def __init__(self, name: str) -> None:
        self._name, self._pylsl = name, _pylsl()
        self._outlet: Any = None
        self._channels: list[int] = []  # their places in a row
        sys.stderr.write(f"lsl:{name}: other computers can receive the stream, without encryption\n")

    def send(self, report: Report) -> None:
        if not report.samples:
            return
        if self._outlet is None:
            self._outlet = self._new_outlet(columns(report.samples[0].coordinates))
            self.blocks = False
        clock, wall = self._pylsl.local_clock(), time.time()
        for sample, row in zip(report.samples, rows(report), strict=True):
            stamp = clock if sample.wall is None else clock - (wall - sample.wall)
            self._outlet.push_sample([math.nan if row[k] is None else row[k] for k in self._channels], stamp)

    def close(self) -> None:
        self._outlet = None

    def _new_outlet(self, table: Sequence[Column]) -> Any:
        self._channels = [k for k, column in enumerate(table) if column.type is not str]
        pylsl, n = self._pylsl, len(self._channels)
        # the same for each run on this computer, so receivers find the stream again after a restart
        source = f"spheremouse {self._name} {platform.node()}"
        info = pylsl.StreamInfo(self._name, "MoCap", n, pylsl.IRREGULAR_RATE, pylsl.cf_double64, source)
        channels = info.desc().append_child("channels")
        for column in (table[k] for k in self._channels):
            channel = channels.append_child("channel")
            words = {"label": column.name, "unit": column.unit, "frame": column.frame, "meaning": column.meaning}
            for key, text in words.items():
                channel.append_child_value(key, text)
        return pylsl.StreamOutlet(info)


def open(argument: str) -> Lsl:
    check(argument)
    return Lsl(argument or "spheremouse")


def check(argument: str) -> None:
    if has_control_characters(argument):
        raise OutputError(f"lsl:{argument!r}: a name has no control characters", "write lsl:NAME")
    _pylsl()


def probe(argument: str) -> list[Finding]:
    return [ok("output", f"LSL stream {argument or 'spheremouse'}")]


def _pylsl() -> Any:
    try:
        return import_extra("lsl", "pylsl", "lsl")
    except RuntimeError as e:  # the wheel of this system has no library
        reason = " ".join(str(e).split())
        raise OutputError(f"lsl: {reason}", "install liblsl") from None
