"""The fuzzer's guard finds examples that hang, crash or fill the memory, and prints the batch that repeats them."""

import os
import signal
import threading

import pytest
from hypothesis import strategies as st

from tests.fuzz import guard
from tests.fuzz.guard import Limit, tried
from tests.fuzz.targets import EVERY, STRATEGIES, TARGETS


def loops():
    while True:
        pass


WRONG = {
    "raises": (lambda: 1 / 0, "ZeroDivisionError"),
    "loops": (loops, "takes longer than"),
    "loops in C": (lambda: sum(range(10**13)), "an example takes longer than"),
    "waits": (lambda: threading.Event().wait(), "an example takes longer than"),
    "fills": (lambda: len(b"x" * (300 << 20)), "MB"),
    "dies": (lambda: os.kill(os.getpid(), signal.SIGSEGV), "the process ended (-11)"),
}


@pytest.fixture
def small(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(guard, "MAX_CORE_SECONDS", 1.0)
    monkeypatch.setattr(guard, "MAX_SECONDS", 5.0)
    monkeypatch.setattr(guard, "MIN_EXAMPLES", 0)

    def add(check, every=list):
        for table, value in ((TARGETS, lambda _: None), (STRATEGIES, lambda: st.integers(0, 9)), (EVERY, every)):
            monkeypatch.setitem(table, "toy", value)
        usual = tried("toy", 0, Limit(60.0, 4)).memory  # of a process that has done nothing
        monkeypatch.setattr(guard, "MAX_MEMORY", usual + (200 << 20))
        monkeypatch.setitem(TARGETS, "toy", check)

    return add


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRONG)
def test_a_failure_is_reported_with_its_batch(small, kind):
    action, says = WRONG[kind]
    small(lambda n: action() if n > 3 else None)
    result = tried("toy", 0, Limit(60.0, 1000))
    assert result.found is not None
    assert says in result.found
    assert "batch 0" in result.found


def test_examples_are_counted_and_listed_ones_come_first(small, tmp_path):
    seen = tmp_path / "seen"
    small(lambda n: seen.open("a").write(f"{n}\n"), every=lambda: [70, 71, 72])
    result = tried("toy", 0, Limit(60.0, 8))
    assert (result.count, result.found) == (8, None)
    assert seen.read_text().split()[:3] == ["70", "71", "72"]
    assert result.memory > 0


def test_a_seed_and_a_batch_make_the_same_examples(small, tmp_path):
    seen = tmp_path / "seen"
    small(lambda n: seen.open("a").write(f"{n}\n"))
    made = []
    for batch in (3, 3, 4):
        seen.write_text("")
        tried("toy", 5, Limit(60.0, 30, batch))
        made.append(seen.read_text())
    assert made[0] == made[1] != made[2]
