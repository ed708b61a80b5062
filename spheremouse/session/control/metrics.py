"""The status as metrics for Prometheus, over HTTP; docs/metrics.md lists them. Needs the extra `metrics`."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any

from spheremouse.errors import ControlError
from spheremouse.session.control.status import STATES, Quantiles, StatusReport

Samples = Sequence[tuple[dict[str, str], float | None]]  # labels, value


@contextmanager
def serve_metrics(port: int, address: str, status: Callable[[], StatusReport]) -> Iterator[str]:
    """Answer `GET /metrics` in this block, and yield the URL. `status` is called in threads of the server."""
    try:
        from prometheus_client import CollectorRegistry, start_http_server
    except ImportError:
        hint = "pip install 'spheremouse[metrics]', or metrics.port: null"
        raise ControlError("metrics: prometheus-client is not installed", hint) from None
    registry = CollectorRegistry()
    registry.register(_Collector(status))
    try:
        server, _ = start_http_server(port, address, registry)
    except (OSError, RuntimeError) as e:  # RuntimeError: no thread
        where, reason = f"{address} port {port}", e.strerror if isinstance(e, OSError) else e
        raise ControlError(f"metrics: cannot listen at {where} ({reason}); change metrics.port") from None
    try:
        yield f"http://{f'[{address}]' if ':' in address else address}:{server.server_port}/metrics"
    finally:
        server.shutdown()
        server.server_close()


class _Collector:
    def __init__(self, status: Callable[[], StatusReport]) -> None:
        self._status = status

    @cached_property
    def _started(self) -> float:
        """Start time, s since 1970, computed once: one that varies looks like a restart."""
        return time.time() - self._status().uptime_s

    def collect(self) -> Iterator[Any]:
        """Return the metrics of the present status."""
        return families(self._status(), self._started)


def families(status: StatusReport, started: float) -> Iterator[Any]:
    """Yield the metric families of a status; `started` in s since 1970. A value that is not known is left out."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily

    specs = {"source": status.source.spec, "output": status.outputs[0].spec}
    kinds = {name: spec.partition(":")[0] for name, spec in specs.items()}  # the rest may be a path
    yield InfoMetricFamily("spheremouse", "What runs.", {"version": status.version, **kinds})
    for metrics, family in ((_gauges(status, started), GaugeMetricFamily), (_counters(status), CounterMetricFamily)):
        for name, text, samples in metrics:
            made = family(f"spheremouse_{name}", text, labels=list(samples[0][0]) if samples else [])
            for labels, value in samples:
                if value is not None:
                    made.add_metric(list(labels.values()), float(value))
            yield made


def _counters(s: StatusReport) -> Iterator[tuple[str, str, Samples]]:
    """Yield name, help and samples of each counter."""
    for name, text, value in (
        ("not_tracked_seconds", "Time since the start without tracking.", s.unseen_s),
        ("lost", "Number of times that the ball was lost.", s.lost_count),
        ("camera_restarts", "Number of times that the camera was reopened.", s.camera_restarts),
        ("frames", "Frames that were processed.", s.frames),
        ("skipped_frames", "Frames that a newer one replaced.", s.skipped),
        ("dropped_frames", "Frames that the driver did not deliver.", s.dropped),
        ("damaged_frames", "Frames that could not be decoded.", s.damaged),
        ("reports", "Reports sent.", sum(output.reports for output in s.outputs)),
    ):
        yield name, text, [({}, value)]


def _gauges(s: StatusReport, started: float) -> Iterator[tuple[str, str, Samples]]:
    """Yield name, help and samples of each gauge."""
    output = s.outputs[0]
    for name, text, value in (
        ("start_time_seconds", "Start time of the daemon, since 1970.", started),
        ("state_age_seconds", "Time in this state.", s.since_s),
        ("frames_per_second", "Rate of the processed frames.", s.fps),
        ("pose_age_seconds", "Age of the camera's pose.", s.pose and s.pose.age_s),
        ("output_failed", "1 while motion cannot be sent.", output.failed is not None),
        ("recording", "1 while it records.", s.recording is not None),
        ("resident_memory_bytes", "Memory in use.", 1e6 * s.memory_mb),
        ("cpu_ratio", "Share of one core in use.", s.cpu_share),
    ):
        yield name, text, [({}, value)]
    yield "state", "1 for the present state, else 0.", [({"state": state}, state == s.state) for state in STATES]
    latency = "From a frame's stamp to its motion sent, of the last frames; quantile 1 is the longest."
    yield "latency_seconds", latency, list(_quantiles(s.latency_ms, {}))
    stages = [q for stage, ms in s.stages_ms.items() for q in _quantiles(ms, {"stage": stage})]
    yield "stage_seconds", "Time that a stage takes, of the last frames.", stages
    discs = {"used": s.discs, "seen": s.discs_seen, "known": s.discs_known}
    yield "discs", "Discs, or parts of a pattern, on the ball.", [({"kind": kind}, n) for kind, n in discs.items()]
    unsent = zip(("x", "y", "third"), output.unsent, strict=True)
    counts = "Sum of the counts that were not sent while paused or without output."
    yield "unsent_counts", counts, [({"axis": axis}, n) for axis, n in unsent]


def _quantiles(ms: Quantiles | None, labels: dict[str, str]) -> Iterator[tuple[dict[str, str], float]]:
    for quantile, value in () if ms is None else (("0.5", ms.p50), ("0.99", ms.p99), ("1", ms.max)):
        if value is not None:
            yield {**labels, "quantile": quantile}, 1e-3 * value
