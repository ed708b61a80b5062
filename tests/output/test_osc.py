"""OSC bundles, as python-osc's own server receives them."""

import contextlib
import queue
import threading

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from spheremouse.output import Report, open_output
from spheremouse.output.sample import Sample
from spheremouse.tracker import Status, unknown

pytest.importorskip("pythonosc")
from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_server import ThreadingOSCUDPServer

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
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(12, 12))
    return unknown(1.5, 7, status)._replace(
        rotation=Rotation.random(random_state=rng).as_matrix(),
        position=rng.normal(size=3),
        rate=rng.normal(size=6),
        covariance=A @ A.T,
        confirmed=True,
    )


def frame(*samples, counts=(3, -2, 1), pointing=0):
    return Report(counts, None, 1.5, samples, pointing)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_attitude_rate_and_sigma_arrive_within_the_rounding_of_float32(link, seed):
    server, output = link
    e = estimate(seed)
    output.send(frame(Sample(e)))
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
    output.send(frame(*samples, counts=(2**40, -(2**40), 6), pointing=1))
    read = server.take(18)
    assert [read[f"/spheremouse/{n}/counts"] for n in (1, 2, 3)] == [(0, 0, 0), (2**31 - 1, 1 - 2**31, 6), (0, 0, 0)]
    for sample in samples:
        assert np.allclose(read[f"/spheremouse/{sample.ball}/position"], sample.position, rtol=FLOAT32, atol=0.0)
    assert [server.bundle().num_contents for _ in samples] == [6, 6, 6]


@pytest.mark.parametrize("status", [Status.SEARCHING, Status.LOST])
def test_a_ball_that_is_not_tracked_has_status_and_counts_alone(status):
    with receiving() as (server, output):
        output.send(frame(Sample(estimate(1, status))))
        assert server.take(2) == {"/spheremouse/1/status": (str(status),), "/spheremouse/1/counts": (3, -2, 1)}
        assert server.bundle().num_contents == 2


def test_the_time_tag_is_the_wall_clock_of_the_exposure_or_immediately():
    with receiving() as (server, output):
        for wall in (1.7e9 + 0.125, None):
            output.send(frame(Sample(estimate(1), wall=wall)))
        live, recorded = server.bundle(), server.bundle()
        assert live.timestamp == pytest.approx(1.7e9 + 0.125, abs=1e-6)
        assert recorded.dgram[8:16] == b"\0\0\0\0\0\0\0\1"  # OSC 1.0: 63 zero bits followed by a one


def test_a_report_between_two_frames_sends_nothing():
    with receiving() as (server, output):
        output.send(frame())
        output.send(frame(Sample(estimate(1, Status.LOST))))
        assert server.bundle().num_contents == 2
        assert server.datagrams.empty()


def test_no_receiver_is_no_error():
    with receiving() as (server, _):
        port = server.server_address[1]
    with open_output(f"osc:127.0.0.1:{port}") as output:
        for _ in range(3):
            output.send(frame(Sample(estimate(1))))
