"""The status as metrics for Prometheus, over HTTP; docs/metrics.md lists them. Needs the extra `metrics`.

One thread answers one request at a time, slowly enough that no client slows the tracker.
"""

import http.server
import ipaddress
import socket
import socketserver
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Self

from spheremouse.errors import ControlError, one_line
from spheremouse.session.control.status import STATES, OutputStatus, PoseStatus, Quantiles, SourceStatus, StatusReport
from spheremouse.session.process.threads import begin

_REST = 0.05  # s after each request
_STALLED = 2.0  # s in which a client must send or take its next bytes
_POLL = 0.2  # s between two checks whether to end

Samples = Sequence[tuple[dict[str, str], float | None]]  # labels, value


class MetricsServer:
    """Answers `GET /metrics` in a thread of its own until `close`."""

    def __init__(
        self,
        port: int,
        address: str,
        status: Callable[[], StatusReport],
        log: Callable[[str], None] = lambda line: None,
    ) -> None:
        """`status` is called in the server's thread."""
        try:
            from prometheus_client import CollectorRegistry, MetricsHandler
        except ImportError:
            raise ControlError(
                "metrics: prometheus-client is not installed; pip install 'spheremouse[metrics]', or metrics.port: null"
            ) from None
        try:
            ip = ipaddress.ip_address(address)
        except ValueError:
            raise ControlError(f"metrics.address: {address!r} is no IP address; 127.0.0.1 is this machine") from None
        registry = CollectorRegistry()
        registry.register(_Collector(status))
        handler = type("Handler", (MetricsHandler,), {"registry": registry, "timeout": _STALLED})
        try:
            self._server = _Server((str(ip), port), handler, ip.version == 6, log)
        except OSError as e:
            where = f"{address} port {port}"
            raise ControlError(f"metrics: cannot listen at {where} ({e.strerror}); change metrics.port") from None
        self.url = f"http://{f'[{ip}]' if ip.version == 6 else ip}:{self._server.server_address[1]}/metrics"
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="metrics", daemon=True)
        try:
            begin(self._thread)
        except ControlError:
            self._server.server_close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop listening, without waiting for a slow client."""
        self._ending.set()
        self._thread.join(2.0 * _POLL)
        self._server.server_close()

    def _run(self) -> None:
        while not self._ending.is_set():
            self._server.handle_request()


class _Server(http.server.HTTPServer):
    timeout = _POLL

    def __init__(self, address: tuple[str, int], handler: type, six: bool, log: Callable[[str], None]) -> None:
        self.address_family = socket.AF_INET6 if six else socket.AF_INET
        self._log = log
        super().__init__(address, handler)

    def server_bind(self) -> None:
        """Bind without asking a name server for this host's name, as HTTPServer does."""
        socketserver.TCPServer.server_bind(self)

    def process_request(self, request: Any, client_address: Any) -> None:
        super().process_request(request, client_address)
        time.sleep(_REST)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log an error in one line, unless the client has disconnected or stalls."""
        e = sys.exception()
        if not isinstance(e, OSError):
            self._log(f"metrics: internal error ({type(e).__name__}: {one_line(str(e))}); please report it")


class _Collector:
    def __init__(self, status: Callable[[], StatusReport]) -> None:
        self._status = status
        self._started: float | None = None

    def describe(self) -> list[Any]:
        """Return nothing: the registry would otherwise collect before there is a status."""
        return []

    def collect(self) -> Iterator[Any]:
        """Yield the metrics of the present status."""
        status = self._status()
        if self._started is None:  # computed once: a start time that varies looks like a restart
            self._started = time.time() - (status.uptime_s or 0.0)
        yield from families(status, self._started)


def families(status: StatusReport, started: float) -> Iterator[Any]:
    """Yield the metric families of a status; `started` in s since 1970. A value that is not known is left out."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily

    kinds = {"source": _kind(status.source), "output": _kind((status.outputs or [None])[0])}
    yield InfoMetricFamily("spheremouse", "What runs.", {"version": status.version or "", **kinds})
    for metrics, family in ((_gauges(status, started), GaugeMetricFamily), (_counters(status), CounterMetricFamily)):
        for name, text, samples in metrics:
            made = family(f"spheremouse_{name}", text, labels=list(samples[0][0]) if samples else [])
            for labels, value in samples:
                if value is not None:
                    made.add_metric(list(labels.values()), float(value))
            yield made


def _counters(s: StatusReport) -> Iterator[tuple[str, str, Samples]]:
    reports = sum(output.reports or 0 for output in s.outputs or ())
    for name, text, value in (
        ("not_tracked_seconds", "Time since the start without tracking.", s.unseen_s),
        ("lost", "Number of times that the ball was lost.", s.lost_count),
        ("camera_restarts", "Number of times that the camera was reopened.", s.camera_restarts),
        ("frames", "Frames that were processed.", s.frames),
        ("skipped_frames", "Frames that a newer one replaced.", s.skipped),
        ("dropped_frames", "Frames that the driver did not deliver.", s.dropped),
        ("damaged_frames", "Frames that could not be decoded.", s.damaged),
        ("reports", "Reports sent.", reports),
    ):
        yield name, text, [({}, value)]


def _gauges(s: StatusReport, started: float) -> Iterator[tuple[str, str, Samples]]:
    output, pose = (s.outputs or [OutputStatus()])[0], s.pose or PoseStatus()
    memory = None if s.memory_mb is None else 1e6 * s.memory_mb
    for name, text, value in (
        ("start_time_seconds", "Start time of the daemon, since 1970.", started),
        ("state_age_seconds", "Time in this state.", s.since_s),
        ("frames_per_second", "Rate of the processed frames.", s.fps),
        ("pose_age_seconds", "Age of the camera's pose.", pose.age_s),
        ("output_failed", "1 while motion cannot be sent.", output.failed is not None),
        ("recording", "1 while it records.", s.recording is not None),
        ("resident_memory_bytes", "Memory in use.", memory),
        ("cpu_ratio", "Share of one core in use.", s.cpu_share),
    ):
        yield name, text, [({}, value)]
    yield "state", "1 for the present state, else 0.", [({"state": state}, state == s.state) for state in STATES]
    latency = "From a frame's stamp to its motion sent, of the last frames; quantile 1 is the longest."
    yield "latency_seconds", latency, list(_quantiles(s.latency_ms, {}))
    stages = [q for stage, ms in (s.stages_ms or {}).items() for q in _quantiles(ms, {"stage": stage})]
    yield "stage_seconds", "Time that a stage takes, of the last frames.", stages
    discs = {"used": s.discs, "seen": s.discs_seen, "known": s.discs_known}
    yield "discs", "Discs on the ball.", [({"kind": kind}, n) for kind, n in discs.items()]
    unsent = zip(("x", "y", "third"), output.unsent or (), strict=False)
    counts = "Sum of the counts that were not sent while paused or without output."
    yield "unsent_counts", counts, [({"axis": axis}, n) for axis, n in unsent]


def _quantiles(ms: Quantiles | None, labels: dict[str, str]) -> Iterator[tuple[dict[str, str], float]]:
    ms = ms or Quantiles()
    for quantile, value in (("0.5", ms.p50), ("0.99", ms.p99), ("1", ms.max)):
        if value is not None:
            yield {**labels, "quantile": quantile}, 1e-3 * value


def _kind(part: SourceStatus | OutputStatus | None) -> str:
    """Return the text before the colon: the rest may be a path."""
    return ((part.spec if part else None) or "").partition(":")[0]
