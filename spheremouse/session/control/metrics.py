"""The status as figures for Prometheus, over HTTP; docs/metrics.md lists them. Needs the extra `metrics`.

Anybody who reaches the port may read, and nothing else: no path of a file, no picture, no command goes this way.
"""

import contextlib
import http.server
import ipaddress
import socket
import socketserver
import threading
import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, Self

from spheremouse.errors import ControlError, one_line
from spheremouse.session.control.status import STATES
from spheremouse.session.process.threads import begin
from spheremouse.session.settings.control import MetricsSettings

_AT_ONCE = 4  # requests; who comes when there are more is hung up on
_LONGEST = 5.0  # s that one may take
_FRESH = 0.5  # s for which the same text is given out again
_AXES = ("x", "y", "third")


class MetricsServer:
    """Answers `GET /metrics` in threads of its own until `close`."""

    def __init__(self, settings: MetricsSettings, status: Callable[[], dict[str, Any]]) -> None:
        assert settings.port is not None
        self._page = _Page(status)
        try:
            address = ipaddress.ip_address(settings.address)
        except ValueError:
            raise ControlError(
                f"metrics.address: {settings.address!r} is no IP address; 127.0.0.1 is this machine"
            ) from None
        try:
            self._server = _Server((str(address), settings.port), self._page, address.version == 6)
        except OSError as e:
            where = f"{settings.address} port {settings.port}"
            raise ControlError(f"metrics: cannot listen at {where} ({e.strerror}); change metrics.port") from None
        host = f"[{address}]" if address.version == 6 else str(address)
        self.url = f"http://{host}:{self._server.server_address[1]}/metrics"
        self._thread = threading.Thread(target=self._server.serve_forever, name="metrics", daemon=True)
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
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(5.0)


def serve(settings: MetricsSettings, status: Callable[[], dict[str, Any]]) -> MetricsServer | None:
    """The server of the figures; None where no port is configured. `status` is called from its threads."""
    return None if settings.port is None else MetricsServer(settings, status)


class _Page:
    """The text of the figures, made anew when somebody asks and the last one is old."""

    def __init__(self, status: Callable[[], dict[str, Any]]) -> None:
        try:
            from prometheus_client import CollectorRegistry, exposition
        except ImportError:
            raise ControlError(
                "metrics: prometheus-client is not installed; pip install 'spheremouse[metrics]', or metrics.port: null"
            ) from None
        self._status = status
        self._registry = CollectorRegistry()
        self._registry.register(self)
        self._generate, self.content_type = exposition.generate_latest, exposition.CONTENT_TYPE_PLAIN_0_0_4
        self._started: float | None = None
        self._lock = threading.Lock()
        self._text, self._made = b"", -float("inf")

    def text(self) -> bytes:
        """What is answered now."""
        with self._lock:
            if time.monotonic() - self._made >= _FRESH:
                self._text = self._generate(self._registry)
                self._made = time.monotonic()
            return self._text

    def describe(self) -> list[Any]:
        """For the registry, which would ask for figures before there are any."""
        return []

    def collect(self) -> Iterator[Any]:
        """The figures of the present status."""
        status = self._status()
        if self._started is None:  # once: a time that trembles looks like a restart
            self._started = time.time() - float(status.get("uptime_s") or 0.0)
        yield from families(status, self._started)


def families(status: dict[str, Any], started: float) -> Iterator[Any]:
    """Metric families of a status (a `protocol.StatusReport` as a dict); `started`: s since 1970."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily

    def gauge(name: str, text: str, *values: tuple[dict[str, str], Any]) -> Any:
        return _family(GaugeMetricFamily, name, text, values)

    def counter(name: str, text: str, *values: tuple[dict[str, str], Any]) -> Any:
        return _family(CounterMetricFamily, name, text, values)

    state, output, pose = status.get("state"), status.get("output") or {}, status.get("pose") or {}
    kinds = {part: _kind(status.get(part)) for part in ("source", "output")}
    yield InfoMetricFamily("spheremouse", "What runs.", {"version": str(status.get("version", "")), **kinds})
    yield gauge("start_time_seconds", "When the daemon was started, since 1970.", ({}, started))
    yield gauge("state", "1 for the present state, else 0.", *(({"state": s}, float(s == state)) for s in STATES))
    yield gauge("state_age_seconds", "For how long it has been the state.", ({}, status.get("since_s")))
    yield counter("not_tracked_seconds", "Time since the start without tracking.", ({}, status.get("unseen_s")))
    yield counter("lost", "How often the ball was lost.", ({}, status.get("lost_count")))
    yield counter("camera_restarts", "How often the camera was opened again.", ({}, status.get("camera_restarts")))
    yield counter("frames", "Frames that were worked on.", ({}, status.get("frames")))
    yield counter("skipped_frames", "Frames that a newer one replaced.", ({}, status.get("skipped")))
    yield counter("dropped_frames", "Frames that the driver did not deliver.", ({}, status.get("dropped")))
    yield counter("damaged_frames", "Frames that could not be decoded.", ({}, status.get("damaged")))
    yield gauge("frames_per_second", "Rate of the frames worked on.", ({}, status.get("fps")))
    yield gauge(
        "latency_seconds",
        "From a frame's stamp to its motion sent, of the last frames; quantile 1 is the longest.",
        *_quantiles(status.get("latency_ms"), {}),
    )
    stages = status.get("stages_ms") or {}
    yield gauge(
        "stage_seconds",
        "Time that a stage takes, of the last frames.",
        *(q for stage, values in stages.items() for q in _quantiles(values, {"stage": str(stage)})),
    )
    discs = {"used": "discs", "seen": "discs_seen", "known": "discs_known"}
    yield gauge("discs", "Discs on the ball.", *(({"kind": k}, status.get(name)) for k, name in discs.items()))
    yield gauge("pose_age_seconds", "Since the camera's pose was estimated.", ({}, pose.get("age_s")))
    yield gauge("output_failed", "1 while motion cannot be sent.", ({}, float(output.get("failed") is not None)))
    yield counter("reports", "Reports sent.", ({}, output.get("reports")))
    unsent = zip(_AXES, output.get("unsent") or (), strict=False)
    yield gauge(
        "unsent_counts",
        "Sum of the counts that were not sent while paused or without output.",
        *(({"axis": axis}, value) for axis, value in unsent),
    )
    yield gauge("recording", "1 while it records.", ({}, float(status.get("recording") is not None)))
    memory = status.get("memory_mb")
    yield gauge("resident_memory_bytes", "Memory in use.", ({}, None if memory is None else 1e6 * memory))
    yield gauge("cpu_ratio", "Share of one core in use.", ({}, status.get("cpu_share")))


def _family(cls: type, name: str, text: str, values: tuple[tuple[dict[str, str], Any], ...]) -> Any:
    """A metric family; what is not known now is left out of it."""
    labels = list(values[0][0]) if values else []
    family = cls(f"spheremouse_{name}", text, labels=labels)
    for given, value in values:
        if isinstance(value, int | float):
            family.add_metric([given[k] for k in labels], float(value))
    return family


def _quantiles(values: Any, labels: dict[str, str]) -> list[tuple[dict[str, str], Any]]:
    """Quantiles in s of a dict of those in ms."""
    known = values if isinstance(values, dict) else {}
    names = {"0.5": "p50", "0.99": "p99", "1": "max"}
    return [({**labels, "quantile": q}, 1e-3 * known[name]) for q, name in names.items() if known.get(name) is not None]


def _kind(part: Any) -> str:
    """What comes before the colon; what comes after may be a path."""
    return str(part.get("spec") or "").partition(":")[0] if isinstance(part, dict) else ""


class _Server(socketserver.ThreadingMixIn, http.server.HTTPServer):
    """HTTP in a few threads, none of which anybody can keep."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 16

    def __init__(self, address: tuple[str, int], page: _Page, six: bool) -> None:
        self.address_family = socket.AF_INET6 if six else socket.AF_INET
        self.page = page
        self._places = threading.BoundedSemaphore(_AT_ONCE)
        super().__init__(address, _Handler)

    def server_bind(self) -> None:
        """Without asking the name server who we are, as HTTPServer does."""
        socketserver.TCPServer.server_bind(self)

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._places.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except RuntimeError:  # no thread to be had
            self._places.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        end = threading.Timer(_LONGEST, _hang_up, (request,))
        end.daemon = True
        try:
            begin(end)
            super().process_request_thread(request, client_address)
        except ControlError:  # no thread to be had: nobody would end it
            self.shutdown_request(request)
        finally:
            end.cancel()
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that goes is no news."""


def _hang_up(request: socket.socket) -> None:
    with contextlib.suppress(OSError):
        request.shutdown(socket.SHUT_RDWR)


class _Handler(http.server.BaseHTTPRequestHandler):
    server: _Server  # pyright: ignore[reportIncompatibleVariableOverride]

    def do_GET(self) -> None:
        """The figures."""
        if self.path.partition("?")[0] != "/metrics":
            self.send_error(404, "only /metrics is here")
            return
        try:
            text = self.server.page.text()
        except Exception as e:
            self.send_error(500, one_line(f"no status ({type(e).__name__})"))
            return
        self.send_response(200)
        self.send_header("Content-Type", self.server.page.content_type)
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)

    def version_string(self) -> str:
        """Who answers, without the version of Python."""
        return "spheremouse"

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: a log is not to be filled from outside."""
