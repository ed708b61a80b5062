"""The closing line of a run: what was sent, what was not, and which frames were left out."""

from spheremouse.session.screen import Tally


def test_the_closing_line_has_what_was_sent_and_which_frames_were_left_out():
    tally = Tally()
    for _ in range(3):
        tally.add((10, -4, 1), 0.001)
    assert str(tally).startswith("3 frames; counts x +30, y -12, third +3; ")
    assert "not sent" not in str(tally)
    assert "left out" not in str(tally)
    tally.unsent = lambda: (5, 0, -1)
    tally.left_out = {"skipped": 2, "dropped": 0, "damaged": 1}
    assert tally.counts == (25, -12, 4)
    assert str(tally).startswith("3 frames; counts x +25, y -12, third +4; ")
    assert str(tally).endswith("; not sent: x +5, y +0, third -1; frames left out: 2 skipped, 1 damaged")


def test_a_run_without_a_tracked_frame_says_what_became_of_all():
    tally = Tally()
    assert str(tally) == "no frame tracked"
    tally.left_out = {"before anything could be tracked": 60}
    assert str(tally) == "no frame tracked; frames left out: 60 before anything could be tracked"
