"""The latest raw frame wins; what it replaces is counted and given back."""

import threading
import time

from raw_picture import RawPicture

from spheremouse.capture.newest import Arrival, LatestFrame

PATIENCE = 20.0  # s


def frame(number):
    return RawPicture(None, None, float(number), number)


def test_the_newest_is_taken_and_what_it_replaced_is_counted_and_released():
    latest, frames = LatestFrame(), [frame(k) for k in range(4)]
    for raw in frames[:3]:
        latest.put(Arrival(raw, raw.stamp))
    taken = latest.take(0.0)
    assert taken is not None
    assert (taken.raw, taken.taken) == (frames[2], 2.0)
    assert [s.released for s in frames] == [1, 1, 0, 0]
    assert latest.skipped == 2
    assert latest.take(0.0) is None
    latest.put(Arrival(frames[3], 3.0))
    latest.clear()  # its camera goes
    latest.clear()
    assert frames[3].released == 1
    assert latest.skipped == 3  # nobody has seen it
    assert latest.take(0.0) is None


def test_each_camera_has_its_latest_frame_and_the_first_taken_comes_first():
    latest, frames = LatestFrame(), [frame(k) for k in range(4)]
    for taken, (camera, raw) in enumerate(zip((1, 0, 0, 1), frames, strict=True)):
        latest.put(Arrival(raw, float(taken), camera))
    assert [s.released for s in frames] == [1, 1, 0, 0]  # replaced by the next of the same camera
    assert latest.skipped == 2
    latest.put(Arrival(frame(4), 1.5, 1))
    assert [latest.take(0.0).camera for _ in range(2)] == [1, 0]
    assert latest.take(0.0) is None
    latest.put(Arrival(frame(5), 5.0, 1))
    latest.clear(0)  # the other camera goes
    assert latest.take(0.0).taken == 5.0


def test_who_waits_is_woken_by_a_frame_and_by_a_call():
    latest = LatestFrame()
    got = []

    def wait():
        got.append(latest.take(PATIENCE))

    for act in (lambda: latest.put(Arrival(frame(1), 1.0)), latest.wake):
        thread = threading.Thread(target=wait)
        thread.start()
        time.sleep(0.01)
        act()
        thread.join(PATIENCE / 2)  # well before the wait would have ended by itself
        assert not thread.is_alive()
    assert got[0].taken == 1.0
    assert got[1] is None


def test_a_call_before_the_wait_is_not_missed_and_takes_no_frame_away():
    latest = LatestFrame()
    latest.wake()
    begun = time.monotonic()
    assert latest.take(PATIENCE) is None
    assert time.monotonic() - begun < PATIENCE / 2
    latest.wake()
    latest.put(Arrival(frame(1), 1.0))
    assert latest.take(0.0) is not None
    assert latest.take(0.0) is None  # the call is spent


def test_of_any_number_from_another_thread_each_is_taken_or_counted():
    latest, n, taken = LatestFrame(), 20000, []
    frames = [frame(k) for k in range(n)]
    thread = threading.Thread(target=lambda: [latest.put(Arrival(s, 0.0)) for s in frames])
    thread.start()
    while thread.is_alive() or (not taken or taken[-1] is not frames[-1]):
        arrival = latest.take(0.01)
        if arrival is not None:
            taken.append(arrival.raw)
    thread.join()
    assert len(taken) + latest.skipped == n
    assert [s.sequence for s in taken] == sorted({s.sequence for s in taken})
    assert all(s.released == (0 if s in set(taken) else 1) for s in frames)
