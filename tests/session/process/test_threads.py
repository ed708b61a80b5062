"""The workers of threads: a lane for each kind, and what happens where the system gives no thread."""

import threading
import time
from functools import partial

import pytest
from reporting import until

from spheremouse.errors import ControlError
from spheremouse.session.process.threads import WorkerPool, as_future, begin


@pytest.fixture
def workers():
    said = []
    made = WorkerPool(("one", "two"), said.append)
    made.said = said
    made.begin()
    yield made
    made.end("one", "two")


def test_a_kind_waits_for_its_own_and_for_no_other(workers):
    gate, done = threading.Event(), []
    workers.do("one", gate.wait)
    workers.do("one", lambda: done.append("one"))
    workers.do("two", lambda: done.append("two"))
    until(lambda: done)
    assert done == ["two"]
    assert workers.busy("one")
    gate.set()
    until(lambda: not workers.busy("one"))
    assert done == ["two", "one"]


def test_an_error_is_told_and_the_next_work_is_done(workers):
    with pytest.raises(ZeroDivisionError):
        as_future(lambda: 1 // 0, partial(workers.do, "one")).result(20.0)
    workers.do("one", lambda: 1 // 0)
    assert as_future(lambda: 5, partial(workers.do, "one")).result(20.0) == 5
    until(lambda: not workers.busy("one"))
    assert "ZeroDivisionError" in workers.said[0]


def test_what_was_given_is_done_before_the_end(workers):
    done = []
    workers.do("one", lambda: time.sleep(0.05))
    workers.do("one", lambda: done.append(1))
    workers.end("one")
    assert done == [1]


def test_a_thread_that_is_not_to_be_had_is_a_line(monkeypatch):
    def refuse(*_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading, "_start_new_thread", refuse, raising=False)
    monkeypatch.setattr(threading, "_start_joinable_thread", refuse, raising=False)
    with pytest.raises(ControlError, match=r"refuses a new thread.*raise TasksMax") as e:
        begin(threading.Thread(target=print))
    assert len(str(e.value).splitlines()) == 1
