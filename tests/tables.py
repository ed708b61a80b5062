"""Reports for tests of tables, and a disk that is full after so many bytes."""

import contextlib
import resource
import signal
import subprocess
import sys

import numpy as np
from scipy.spatial.transform import Rotation

from spheremouse.output import Report
from spheremouse.output.sample import Sample
from spheremouse.tracker import Status, unknown


def frame(sequence, status=Status.TRACKING, coordinates="obj", balls=1, pointing=0):
    """Return the report of a frame of a ball that moves at random."""
    rng = np.random.default_rng(sequence)
    samples = []
    for ball in range(1, balls + 1):
        A = rng.normal(size=(12, 12))
        estimate = unknown(sequence / 30.0, sequence, status)._replace(
            rotation=Rotation.random(random_state=rng).as_matrix(), position=rng.normal(size=3),
            rate=rng.normal(size=6), covariance=A @ A.T, increment=rng.normal(size=6),
            increment_covariance=(A @ A.T)[:6, :6], confirmed=True,
            statistics={"discs_used": 5, "discs_seen": 7, "discs_known": 20, "nis": rng.chisquare(10)}
        )  # fmt: skip
        name = "ball #1"
        samples.append(
            Sample(estimate, ball, name, coordinates, ("turned", "ball-lost"), 1.7e9 + sequence / 30.0, 0.01)
        )
    return Report((sequence, -2, 3), None, sequence / 30.0, tuple(samples), pointing)


@contextlib.contextmanager
def full_disk(size):
    """Refuse to write files beyond `size` bytes, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


_KILLED = """
import os, signal, sys, time
sys.path[:0] = {path!r}
from tables import frame
from spheremouse.output import log_file, open_output
log_file.MAX_WAIT_S = 0.1
output = open_output({spec!r}).__enter__()
output.begin(lambda: {{"source": "a test"}})
for k in range(1, 101):
    output.send(frame(k))
    time.sleep(0.15 if k == 90 else 0.0)
os.kill(os.getpid(), signal.SIGKILL)
"""


def write_and_be_killed(spec):
    """Write 100 frames, the last ten after a pause, from another process, which writes each 0.1 s and is killed."""
    program = _KILLED.format(spec=spec, path=sys.path)
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == -signal.SIGKILL
