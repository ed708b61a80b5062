"""Threads of outputs that end with the test."""

import pytest
from reporter_world import EXACT, Frames
from reporting import PATIENCE

from spheremouse.output import reporter as module
from spheremouse.output.reporter import OutputThread


@pytest.fixture
def start(monkeypatch):
    """Return a function that starts a reporter of a world; no wait is long, and the reporter ends with the test."""
    monkeypatch.setattr(module, "RETRY_DELAYS", (0.005, 0.02))
    monkeypatch.setattr(module, "MAX_QUEUE_TIME", PATIENCE)  # a test machine may hang as well
    started = []

    def begin(world, settings=EXACT, open_it=None):
        reporter = OutputThread(open_it or world.open, settings, world.said.append)
        started.append(reporter)
        return reporter, Frames(reporter)

    yield begin
    for reporter in started:
        reporter.close()
