"""The desk: of each kind one request under way, the owner's first, little that waits, nothing for who has hung up."""

import contextlib
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spheremouse.errors import ControlError
from spheremouse.session.control.protocol import Record, Request, Set, Snapshot
from spheremouse.session.control.reply import Reply
from spheremouse.session.control.request_queue import CALM, MOST, SHARE, Asked, RequestQueue

RELOAD, REINIT, PAUSE = (Request(command=c) for c in ("reload", "reinit", "pause"))
SET = Set(command="set", assignments=("motion.scale_x=2",))
RECORD, STOP = Record(command="record"), Record(command="record", stop=True)
SNAPSHOT = Snapshot(command="snapshot")
REQUESTS = (RELOAD, REINIT, PAUSE, SET, RECORD, STOP, SNAPSHOT)


class Client:
    """Asks; what it is answered."""

    def __init__(self, desk, trusted=True):
        self.desk, self.trusted, self.answers, self.replies = desk, trusted, [], []

    def ask(self, request):
        self.replies.append(Reply(self.answers.append, trusted=self.trusted))
        asked = Asked(request, self.replies[-1])
        self.desk.put(asked)
        return asked

    def hang_up(self):
        for reply in self.replies:
            reply.gone = True


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def desk(clock):
    return RequestQueue(lambda: None, clock)


@pytest.mark.parametrize("request_", [REINIT, RECORD, STOP, SNAPSHOT])
def test_a_second_of_a_kind_is_refused_before_anything_is_made_for_it(desk, request_):
    one, other = Client(desk), Client(desk)
    first = one.ask(request_)
    other.ask(request_)  # one waits
    assert desk.take() is first
    other.ask(request_)  # one is under way
    assert [a["error"].partition(";")[2] for a in other.answers] == 2 * [" ask again when it is done"]
    assert desk.take() is None
    first({"message": "done"})
    second = other.ask(request_)
    assert desk.take() is second


def test_set_and_reload_wait_for_each_other_and_reloads_are_served_together(desk):
    clients = [Client(desk) for _ in range(5)]
    first = clients[0].ask(RELOAD)
    assert desk.take() is first
    waiting = [c.ask(r) for c, r in zip(clients[1:], (RELOAD, SET, RELOAD, RELOAD), strict=True)]
    assert desk.take() is None
    first({"message": "one"})
    assert desk.take() is waiting[0]
    waiting[0]({"message": "together"})
    together = [{"message": "together"}]
    assert [c.answers for c in clients] == [[{"message": "one"}], together, [], together, together]
    assert desk.take() is waiting[1]


def test_the_owner_is_served_first_and_waits_for_a_members_only(desk):
    owner, member = Client(desk), Client(desk, trusted=False)
    waits = [Client(desk, trusted=False).ask(SET) for _ in range(3)]
    mine = owner.ask(SET)
    assert desk.take() is mine
    mine({})
    assert desk.take() is waits[0]
    theirs = member.ask(SNAPSHOT)
    assert desk.take() is theirs
    snapshot = owner.ask(SNAPSHOT)
    assert not owner.answers[1:]
    Client(desk).ask(SNAPSHOT)
    assert desk.take() is None
    theirs({})
    assert desk.take() is snapshot


def test_what_waits_is_little_and_members_leave_room_for_the_owner(desk):
    crowd = [Client(desk, trusted=False) for _ in range(3 * MOST)]
    for client in crowd:
        client.ask(SET)
    assert sum(bool(c.answers) for c in crowd) == 2 * MOST
    assert crowd[-1].answers[0]["error"] == "too much is asked at once; ask again"
    mine = Client(desk).ask(SET)
    assert desk.take() is mine


def test_what_was_not_begun_is_dropped_with_who_asked_it(desk):
    client, other = Client(desk), Client(desk)
    for _ in range(100):
        client.ask(SET)
        client.hang_up()
    mine = other.ask(SET)
    assert len(desk._waiting) <= 2
    assert desk.take() is mine


def test_reloads_served_together_are_wanted_as_long_as_one_waits(desk):
    clients = [Client(desk), Client(desk)]
    for client in clients:
        client.ask(RELOAD)
    together = desk.take()
    clients[0].hang_up()
    assert not together.gone
    clients[1].hang_up()
    assert together.gone


def test_members_have_their_share_of_the_time_and_the_owner_all_of_it(desk, clock):
    """What a kind of work has cost it rests for, so that reading files all day does not make the pointer stutter."""
    member, owner = Client(desk, trusted=False), Client(desk)
    worked, end = 0.0, 100.0
    while clock.now < end:
        asked = member.ask(SET)
        taken = desk.take()
        if taken is not None:
            clock.now += 0.5
            worked += 0.5
            taken({})
        clock.now += 0.1
        if taken is not asked:
            member.hang_up()
    assert worked / end == pytest.approx(SHARE, abs=0.01)
    assert desk.take() is None
    mine = owner.ask(SET)
    assert desk.take() is mine


def test_what_the_owner_gives_up_rests_as_well_but_not_for_long(desk, clock):
    owner, worked, end = Client(desk), 0.0, 100.0
    while clock.now < end:
        owner.ask(SNAPSHOT)
        if (taken := desk.take()) is not None:
            clock.now += 0.1
            worked += 0.1
            owner.hang_up()
            taken({})
        clock.now += 0.01
        owner.hang_up()
    assert worked / end == pytest.approx(SHARE, abs=0.01)
    Client(desk).ask(REINIT)
    taken = desk.take()
    clock.now += 50.0
    for reply in taken._replies:
        reply.gone = True
    taken({})
    again = Client(desk).ask(REINIT)
    assert desk.take() is None
    clock.now += CALM
    assert desk.take() is again


steps = st.lists(
    st.one_of(
        st.tuples(st.just("ask"), st.integers(0, 5), st.sampled_from(REQUESTS)),
        st.tuples(st.just("hang up"), st.integers(0, 5)),
        st.tuples(st.just("take")),
        st.tuples(st.just("end"), st.integers(0, 5)),
    ),
    max_size=60,
)


def test_whatever_goes_wrong_on_the_way_to_an_answer_is_one(desk):
    """An error of ours besides goes on to who says so."""
    client = Client(desk)
    for error in (ControlError("no"), OSError("no disk"), ZeroDivisionError("as\nif")):
        client.ask(RELOAD)
        ours = isinstance(error, ZeroDivisionError)
        with pytest.raises(ZeroDivisionError) if ours else contextlib.nullcontext():
            desk.take().attempt(partial(_fail, error))
    said = [answer["error"] for answer in client.answers]
    assert said == ["no", "no disk", "internal error (ZeroDivisionError: as if); please report it"]


def _fail(error):
    raise error


@given(steps)
def test_whatever_is_asked_each_is_answered_once_and_nothing_is_left(steps):
    desk = RequestQueue(lambda: None, Clock())
    clients = [Client(desk, trusted=n % 2 == 0) for n in range(6)]
    under_way = []
    for what, *more in steps:
        match what:
            case "ask":
                clients[more[0]].ask(more[1])
            case "hang up":
                clients[more[0]].hang_up()
            case "take" if (taken := desk.take()) is not None:
                assert taken.kind not in {a.kind for a in under_way}
                assert not taken.gone
                under_way.append(taken)
            case "end" if more[0] < len(under_way):
                under_way.pop(more[0])({"ok": True})
        assert len(desk._waiting) <= 2 * MOST
    for asked in under_way:
        asked({"ok": True})
    while (taken := desk.take()) is not None:
        taken({"ok": True})
    assert not desk._waiting
    assert not desk._under_way
    for client in clients:
        assert len(client.answers) <= len(client.replies)
        if not any(reply.gone for reply in client.replies):
            assert len(client.answers) == len(client.replies)
