"""Fixtures of the tests of files."""

import invoking
import pytest

from spheremouse.errors import ConfigurationError
from spheremouse.files.ball_map import load_map


@pytest.fixture
def refusal(tmp_path):
    """Message of a map file that load_map refuses, without the path."""

    def message(text):
        path = tmp_path / "rig.map.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        said = invoking.refusal(ConfigurationError, load_map, path)
        assert said.startswith(str(path))
        return said.removeprefix(str(path))

    return message
