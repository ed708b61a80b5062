"""The metrics: against the status, the page that lists them and the dashboard."""

import contextlib
import http.client
import json
import re
import socket
import time
import urllib.parse
from pathlib import Path

import pytest
from control_world import a_status

from spheremouse.errors import ControlError
from spheremouse.session.control import metrics
from spheremouse.session.control.status import STATES, StatusReport
from spheremouse.session.settings import MetricsSettings

pytest.importorskip("prometheus_client")

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
BOARD = json.loads((ROOT / "service" / "grafana" / "spheremouse.json").read_text(encoding="utf-8"))
GENEROUS = 20.0  # s
STARTED = 1.8e9  # s since 1970


def a_report():
    return StatusReport.read(a_status())


def metrics_of(status):
    """{(name, labels): value}, and the kind of each name."""
    found = list(metrics.families(StatusReport.read(status), STARTED))
    samples = {(s.name, tuple(sorted(s.labels.items()))): s.value for f in found for s in f.samples}
    return samples, {s.name: f.type for f in found for s in f.samples}


def serve(status, address=None):
    return metrics.serve_metrics(0, address or MetricsSettings().address, status)


def get(server, path="/metrics"):
    url = urllib.parse.urlsplit(server)
    connection = http.client.HTTPConnection(url.hostname, url.port, timeout=GENEROUS)
    with contextlib.closing(connection):
        connection.request("GET", path)
        response = connection.getresponse()
        return response.status, response.read().decode()


def test_the_figures_are_those_of_the_status():
    status = a_status()
    samples, kinds = metrics_of(status)

    def value(name, **labels):
        return samples["spheremouse_" + name, tuple(sorted(labels.items()))]

    assert {s: value("state", state=s) for s in STATES} == {s: float(s == "tracking") for s in STATES}
    assert value("info", version="0.1.0", source="v4l2", output="uinput") == 1.0
    assert value("start_time_seconds") == STARTED
    counters = {
        "not_tracked_seconds_total": "unseen_s", "lost_total": "lost_count", "frames_total": "frames",
        "camera_restarts_total": "camera_restarts", "skipped_frames_total": "skipped",
        "dropped_frames_total": "dropped", "damaged_frames_total": "damaged",
    }  # fmt: skip
    for name, key in counters.items():
        assert value(name) == status[key]
        assert kinds["spheremouse_" + name] == "counter"
    assert value("reports_total") == status["outputs"][0]["reports"]
    for quantile, key in (("0.5", "p50"), ("0.99", "p99"), ("1", "max")):
        assert value("latency_seconds", quantile=quantile) == pytest.approx(status["latency_ms"][key] / 1000, rel=1e-12)
    for stage, values in status["stages_ms"].items():
        assert value("stage_seconds", stage=stage, quantile="0.99") == pytest.approx(values["p99"] / 1000, rel=1e-12)
    assert [value("discs", kind=k) for k in ("used", "seen", "known")] == [17, 19, 26]
    assert [value("unsent_counts", axis=a) for a in ("x", "y", "third")] == [0, -12, 0]
    assert value("state_age_seconds") == status["since_s"]
    assert value("frames_per_second") == status["fps"]
    assert value("pose_age_seconds") == status["pose"]["age_s"]
    assert (value("output_failed"), value("recording")) == (0.0, 0.0)
    assert value("resident_memory_bytes") == pytest.approx(143.2e6)
    assert value("cpu_ratio") == status["cpu_share"]
    status["outputs"][0] |= {"failed": "/dev/uinput: gone"}
    status["recording"] = {"folder": "/r", "frames": 1, "seconds": 1.0, "bytes": 1, "dropped": 0}
    samples, _ = metrics_of(status)
    assert (value("output_failed"), value("recording")) == (1.0, 1.0)


def test_what_is_not_known_is_left_out():
    samples, _ = metrics_of(a_status(state="starting", latency_ms=None, pose=None, discs=None, cpu_share=None))
    names = {name for name, _ in samples}
    assert "spheremouse_state" in names
    unknown = {"latency_seconds", "pose_age_seconds", "cpu_ratio"}
    assert not names & {f"spheremouse_{name}" for name in unknown}
    assert "nan" not in str(samples)


def test_no_path_of_a_file_is_given_out():
    status = a_status(reason="/home/somebody/secret")
    status["outputs"][0]["spec"] = "text:/home/somebody/log"
    with serve(lambda: StatusReport.read(status)) as server:
        text = get(server)[1]
    assert "/" not in re.sub(r"^# .*", "", text, flags=re.M)


def test_a_restart_is_seen_and_none_is_imagined():
    status, before = a_status(), time.time()

    def started(server):
        found = re.search(r"^spheremouse_start_time_seconds (\S+)", get(server)[1], re.M)
        assert found
        return float(found[1])

    with serve(lambda: StatusReport.read(status)) as server:
        first = started(server)
        assert before <= first + status["uptime_s"] <= time.time()
        status["uptime_s"] += 0.01  # measured a little late
        assert started(server) == first
    with serve(lambda: StatusReport.read({**status, "uptime_s": 0.0})) as server:
        assert started(server) > first


# ---- the page and the dashboard ----


def test_the_page_lists_every_figure_with_its_kind_and_labels():
    samples, kinds = metrics_of(a_status())
    labels = {name: {k for k, _ in found} for name, found in samples}
    listed = {
        name: (kind, set(names.strip("{}").split(",")) - {""})
        for name, names, kind in re.findall(r"^\| `(spheremouse_[a-z_]+)(\{[a-z,]+\})?` \| (\w+) \|", PAGE, re.M)
    }
    assert listed == {name: (kinds[name], labels[name]) for name in kinds}
    assert not re.search(r"_(ms|milliseconds|minutes|mb|megabytes|percent|mm)(_|\b)", " ".join(kinds))  # base units


def queries():
    """Every query of the dashboard and of the page's alarms."""
    for panel in BOARD["panels"]:
        for target in panel["targets"]:
            yield target["expr"]
    for variable in BOARD["templating"]["list"][1:]:
        yield variable["query"]["query"]
    yield from re.findall(r"expr: (.+)", PAGE)


def test_dashboard_and_alarms_ask_for_what_there_is():
    samples, kinds = metrics_of(a_status())
    asked = set()
    for query in queries():
        bare = re.sub(r'"[^"]*"', '""', query)
        assert bare.count("(") == bare.count(")")
        names = set(re.findall(r"\bspheremouse_\w+", query))
        assert names <= set(kinds), query
        asked |= names
        for name, selector in re.findall(r"\b(spheremouse_\w+)\{([^}]*)\}", query):
            known = {k for n, ls in samples for k, _ in ls if n == name} | {"job", "instance"}
            for label, value in re.findall(r'(\w+)=~?"([^"]*)"', selector):
                assert label in known, query
                if not value.startswith("$"):
                    there = {v for n, ls in samples for k, v in ls if (n, k) == (name, label)}
                    assert set(value.split("|")) <= there, query
        for function, name in re.findall(r"\b(rate|increase|changes)\((spheremouse_\w+)", query):
            assert (kinds[name] == "counter") == (function != "changes"), query
    wanted = {"state", "not_tracked_seconds_total", "latency_seconds", "start_time_seconds", "camera_restarts_total"}
    assert asked >= {"spheremouse_" + name for name in wanted}


# ---- the server ----


def test_it_listens_on_this_machine_by_default_and_on_ipv6():
    with serve(a_report) as server:
        assert server.startswith("http://127.0.0.1:")
    if socket.has_ipv6:
        with serve(a_report, "::1") as server:
            assert get(server)[0] == 200


def test_a_silent_client_delays_no_other():
    with serve(a_report) as server:
        url = urllib.parse.urlsplit(server)
        with socket.create_connection((url.hostname, url.port), GENEROUS) as silent:
            silent.sendall(b"GET /metr")
            assert get(server)[0] == 200


def test_an_address_that_cannot_be_used_is_an_error_with_its_remedy():
    with contextlib.closing(socket.create_server(("127.0.0.1", 0))) as other:
        port = other.getsockname()[1]
        with pytest.raises(ControlError, match=rf"cannot listen at 127.0.0.1 port {port} \(Address already in use\)"):
            metrics.serve_metrics(port, "127.0.0.1", a_report).__enter__()
    with pytest.raises(ControlError, match=r"cannot listen at 999\.0\.0\.1 port 0"):
        serve(a_report, "999.0.0.1").__enter__()


def test_without_the_library_the_message_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "prometheus_client", None)
    with pytest.raises(ControlError, match=r"pip install 'spheremouse\[metrics\]'"):
        serve(a_report).__enter__()
