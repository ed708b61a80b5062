"""The outputs of a run: the next are opened after those before are closed; where a thread is missing, never."""

import threading
import time

import numpy as np
import pytest
from reporting import PATIENCE, report, until

from spheremouse.errors import ControlError
from spheremouse.output import OutputClosed
from spheremouse.output.null import Null
from spheremouse.output.pointer import PointerSettings
from spheremouse.session import outputs as module
from spheremouse.session.outputs import OUTPUT, Outputs
from spheremouse.session.process.threads import WorkerPool

EXACT = PointerSettings(horizon=0.0)


class Sink(Null):
    """An output that writes down what is done with it, into a diary that several share."""

    def __init__(self, name, diary):
        self.name, self.diary, self.counts = name, diary, np.zeros(3, int)
        self.ends, self.gate, self.may_close = False, None, None

    def open(self):
        self.diary.append(f"{self.name} opened")
        return self

    paced = True

    def send(self, given):
        if self.ends:
            raise OutputClosed(self.name)
        if self.gate is not None:
            self.gate.wait(PATIENCE)
        self.counts += given.counts

    def __exit__(self, *error):
        if self.may_close is not None:
            self.may_close.wait(PATIENCE)
        time.sleep(0.02)  # as devices take
        self.diary.append(f"{self.name} closed")


class Run:
    def __init__(self, monkeypatch, *names):
        self.diary, self.said, self.todo = [], [], []
        self.workers = WorkerPool((OUTPUT,), self.said.append)
        self.workers.begin()
        self.by_name = {}
        monkeypatch.setattr(module, "open_output", lambda name: self.by_name[name].open())
        self.sinks = self.made(names)
        self.outputs = Outputs(names, EXACT, log=self.said.append, workers=self.workers, call=self.todo.append)
        self.outputs.begin()
        self.frames, self.sum = 0, np.zeros(3, int)

    def made(self, names):
        sinks = [Sink(name, self.diary) for name in names if name not in self.by_name]
        self.by_name |= {sink.name: sink for sink in sinks}
        return sinks

    def next(self, *names):
        sinks = self.made(names)
        self.outputs.exchange(names, EXACT)
        return sinks

    def give(self, *counts, wanted=True):
        self.frames += 1
        self.sum += counts
        given = report(*counts, stamp=float(self.frames), confirmed=True)
        self.outputs.submit(given, time.monotonic(), wanted=wanted)

    def close(self):
        self.outputs.close()
        self.workers.end()


@pytest.fixture
def run(monkeypatch):
    begun = []

    def begin(*names):
        begun.append(Run(monkeypatch, *names))
        until(lambda: len(begun[-1].diary) == len(names))
        return begun[-1]

    yield begin
    for made in begun:
        made.close()


def test_the_next_are_opened_when_those_before_are_closed(run):
    """For they may be the same devices, and the same files."""
    made = run("a", "b")
    made.next("c", "d")
    until(lambda: len(made.diary) == 6)
    assert sorted(made.diary[2:4]) == ["a closed", "b closed"]
    assert sorted(made.diary[4:]) == ["c opened", "d opened"]


def test_what_was_given_is_what_arrived_and_what_is_told_as_unsent(run):
    """Over all outputs of a run, whenever they are exchanged."""
    made, sinks = run("0"), []
    sinks += made.sinks
    for k in range(1, 6):
        for _ in range(40):
            made.give(3, -2, k)
        sinks += made.next(str(k))
    until(lambda: len(made.todo) == 5)
    for action in made.todo:
        action()
    until(lambda: len(made.diary) == 11)
    made.give(1, 1, 1)
    until(lambda: not any(made.outputs.main.thread.queued))
    status = made.outputs.status()[0][1]
    until(lambda: np.array_equal(sum(s.counts for s in sinks) + made.outputs.status()[0][1].unsent, made.sum))
    assert status.failed is None


def run_of(*specs, log=lambda line: None, **options):
    outputs = Outputs(specs, EXACT, log=log, workers=WorkerPool((OUTPUT,), log), call=[].append, **options)
    outputs.begin()
    return outputs


def test_where_a_thread_is_missing_those_before_stay_and_no_other_is_opened(run, monkeypatch):
    made, begun = run("a", "b"), []

    def begin(thread):
        if begun:
            raise ControlError("refuses a new thread")
        begun.append(thread)
        thread.start()

    monkeypatch.setattr(module, "begin", begin)
    with pytest.raises(ControlError):
        made.next("c", "d")
    begun[0].join(PATIENCE)
    assert made.diary == ["a opened", "b opened"]
    made.give(5, 6, 7)
    until(lambda: all(np.array_equal(s.counts, (5, 6, 7)) for s in made.sinks))
    assert made.said == []


def test_paused_nothing_is_sent_by_those_to_come_either(run):
    made = run("a")
    made.outputs.set_paused(True)
    (after,) = made.next("b")
    until(lambda: len(made.diary) == 3)
    made.give(5, 0, 0)
    until(lambda: made.outputs.status()[0][1].unsent == (5, 0, 0))
    made.outputs.set_paused(False)
    made.give(1, 0, 0)
    until(lambda: np.array_equal(after.counts, (1, 0, 0)))


def test_an_output_that_stays_in_the_list_is_not_opened_again(run):
    """A file is not cut in two because a socket is added."""
    made = run("a", "b")
    (added,) = made.next("c", "a")
    until(lambda: len(made.diary) == 4)
    assert made.diary[2:] == ["b closed", "c opened"]
    made.give(1, 2, 3)
    until(lambda: np.array_equal(added.counts, (1, 2, 3)) and np.array_equal(made.sinks[0].counts, (1, 2, 3)))


def test_an_output_that_stays_takes_the_settings_that_come_with_another(run):
    """Without a horizon it sends the counts of a frame; now it predicts."""
    made = run("a")
    made.made("b")
    made.outputs.exchange(("a", "b"), PointerSettings(horizon=0.25))
    now = time.monotonic()
    for taken in (now - 0.03, now):
        made.outputs.submit(report(30, stamp=taken, counts_rate=(1000.0, 0.0, 0.0)), taken, wanted=True)
    until(lambda: made.sinks[0].counts[0] > 60)


def test_a_main_output_that_is_exchanged_while_others_are_still_closed_is_counted_once(run):
    made = run("a", "b")
    made.sinks[1].may_close = threading.Event()
    made.next("a", "c")
    made.give(1, 2, 3)
    until(lambda: np.array_equal(made.sinks[0].counts, (1, 2, 3)))
    made.next("d", "c")
    made.sinks[1].may_close.set()
    until(lambda: "d opened" in made.diary and "c opened" in made.diary)
    made.workers.end(OUTPUT)
    for action in made.todo:
        action()
    (_, status), *_ = made.outputs.status()
    assert (status.reports, status.unsent) == (1, (0, 0, 0))


@pytest.mark.parametrize("later", [["b", "c"], ["ba", "c"], ["ba", "ab", "ba", "c"]])
def test_an_output_enters_the_sums_of_the_run_while_it_is_the_main_one(run, later):
    """Also if it was another one before, or is another one afterwards."""
    made = run(*"ab")
    for exchanged, names in enumerate(["ab", *later]):
        if exchanged:
            made.next(*names)
        sinks = [made.by_name[name] for name in names]
        due = [sink.counts[0] + (7 if k else 5) for k, sink in enumerate(sinks)]
        made.give(2, 0, 0, wanted=False)
        made.give(5, 0, 0)
        until(lambda sinks=sinks, due=due: [sink.counts[0] for sink in sinks] == due)
    made.workers.end(OUTPUT)
    for action in made.todo:
        action()
    frames = 1 + len(later)
    (_, status), *_ = made.outputs.status()
    assert (status.reports, status.unsent, made.outputs.unsent) == (frames, (2 * frames, 0, 0), (2 * frames, 0, 0))


def test_the_run_goes_on_until_all_outputs_have_ended(run):
    made = run("a", "b")
    made.sinks[0].ends = True
    made.give(1, 0, 0)
    until(lambda: made.outputs.status()[0][1].failed == "the reader of the output is gone")
    assert not made.outputs.ended
    assert made.outputs.failed == ""
    made.sinks[1].ends = True
    made.give(1, 0, 0)
    until(lambda: made.outputs.ended)


def test_what_the_main_output_must_not_send_reaches_the_others(run):
    made = run("a", "b")
    made.give(1, 2, 3, wanted=False)
    made.give(1, 0, 0)
    until(lambda: [s.counts.tolist() for s in made.sinks] == [[1, 0, 0], [2, 2, 3]])
    assert made.outputs.unsent == (1, 2, 3)


def test_an_output_that_hangs_delays_no_other(run):
    made = run("a", "b")
    made.sinks[0].gate = threading.Event()
    for _ in range(20):
        made.give(1, 0, 0)
    until(lambda: np.array_equal(made.sinks[1].counts, (20, 0, 0)))
    assert not np.any(made.sinks[0].counts)
    made.sinks[0].gate.set()


def test_the_log_names_an_output_once():
    logged = []
    outputs = run_of("tcp:x", "null", log=logged.append)
    until(lambda: logged)
    outputs.close()
    advice = "write for example tcp:127.0.0.1:9000; trying again until it works"
    assert logged == [f"output tcp:x: is not HOST:PORT; {advice}"]


def test_only_paced_outputs_request_real_time_scheduling(tmp_path):
    claimed = []
    specs = f"text:{tmp_path / 'a'}", f"text:{tmp_path / 'b'},format=reports", "null"
    outputs = run_of(*specs, claim=lambda: claimed.append(threading.get_native_id()))
    outputs.submit(report(1, 0, 0), time.monotonic(), wanted=True)
    until(lambda: all(status.reports for _, status in outputs.status()))
    outputs.close()
    assert len(claimed) == 1
    assert claimed[0] != threading.get_native_id()


def test_each_output_has_its_own_gain(tmp_path):
    specs = [f"text:{tmp_path / 'double'},format=counts,gain=2", f"text:{tmp_path / 'one'},format=counts"]
    outputs = run_of(*specs)
    for k in range(20):
        outputs.submit(report(3, -1, k, stamp=float(k)), time.monotonic(), wanted=True)
    until(lambda: [sum(status.sent) for _, status in outputs.status()] == [460, 230])
    outputs.close()
    double, one = (np.loadtxt(tmp_path / name).sum(axis=0)[1:] for name in ("double", "one"))
    assert one.tolist() == [60.0, -20.0, 190.0]
    assert double.tolist() == [120.0, -40.0, 380.0] == list(outputs.counts)
