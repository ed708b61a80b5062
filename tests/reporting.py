"""Reports made up for tests of outputs, counts of what was tracked, and the wait for what a thread does."""

import os
import socket
import time

import numpy as np
import pytest

from spheremouse.errors import OutputError, SpheremouseError
from spheremouse.output import Report, open_output, report_of
from spheremouse.output.counts import Counter, MotionSettings
from spheremouse.output.sample import Sample
from spheremouse.tracker import Status, unknown

PATIENCE = 60.0  # s, for what takes milliseconds


def until(condition):
    """Return the first true result of the condition."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, "it never came to be"
        time.sleep(0.002)
    return found


def error_of_nobody(action):
    """Return the error that an action has for the user nobody, in a process of its own."""
    reads, writes = os.pipe()
    if os.fork() == 0:
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)
        try:
            action()
        except SpheremouseError as e:
            os.write(writes, str(e).encode())
        finally:
            os._exit(0)
    os.close(writes)
    with os.fdopen(reads) as said:
        return said.read()


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


def refused(spec):
    with pytest.raises(OutputError) as e:
        open_output(spec)
    assert "\n" not in str(e.value)
    return str(e.value)


def report(
    x=0, y=0, z=0, *, stamp=0.0, rotation=(0, 0, 0), rate=(0, 0, 0), counts_rate=(0.0, 0.0, 0.0), confirmed=True
):
    """One of counts x, y, z, which a ball's rotation (3,) rad and rate (3,) rad/s may go with."""
    turning = np.array([*rate, 0.0, 0.0, 0.0], dtype=float)
    increment = np.array([*rotation, 0.0, 0.0, 0.0], dtype=float)
    estimate = unknown(stamp)._replace(increment=increment, rate=turning, confirmed=confirmed)
    return Report((x, y, z), counts_rate if confirmed else None, stamp, (Sample(estimate),))


def rolling(rate, settings=MotionSettings(), *, status=Status.TRACKING, confirmed=True, seen=Sample):  # noqa: B008
    """One of a ball of 1.2 m diameter that turns at a rate (3,) rad/s in obj; `seen` makes the sample."""
    moving = unknown(0.0, status=status)._replace(rate=np.array([*rate, 0, 0, 0], dtype=float), confirmed=confirmed)
    return report_of((seen(moving),), Counter(settings.matrix(0.6)))


def counts_of(motions, rig, settings=MotionSettings()):  # noqa: B008  frozen
    """Counts of the motions of a run, (n, 3): x, y and third axis."""
    counter = Counter(settings.matrix(rig.radius_m))
    return np.array([counter.counts(m)[0] for m in motions])
