"""The control socket and the metrics port of a run that another run may hold."""

import contextlib

import pytest
from control_world import answer

from spheremouse.errors import ControlError
from spheremouse.session.control.client import Client
from spheremouse.session.control.server import Endpoints
from spheremouse.session.control.socket_file import SOCKET
from spheremouse.session.settings import ControlSettings, MetricsSettings

ANYWHERE, NO_METRICS = ControlSettings(), MetricsSettings()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    return tmp_path


def endpoints(log):
    return contextlib.closing(Endpoints(answer, log.append, lambda: None))


def test_a_run_goes_on_without_the_usual_socket_that_another_run_holds(folder):
    log = []
    with endpoints([]) as first, endpoints(log) as second:
        first.open(ANYWHERE, NO_METRICS, dict)
        second.open(ANYWHERE, NO_METRICS, dict)
    assert len(log) == 1
    assert "another daemon listens there" in log[0]
    assert "cannot ask this run" in log[0]


def test_a_run_without_its_configured_socket_is_refused(folder):
    asked_for = ControlSettings(socket=str(folder / "s"))
    with endpoints([]) as first, endpoints([]) as second:
        first.open(asked_for, NO_METRICS, dict)
        with pytest.raises(ControlError, match="another daemon listens there"):
            second.open(asked_for, NO_METRICS, dict)


def test_a_run_goes_on_without_metrics_that_cannot_be_served(folder):
    log = []
    with endpoints(log) as one:
        one.open(ANYWHERE, MetricsSettings(port=9999, address="nonsense"), dict)
        assert Client(folder / SOCKET).ask("pause")
    assert len(log) == 1
    assert log[0].endswith("going on without")
