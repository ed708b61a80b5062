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
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, Self

from spheremouse.errors import ControlError, one_line
from spheremouse.session.control.status import STATES
from spheremouse.session.process.threads import begin

_REST = 0.05  # s after each request
_STALLED = 2.0  # s in which a client must send or take its next bytes
_POLL = 0.2  # s between two checks whether to end

Status = dict[str, Any]
Samples = list[tuple[dict[str, str], Any]]  # labels, value or None


class MetricsServer:
    """Answers `GET /metrics` in a thread of its own until `close`."""

    def __init__(
        self, port: int, address: str, status: Callable[[], Status], log: Callable[[str], None] = lambda line: None
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
    def __init__(self, status: Callable[[], Status]) -> None:
        self._status = status
        self._started: float | None = None

    def describe(self) -> list[Any]:
        """Return nothing: the registry would otherwise collect before there is a status."""
        return []

    def collect(self) -> Iterator[Any]:
        """Yield the metrics of the present status."""
        status = self._status()
        if self._started is None:  # computed once: a start time that varies looks like a restart
            self._started = time.time() - float(status.get("uptime_s") or 0.0)
        yield from families(status, self._started)


def families(status: Status, started: float) -> Iterator[Any]:
    """Yield the metric families of a status (a `StatusReport` as a dict); `started` in s since 1970.

    A value that is not known is left out.
    """
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily

    kinds = {part: _kind(status.get(part)) for part in ("source", "output")}
    yield InfoMetricFamily("spheremouse", "What runs.", {"version": str(status.get("version", "")), **kinds})
    for families_of_a_kind, family in (
        (_gauges(status, started), GaugeMetricFamily),
        (_counters(status), CounterMetricFamily),
    ):
        for name, (text, samples) in families_of_a_kind.items():
            made = family(f"spheremouse_{name}", text, labels=list(samples[0][0]) if samples else [])
            for labels, value in samples:
                if isinstance(value, int | float):
                    made.add_metric(list(labels.values()), float(value))
            yield made


def _counters(status: Status) -> dict[str, tuple[str, Samples]]:
    keys = {
        "not_tracked_seconds": ("unseen_s", "Time since the start without tracking."),
        "lost": ("lost_count", "Number of times that the ball was lost."),
        "camera_restarts": ("camera_restarts", "Number of times that the camera was reopened."),
        "frames": ("frames", "Frames that were processed."),
        "skipped_frames": ("skipped", "Frames that a newer one replaced."),
        "dropped_frames": ("dropped", "Frames that the driver did not deliver."),
        "damaged_frames": ("damaged", "Frames that could not be decoded."),
    }
    reports = (status.get("output") or {}).get("reports")
    found: dict[str, tuple[str, Samples]] = {
        name: (text, [({}, status.get(key))]) for name, (key, text) in keys.items()
    }
    return {**found, "reports": ("Reports sent.", [({}, reports)])}


def _gauges(status: Status, started: float) -> dict[str, tuple[str, Samples]]:
    output, memory = status.get("output") or {}, status.get("memory_mb")
    stages = (status.get("stages_ms") or {}).items()
    discs = {"used": "discs", "seen": "discs_seen", "known": "discs_known"}
    unsent = zip(("x", "y", "third"), output.get("unsent") or (), strict=False)
    return {
        "start_time_seconds": ("Start time of the daemon, since 1970.", [({}, started)]),
        "state": (
            "1 for the present state, else 0.",
            [({"state": s}, float(s == status.get("state"))) for s in STATES],
        ),
        "state_age_seconds": ("Time in this state.", [({}, status.get("since_s"))]),
        "frames_per_second": ("Rate of the processed frames.", [({}, status.get("fps"))]),
        "latency_seconds": (
            "From a frame's stamp to its motion sent, of the last frames; quantile 1 is the longest.",
            _quantiles(status.get("latency_ms"), {}),
        ),
        "stage_seconds": (
            "Time that a stage takes, of the last frames.",
            [q for stage, values in stages for q in _quantiles(values, {"stage": str(stage)})],
        ),
        "discs": ("Discs on the ball.", [({"kind": k}, status.get(name)) for k, name in discs.items()]),
        "pose_age_seconds": ("Age of the camera's pose.", [({}, (status.get("pose") or {}).get("age_s"))]),
        "output_failed": ("1 while motion cannot be sent.", [({}, float(output.get("failed") is not None))]),
        "unsent_counts": (
            "Sum of the counts that were not sent while paused or without output.",
            [({"axis": axis}, value) for axis, value in unsent],
        ),
        "recording": ("1 while it records.", [({}, float(status.get("recording") is not None))]),
        "resident_memory_bytes": ("Memory in use.", [({}, None if memory is None else 1e6 * memory)]),
        "cpu_ratio": ("Share of one core in use.", [({}, status.get("cpu_share"))]),
    }


def _quantiles(values: Any, labels: dict[str, str]) -> Samples:
    """Return quantiles in s from those in ms."""
    known = values if isinstance(values, dict) else {}
    names = {"0.5": "p50", "0.99": "p99", "1": "max"}
    return [({**labels, "quantile": q}, 1e-3 * known[name]) for q, name in names.items() if known.get(name) is not None]


def _kind(part: Any) -> str:
    """Return the text before the colon: the rest may be a path."""
    return str(part.get("spec") or "").partition(":")[0] if isinstance(part, dict) else ""
