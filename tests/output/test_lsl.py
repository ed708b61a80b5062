"""Streams of the Lab Streaming Layer, received by pylsl's own inlet."""

import itertools
import os
import time
from dataclasses import replace

import numpy as np
import pytest
from reporting import refused
from tables import frame

from spheremouse.output import open_output
from spheremouse.output.columns import columns, rows

try:
    import pylsl
except (ImportError, RuntimeError) as e:
    pytest.skip(f"no LSL here: {e}", allow_module_level=True)

TIMEOUT = 20.0  # s
_numbers = itertools.count()


@pytest.fixture
def stream():
    """An output, and the inlet of its stream, which the first frame makes."""
    name = f"test {os.getpid()} {next(_numbers)}"

    def received(*frames):
        with open_output(f"lsl:{name}") as output:
            output.send(frame(0, coordinates=frames[0].samples[0].coordinates))
            (found,) = pylsl.resolve_byprop("name", name, timeout=TIMEOUT)
            inlet = pylsl.StreamInlet(found)
            inlet.open_stream(timeout=TIMEOUT)
            for report in frames:
                output.send(report)
            samples = [inlet.pull_sample(timeout=TIMEOUT) for report in frames for _ in report.samples]
            info = inlet.info(timeout=TIMEOUT)
            inlet.close_stream()
        return info, samples

    return received


@pytest.mark.parametrize("coordinates", ["obj", "cam"])
def test_an_inlet_gets_every_number_exactly_with_label_unit_and_frame(stream, coordinates):
    frames = [frame(k, coordinates=coordinates, balls=2, pointing=1) for k in range(1, 10)]
    info, samples = stream(*frames)
    numeric = [c for c in columns(coordinates) if c.type is not str]
    channels, channel = [], info.desc().child("channels").child("channel")
    while not channel.empty():
        channels.append(tuple(channel.child_value(key) for key in ("label", "unit", "frame")))
        channel = channel.next_sibling()
    assert channels == [(c.name, c.unit, c.frame) for c in numeric]
    assert (info.channel_format(), info.nominal_srate()) == (pylsl.cf_double64, pylsl.IRREGULAR_RATE)
    places = [k for k, c in enumerate(columns(coordinates)) if c.type is not str]
    expected = [[row[k] for k in places] for report in frames for row in rows(report)]
    assert np.array_equal([values for values, _ in samples], expected)


def test_the_time_stamp_is_that_of_the_exposure_on_the_clock_of_lsl(stream):
    ages = (0.5, 0.02, 3.0)  # s
    reports = [frame(k) for k in range(len(ages))]
    offset = time.time() - pylsl.local_clock()
    exposures = [time.time() - age for age in ages]
    dated = [
        report._replace(samples=tuple(replace(s, wall=wall) for s in report.samples))
        for report, wall in zip(reports, exposures, strict=True)
    ]
    _, samples = stream(*dated)
    stamps = np.array([stamp for _, stamp in samples])
    assert np.allclose(stamps + offset, exposures, rtol=0.0, atol=0.05)


def test_a_recording_has_the_time_of_sending(stream):
    report = frame(1)
    before = pylsl.local_clock()
    _, ((_, stamp),) = stream(report._replace(samples=tuple(replace(s, wall=None) for s in report.samples)))
    assert before <= stamp <= pylsl.local_clock()


def test_a_name_has_no_control_characters():
    assert refused("lsl:a\nb") == r"lsl:'a\nb': a name has no control characters; write lsl:NAME"
