"""A daemon in this process in which nothing waits long."""

import threading

import pytest
from daemon_world import Film, World

from spheremouse.capture import fetch
from spheremouse.output import reporter
from spheremouse.session import service

PATIENCE = 60.0  # s


@pytest.fixture
def quick_daemon(monkeypatch):
    """Return a generator that yields a world of tests/daemon_world.py, and checks its laws at the end."""

    def run(world):
        monkeypatch.setattr("spheremouse.session.outputs.open_output", world.open_output)
        monkeypatch.setattr(service, "_MAX_FRAME_WAIT_S", 0.02)
        monkeypatch.setattr(service, "_CHECK_INTERVAL_S", 0.1)
        monkeypatch.setattr(fetch, "BACK_OFF", (0.01, 0.02))
        monkeypatch.setattr(reporter, "RETRY_DELAYS", (0.01, 0.02))
        monkeypatch.setattr(reporter, "MAX_QUEUE_TIME", PATIENCE)
        threads = threading.active_count()
        yield world
        if world.daemon is not None:
            world.stop()
            if world.error is not None:
                raise world.error
            world.check_laws()
            world.until(lambda: threading.active_count() <= threads, "threads end")

    return run


@pytest.fixture(scope="module")
def film():
    return Film.render()


@pytest.fixture
def unstarted(film, tmp_path, quick_daemon):
    """A world whose daemon a test starts."""
    yield from quick_daemon(World(film, tmp_path))


@pytest.fixture
def world(unstarted):
    unstarted.start()
    unstarted.reach("tracking")
    unstarted.turn()
    return unstarted
