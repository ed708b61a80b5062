"""The newest shot wins; what it replaces is counted and given back."""

import threading
import time

from spheremouse.capture.newest import Arrival, Newest

PATIENCE = 20.0  # s


class Shot:
    """One that knows whether it was given back."""

    def __init__(self, number):
        self.stamp, self.sequence, self.released = float(number), number, 0

    def frame(self, colour):
        raise NotImplementedError

    def release(self):
        self.released += 1


def test_the_newest_is_taken_and_what_it_replaced_is_counted_and_released():
    ring, shots = Newest(), [Shot(k) for k in range(4)]
    for shot in shots[:3]:
        ring.put(Arrival(shot, shot.stamp))
    taken = ring.take(0.0)
    assert taken is not None
    assert (taken.shot, taken.taken) == (shots[2], 2.0)
    assert [s.released for s in shots] == [1, 1, 0, 0]
    assert ring.skipped == 2
    assert ring.take(0.0) is None
    ring.put(Arrival(shots[3], 3.0))
    ring.clear()  # its camera goes
    ring.clear()
    assert shots[3].released == 1
    assert ring.skipped == 3  # nobody has seen it
    assert ring.take(0.0) is None


def test_who_waits_is_woken_by_a_shot_and_by_a_call():
    ring = Newest()
    got = []

    def wait():
        got.append(ring.take(PATIENCE))

    for act in (lambda: ring.put(Arrival(Shot(1), 1.0)), ring.wake):
        thread = threading.Thread(target=wait)
        thread.start()
        time.sleep(0.01)
        act()
        thread.join(PATIENCE / 2)  # well before the wait would have ended by itself
        assert not thread.is_alive()
    assert got[0].taken == 1.0
    assert got[1] is None


def test_a_call_before_the_wait_is_not_missed_and_takes_no_shot_away():
    ring = Newest()
    ring.wake()
    begun = time.monotonic()
    assert ring.take(PATIENCE) is None
    assert time.monotonic() - begun < PATIENCE / 2
    ring.wake()
    ring.put(Arrival(Shot(1), 1.0))
    assert ring.take(0.0) is not None
    assert ring.take(0.0) is None  # the call is spent


def test_of_any_number_from_another_thread_each_is_taken_or_counted():
    ring, n, taken = Newest(), 20000, []
    shots = [Shot(k) for k in range(n)]
    thread = threading.Thread(target=lambda: [ring.put(Arrival(s, 0.0)) for s in shots])
    thread.start()
    while thread.is_alive() or (not taken or taken[-1] is not shots[-1]):
        arrival = ring.take(0.01)
        if arrival is not None:
            taken.append(arrival.shot)
    thread.join()
    assert len(taken) + ring.skipped == n
    assert [s.sequence for s in taken] == sorted({s.sequence for s in taken})
    assert all(s.released == (0 if s in set(taken) else 1) for s in shots)
