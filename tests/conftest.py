"""Where the reference recordings are, and what to do without them."""

import os
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

threadpool_limits(1)  # as the command line does


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


def directions(n: int, seed: int, least: float = 0.2) -> np.ndarray:
    """Unit vectors, (n, 3), of which no two are nearer than `least` rad."""
    rng = np.random.default_rng(seed)
    found: list[np.ndarray] = []
    while len(found) < n:
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        if all(d @ other < np.cos(least) for other in found):
            found.append(d)
    return np.array(found)
