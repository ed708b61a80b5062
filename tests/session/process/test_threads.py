"""The crew of threads: a lane for each kind, and what happens where the system gives no thread."""

import threading
import time

import pytest

from spheremouse.errors import ControlError
from spheremouse.session.process.threads import WorkerPool, begin


@pytest.fixture
def crew():
    said = []
    made = WorkerPool(("one", "two"), said.append)
    made.said = said
    made.begin()
    yield made
    made.end("one", "two")


def wait_for(condition):
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_a_kind_waits_for_its_own_and_for_no_other(crew):
    gate, done = threading.Event(), []
    crew.do("one", gate.wait)
    crew.do("one", lambda: done.append("one"))
    crew.do("two", lambda: done.append("two"))
    wait_for(lambda: done)
    assert done == ["two"]
    assert crew.busy("one")
    gate.set()
    wait_for(lambda: not crew.busy("one"))
    assert done == ["two", "one"]


def test_an_error_is_told_and_the_next_work_is_done(crew):
    task = crew.make("one", lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        task.wait(20.0)
    crew.do("one", lambda: 1 // 0)
    assert crew.make("one", lambda: None).wait(20.0)
    wait_for(lambda: not crew.busy("one"))
    assert "ZeroDivisionError" in crew.said[0]


def test_what_was_given_is_done_before_the_end(crew):
    done = []
    crew.do("one", lambda: time.sleep(0.05))
    crew.do("one", lambda: done.append(1))
    crew.end("one")
    assert done == [1]


def test_a_thread_that_is_not_to_be_had_is_a_line(monkeypatch):
    def refuse(*_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading, "_start_new_thread", refuse, raising=False)
    monkeypatch.setattr(threading, "_start_joinable_thread", refuse, raising=False)
    with pytest.raises(ControlError, match=r"no thread to be had: .*raise TasksMax") as e:
        begin(threading.Thread(target=print))
    assert len(str(e.value).splitlines()) == 1
