"""The section of a recording that is evaluated."""

import math

import numpy as np
import pytest

from spheremouse.session.evaluate import section
from spheremouse.tracker import Frame


@pytest.mark.parametrize(
    ("begin", "end", "expected"),
    [
        (0.0, math.inf, range(10)),
        (0.5, math.inf, range(4, 10)),
        (0.0, 0.3, range(3)),
        (0.375, 0.625, (3, 4)),
        (2.0, 3.0, ()),
    ],
)
def test_a_section_has_the_frames_from_its_begin_to_before_its_end_after_the_first_stamp(begin, end, expected):
    frames = (Frame(np.zeros((1, 1), np.uint8), 8.0 + k / 8, k) for k in range(10))
    assert [frame.sequence for frame in section(frames, begin, end)] == [*expected]
