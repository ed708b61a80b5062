"""Lines that come too often: each kind is said once in a while, and none goes uncounted."""

import re
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from spheremouse.output.rate_limited_logger import RateLimitedLogger

KINDS = ("gone", "back")


class Clock:
    """Turned by hand."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def test_a_transcript():
    said, clock = [], Clock()
    say = RateLimitedLogger(said.append, clock=clock)
    for k in range(40):
        say(f"port {k}: gone")
    say("is back")
    clock.now = 0.5
    say.tend()
    assert said == ["port 0: gone", "is back"]
    clock.now = 1.0
    say.tend()
    assert said[2:] == ["port 39: gone (38 more like it)"]
    say("port 40: gone")
    say.tend(end=True)
    say("port 41: gone")
    clock.now = 5.0
    say("port 42: gone")
    assert said[3:] == ["port 40: gone", "port 42: gone (1 more like it)"]


@given(st.lists(st.tuples(st.sampled_from(KINDS), st.floats(0.0, 0.7), st.booleans()), max_size=60))
def test_of_each_kind_one_a_second_and_all_are_counted(story):
    said, clock = [], Clock()
    say = RateLimitedLogger(lambda text: said.append((clock.now, text)), clock=clock)
    for kind, wait, tends in story:
        clock.now += wait
        say(f"{len(said)} {kind}")
        if tends:
            say.tend()
    clock.now += 1.001  # more than a second after the last, whatever the sums are rounded to
    say.tend()
    for kind in KINDS:
        times = [at for at, text in said if kind in text]
        assert all(b - a >= 1.0 - 1e-9 for a, b in pairwise(times))
        counted = [1 + sum(map(int, re.findall(r"\((\d+) more", text))) for _, text in said if kind in text]
        assert sum(counted) == sum(k == kind for k, _, _ in story)
