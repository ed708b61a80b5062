"""The doors: what another run has is waited for, or refused; nothing stays open."""

import contextlib
import time

import pytest

from spheremouse.errors import ControlError
from spheremouse.session.control.client import Client
from spheremouse.session.control.endpoints import Endpoints
from spheremouse.session.control.places import SOCKET
from spheremouse.session.settings.control import ControlSettings, MetricsSettings

ANYWHERE, NO_METRICS = ControlSettings(), MetricsSettings()


def answer(request, reply):
    reply({"state": "tracking"})


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where the socket is of who does not say."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    return tmp_path


def doors(said):
    return contextlib.closing(Endpoints(answer, said.append))


def test_the_socket_is_had_when_who_had_it_is_gone(folder):
    said, now = [], time.monotonic()
    with doors(said) as second:
        with doors([]) as first:
            first.open(ANYWHERE, NO_METRICS, dict)
            second.open(ANYWHERE, NO_METRICS, dict)
            second.tend(ANYWHERE, now + 100.0)
            assert len(said) == 1
            assert "another daemon listens there" in said[0]
            assert "cannot ask this run" in said[0]
        second.tend(ANYWHERE, now + 101.0)  # not all the time
        assert len(said) == 1
        second.tend(ANYWHERE, now + 200.0)
        assert said[1:] == ["control: `spheremouse ctl` can ask this run now"]
        assert Client(folder / SOCKET).ask("pause") == {"state": "tracking"}
    assert not (folder / SOCKET).exists()


def test_a_socket_that_was_asked_for_is_had_or_the_run_is_refused(folder):
    asked_for = ControlSettings(socket=str(folder / "s"))
    with doors([]) as first, doors([]) as second:
        first.open(asked_for, NO_METRICS, dict)
        with pytest.raises(ControlError, match="another daemon listens there"):
            second.open(asked_for, NO_METRICS, dict)


def test_metrics_that_cannot_be_served_are_said_and_done_without(folder):
    said = []
    with doors(said) as one:
        one.open(ANYWHERE, MetricsSettings(port=9999, address="nonsense"), dict)
        assert Client(folder / SOCKET).ask("pause")
    assert len(said) == 1
    assert said[0].endswith("going on without")
