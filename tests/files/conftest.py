"""Fixtures of the tests of files."""

import pytest

from spheremouse.errors import ConfigurationError
from spheremouse.files.ball_map import load_map


@pytest.fixture
def refusal(tmp_path):
    """Message of a map file that load_map refuses, without the path."""

    def message(text):
        path = tmp_path / "rig.map.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(ConfigurationError) as e:
            load_map(path)
        assert str(e.value).startswith(str(path))
        assert "\n" not in str(e.value)
        return str(e.value).removeprefix(str(path))

    return message
