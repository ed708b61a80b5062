"""Film of a ball with a pattern, for the commands that need no calibration."""

import pytest
from invoking import succeed

from spheremouse.commands import app


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("film") / "speckle"
    words = ("--pattern", "speckle", "--motion", "play", "--seconds", 4, "--noise", 4, "--size", "320x240")
    succeed(app, "simulate", folder, *words)
    return folder
