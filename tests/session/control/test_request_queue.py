"""The queue of requests: one of a kind under way, few that wait, none whose client has disconnected."""

from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremouse.errors import ControlError
from spheremouse.session.control.protocol import Record, Request, Set, Snapshot
from spheremouse.session.control.request_queue import MAX_WAITING, PendingRequest, RequestQueue

RELOAD, REINIT, PAUSE = (Request(command=c) for c in ("reload", "reinit", "pause"))
SET = Set(command="set", assignments=("motion.scale_x=2",))
RECORD, STOP = Record(command="record"), Record(command="record", stop=True)
SNAPSHOT = Snapshot(command="snapshot")
REQUESTS = (RELOAD, REINIT, PAUSE, SET, RECORD, STOP, SNAPSHOT)


@pytest.fixture
def queue():
    return RequestQueue(lambda: None, lambda line: None)


def put(queue, request, *, quiet=False):
    replies = []
    pending = PendingRequest(request, replies.append, quiet=quiet)
    queue.put(pending)
    return pending, replies


@pytest.mark.parametrize("request_", [REINIT, RECORD, STOP, SNAPSHOT])
def test_a_second_request_of_a_kind_is_refused_before_its_work_begins(queue, request_):
    first, _ = put(queue, request_)
    _, while_it_waits = put(queue, request_)
    assert queue.take() is first
    _, while_it_is_under_way = put(queue, request_)
    errors = [reply["error"].partition(";")[2] for reply in while_it_waits + while_it_is_under_way]
    assert errors == 2 * [" ask again when it is done"]
    assert queue.take() is None
    first.answer({"message": "done"})
    second, _ = put(queue, request_)
    assert queue.take() is second
    first.answer({"message": "again"})
    _, while_the_second_is_under_way = put(queue, request_)
    assert while_the_second_is_under_way


def test_set_and_reload_wait_for_each_other_and_other_kinds_do_not(queue):
    pending = [put(queue, request)[0] for request in (RELOAD, SET, SNAPSHOT, RELOAD)]
    assert [queue.take(), queue.take(), queue.take()] == [pending[0], pending[2], None]
    pending[0].answer({})
    assert queue.take() is pending[1]
    pending[1].answer({})
    assert queue.take() is pending[3]


def test_a_quiet_request_does_not_wait_for_another_of_its_kind(queue):
    first, _ = put(queue, SET)
    _, while_it_waits = put(queue, RELOAD, quiet=True)
    assert queue.take() is first
    _, while_it_is_under_way = put(queue, RELOAD, quiet=True)
    assert [reply["error"] for reply in while_it_waits + while_it_is_under_way] == 2 * [
        "one is under way; ask again when it is done"
    ]
    first.answer({})
    second, refused = put(queue, RELOAD, quiet=True)
    assert (queue.take(), refused) == (second, [])


def test_few_requests_wait_and_those_of_clients_that_disconnect_leave_room(queue):
    crowd = [put(queue, SET) for _ in range(MAX_WAITING + 1)]
    assert [len(replies) for _, replies in crowd] == MAX_WAITING * [0] + [1]
    for pending, _ in crowd:
        pending.cancelled = True
    mine, _ = put(queue, SET)
    assert queue.take() is mine


def test_a_call_runs_once_and_its_error_is_logged():
    log, calls = [], []
    queue = RequestQueue(lambda: None, log.append)
    for error in (None, ControlError("no"), ZeroDivisionError("as if")):
        queue.call(partial(_fail, error, calls))
    queue.run(lambda pending: None)
    queue.run(lambda pending: None)
    assert calls == [None, None, None]
    assert log[0] == "no"
    assert log[1].startswith("internal error, please report it:\nTraceback")


def _fail(error, calls):
    calls.append(None)
    if error is not None:
        raise error


steps = st.lists(
    st.one_of(
        st.tuples(st.just("put"), st.sampled_from(REQUESTS)),
        st.tuples(st.just("disconnect"), st.integers(0, 20)),
        st.tuples(st.just("take")),
        st.tuples(st.just("end"), st.integers(0, 5)),
    ),
    max_size=60,
)


@given(steps)
def test_each_request_is_answered_once_unless_its_client_disconnects(steps):
    queue = RequestQueue(lambda: None, lambda line: None)
    requests, under_way = [], []
    for what, *more in steps:
        match what:
            case "put":
                requests.append(put(queue, more[0]))
            case "disconnect" if more[0] < len(requests):
                requests[more[0]][0].cancelled = True
            case "take" if (taken := queue.take()) is not None:
                assert taken.kind not in {p.kind for p in under_way}
                assert not taken.cancelled
                under_way.append(taken)
            case "end" if more[0] < len(under_way):
                under_way.pop(more[0]).answer({"ok": True})
    for pending in under_way:
        pending.answer({"ok": True})
    while not all(replies or pending.cancelled for pending, replies in requests):
        if (taken := queue.take()) is not None:
            taken.answer({"ok": True})
    for pending, replies in requests:
        assert len(replies) == 1 or (pending.cancelled and not replies)
