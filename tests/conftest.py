"""Where the reference recordings are, and what to do without them."""

import os
import signal
import sys
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from spheremouse import commands as cli
from spheremouse.session.process import realtime

_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGHUP") if hasattr(signal, name)]

threadpool_limits(1)  # as the command line does
hypothesis.settings.register_profile("untimed", deadline=None)  # machines are shared
hypothesis.settings.load_profile("untimed")


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


@pytest.fixture
def spheremouse(monkeypatch, capfd):
    """Runs the program in this process: (*words) -> exit code, standard output, standard error.

    What it would ask of the system for the whole process is not for the tests after it: real-time scheduling, locked
    memory, code folded up.
    """
    monkeypatch.setattr(realtime, "prepare", lambda wanted=True: "as it is")
    monkeypatch.setattr(realtime, "claim", lambda _: False)
    before = {s: signal.getsignal(s) for s in _SIGNALS}

    def run(*words):
        capfd.readouterr()
        monkeypatch.setattr(sys, "argv", ["spheremouse", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, err = capfd.readouterr()
        return end.value.code or 0, out, err

    yield run
    for number, handler in before.items():
        signal.signal(number, handler)


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
