"""Samples by LSL and OSC, as a client of their own library reads them."""

import contextlib
import itertools
import os
import queue
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_server import ThreadingOSCUDPServer
from reporting import refused
from scipy.spatial.transform import Rotation
from tables import frame

from spheremouse.output import Report, open_output
from spheremouse.output.columns import columns, rows
from spheremouse.output.sample import Sample
from spheremouse.tracker import Status

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


FLOAT32 = 2.0**-24  # relative rounding


class Receiver(ThreadingOSCUDPServer):
    """Keeps each datagram, and the messages in it."""

    def __init__(self):
        self.datagrams, self.messages = queue.Queue(), queue.Queue()
        dispatcher = Dispatcher()
        dispatcher.set_default_handler(lambda address, *values: self.messages.put((address, values)))
        super().__init__(("127.0.0.1", 0), dispatcher)

    def verify_request(self, request, client_address):
        self.datagrams.put(request[0])
        return super().verify_request(request, client_address)

    def take(self, count):
        return dict(self.messages.get(timeout=10) for _ in range(count))

    def bundle(self):
        return OscBundle(self.datagrams.get(timeout=10))


@contextlib.contextmanager
def receiving():
    with Receiver() as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        with open_output(f"osc:127.0.0.1:{server.server_address[1]}") as output:
            yield server, output
        server.shutdown()


@pytest.fixture(scope="module")
def link():
    with receiving() as both:
        yield both


def estimate(seed, status=Status.TRACKING):
    return frame(seed, status).samples[0].estimate


def frame_osc(*samples, counts=(3, -2, 1), pointing=0):
    return Report(counts, None, 1.5, samples, pointing)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_attitude_rate_and_sigma_arrive_within_the_rounding_of_float32(link, seed):
    server, output = link
    e = estimate(seed)
    output.send(frame_osc(Sample(e)))
    read = server.take(5)
    w, x, y, z = read["/spheremouse/1/quaternion"]
    q = Rotation.from_matrix(e.rotation).as_quat()[[3, 0, 1, 2]]
    assert w >= 0.0
    assert np.allclose([w, x, y, z], q * np.copysign(1.0, q[0]), rtol=FLOAT32, atol=1e-15)
    assert np.allclose(read["/spheremouse/1/rate"], e.rate[:3], rtol=FLOAT32, atol=0.0)
    assert np.allclose(np.square(read["/spheremouse/1/sigma"]), np.diag(e.covariance)[:3], rtol=3 * FLOAT32, atol=0.0)
    assert (read["/spheremouse/1/counts"], read["/spheremouse/1/status"]) == ((3, -2, 1), ("tracking",))


def test_each_ball_is_a_bundle_and_the_one_that_points_has_the_counts(link):
    server, output = link
    while not server.datagrams.empty():
        server.datagrams.get()
    samples = [Sample(estimate(k), k + 1, coordinates="cam") for k in range(3)]
    output.send(frame_osc(*samples, counts=(2**40, -(2**40), 6), pointing=1))
    read = server.take(18)
    assert [read[f"/spheremouse/{n}/counts"] for n in (1, 2, 3)] == [(0, 0, 0), (2**31 - 1, 1 - 2**31, 6), (0, 0, 0)]
    for sample in samples:
        assert np.allclose(read[f"/spheremouse/{sample.ball}/position"], sample.position, rtol=FLOAT32, atol=0.0)
    assert [server.bundle().num_contents for _ in samples] == [6, 6, 6]


@pytest.mark.parametrize(
    ("status", "rate"),
    [(Status.SEARCHING, 0.0), (Status.LOST, 0.0), (Status.TRACKING, np.nan), (Status.TRACKING, np.inf)],
)
def test_a_ball_that_is_not_tracked_or_has_no_finite_rate_has_status_and_counts_alone(status, rate):
    with receiving() as (server, output):
        output.send(frame_osc(Sample(estimate(1, status)._replace(rate=np.full(6, rate)))))
        assert server.take(2) == {"/spheremouse/1/status": (str(status),), "/spheremouse/1/counts": (3, -2, 1)}
        assert server.bundle().num_contents == 2


def test_the_time_tag_is_the_wall_clock_of_the_exposure_or_immediately():
    with receiving() as (server, output):
        for wall in (1.7e9 + 0.125, None, 2.1e9):
            output.send(frame_osc(Sample(estimate(1), wall=wall)))
        live, recorded, after_2036 = server.bundle(), server.bundle(), server.bundle()
        assert live.timestamp == pytest.approx(1.7e9 + 0.125, abs=1e-6)
        assert recorded.dgram[8:16] == b"\0\0\0\0\0\0\0\1"  # OSC 1.0: 63 zero bits followed by a one
        assert int.from_bytes(after_2036.dgram[8:12]) == 2_100_000_000 - 2_085_978_496  # RFC 5905: the era begins anew


def test_a_report_between_two_frames_sends_nothing():
    with receiving() as (server, output):
        output.send(frame_osc())
        output.send(frame_osc(Sample(estimate(1, Status.LOST))))
        assert server.bundle().num_contents == 2
        assert server.datagrams.empty()


def test_no_receiver_is_no_error():
    with receiving() as (server, _):
        port = server.server_address[1]
    with open_output(f"osc:127.0.0.1:{port}") as output:
        for _ in range(3):
            output.send(frame_osc(Sample(estimate(1))))
