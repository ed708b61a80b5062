"""Lines that come too often: each kind is lines once in a while, and none goes uncounted."""

import re
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from spheremouse.output.rate_limited_logger import RateLimitedLogger

KINDS = ("gone", "back")


def test_a_transcript():
    lines, now = [], [0.0]
    log = RateLimitedLogger(lines.append, clock=lambda: now[0])
    for k in range(40):
        log(f"port {k}: gone")
    log("is back")
    now[0] = 0.5
    log.flush()
    assert lines == ["port 0: gone", "is back"]
    now[0] = 1.0
    log.flush()
    assert lines[2:] == ["port 39: gone (38 more like it)"]
    log("port 40: gone")
    log.flush(end=True)
    log("port 41: gone")
    now[0] = 5.0
    log("port 42: gone")
    assert lines[3:] == ["port 40: gone", "port 42: gone (1 more like it)"]


@given(st.lists(st.tuples(st.sampled_from(KINDS), st.floats(0.0, 0.7), st.booleans()), max_size=60))
def test_of_each_kind_one_a_second_and_all_are_counted(story):
    lines, now = [], [0.0]
    log = RateLimitedLogger(lambda text: lines.append((now[0], text)), clock=lambda: now[0])
    for kind, wait, tends in story:
        now[0] += wait
        log(f"{len(lines)} {kind}")
        if tends:
            log.flush()
    now[0] += 1.001  # more than a second after the last, whatever the sums are rounded to
    log.flush()
    for kind in KINDS:
        times = [at for at, text in lines if kind in text]
        assert all(b - a >= 1.0 - 1e-9 for a, b in pairwise(times))
        counted = [1 + sum(map(int, re.findall(r"\((\d+) more", text))) for _, text in lines if kind in text]
        assert sum(counted) == sum(k == kind for k, _, _ in story)
