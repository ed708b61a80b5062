"""Film of a ball with a pattern, for the commands that need no calibration."""

import pytest
from invoking import invoke

from spheremouse.commands import app


@pytest.fixture(scope="session")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("film") / "speckle"
    words = ("--pattern", "speckle", "--motion", "play", "--seconds", 4, "--noise", 4, "--size", "320x240")
    assert invoke(app, "simulate", folder, *words)[0] == 0
    return folder
