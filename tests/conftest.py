"""Where the reference recordings are, and what to do without them."""

import os
from pathlib import Path

import pytest


def datasets_dir() -> Path:
    """Folder of the reference recordings; skips the test that asks where it does not exist."""
    path = Path(os.environ.get("SPHEREMOUSE_DATASETS", Path(__file__).parents[2] / "shared" / "datasets"))
    if not path.is_dir():
        pytest.skip(f"reference recordings not found at {path} (set SPHEREMOUSE_DATASETS)")
    return path


@pytest.fixture
def far26() -> Path:
    """The reference recording far26, or a skip."""
    return datasets_dir() / "far26"
