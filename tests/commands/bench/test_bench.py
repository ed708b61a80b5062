"""`spheremouse bench`: which frames count, and how the figures are related. Times themselves are not tested."""

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from spheremouse.commands.bench import WARM_UP
from spheremouse.commands.bench.measure import (
    BLOBS,
    DETECT,
    FILTER,
    SIMPLE,
    STEP,
    Film,
    Steps,
    Times,
    back_and_forth,
    compare,
    in_a_row,
)
from spheremouse.commands.bench.report import notes, report
from spheremouse.errors import DatasetError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames

CLIP = Path(__file__).parents[2] / "data" / "far26_clip"


def clip(frames):
    """The clip's first frames with the camera's pose known, so that few are enough."""
    recording = open_dataset(CLIP)
    rig = replace(recording.rig, pose=recording.pose)
    return Film("clip", rig, 0.25, lambda: islice(read_frames(recording), frames), frames)


def test_every_frame_after_the_warm_up_counts_in_every_round():
    done = []
    times = compare(clip(WARM_UP + 3), 2, lambda what, k, n: done.append((k, n)))
    assert done == [(WARM_UP + 3, 2 * (WARM_UP + 3)), (2 * (WARM_UP + 3), 2 * (WARM_UP + 3))]
    assert len(times) == times.tracked == 6
    assert {len(s) for s in times.seconds.values()} == {6}
    np.testing.assert_allclose(times.seconds[STEP], times.seconds[DETECT] + times.seconds[FILTER], rtol=1e-9)


@pytest.mark.parametrize("measure", [compare, lambda film: in_a_row(film, 20)])
def test_a_film_as_short_as_the_warm_up_is_rejected(measure):
    with pytest.raises(DatasetError, match="10 frames to track, but the first 10 do not count"):
        measure(clip(WARM_UP))


def test_back_and_forth_every_frame_is_next_to_the_one_before():
    assert [back_and_forth(k, 3) for k in range(9)] == [0, 1, 2, 1, 0, 1, 2, 1, 0]
    assert [back_and_forth(k, 1) for k in range(3)] == [0, 0, 0]


def test_steps_in_a_row_go_on_beyond_the_film_and_keep_the_ball():
    steps = in_a_row(clip(WARM_UP + 6), 60)  # nearly four times through
    assert len(steps) == len(steps.processor) == steps.tracked == 60 - WARM_UP
    assert steps.lost == 0
    assert steps.grown_mb is None  # too early to say
    assert np.all(steps.seconds > 0.0)


def test_a_ball_that_is_lost_is_counted():
    """The picture goes dark for two seconds, in steps of a quarter, once in the film: back and forth, four times."""
    film = clip(25)
    dark = range(14, 22)

    def frames():
        for k, frame in enumerate(film.frames()):
            yield replace(frame, image=np.zeros_like(frame.image)) if k in dark else frame

    steps = in_a_row(replace(film, frames=frames), 2 * 48)
    assert steps.lost == 4
    assert steps.tracked < 96 - WARM_UP


def made(n, median, p99=None, worst=None):
    """Return steps with a median, 2 % of them with `p99` and one with `worst`."""
    seconds = np.full(n, median)
    if p99 is not None:
        seconds[: n // 50] = p99
    if worst is not None:
        seconds[0] = worst
    return Steps(seconds, seconds, n, 0, "")


def figures_of(step, blobs, simple, row=None, tracked=300):
    seconds = {STEP: step, DETECT: step / 2, FILTER: step / 2, BLOBS: blobs, SIMPLE: simple}
    times = Times({name: np.full(300, s) for name, s in seconds.items()}, tracked)
    return report(clip(0), times, row=row)


def test_ratios_are_those_of_medians():
    row = made(10_000, 1e-3, 2.4e-3, 7.9e-3)
    figures = figures_of(1e-3, 10.1e-3, 11.9e-3, row)
    assert figures["ratios"] == pytest.approx({BLOBS: 10.1, SIMPLE: 11.9, "p99": 2.4, "max": 7.9})
    assert figures["us"][SIMPLE] == pytest.approx({"median": 11.9e3, "p99": 11.9e3, "max": 11.9e3})


def test_a_ball_that_is_mostly_lost_gives_a_warning():
    tracked, lost = (figures_of(1, 2, 3, tracked=n) for n in (290, 200))
    warning = "tracked in less than 95 %"
    assert [any(warning in line for line in notes(f)) for f in (tracked, lost)] == [False, True]


def test_the_command_prints_a_table_and_writes_its_figures(spheremouse, tmp_path):
    path, threads = tmp_path / "figures.json", cv2.getNumThreads()
    code, out, err = spheremouse("bench", CLIP, "--frames", 12, "--steps", 15, "--json", path)
    assert (code, err) == (0, "")  # a bar is for terminals
    assert "tracked: 2 of 2 compared, 5 of 5 in a row" in out
    assert "ratio" in out
    figures = json.loads(path.read_text())
    assert (figures["frames"], figures["steady"]["steps"]) == (2, 5)
    assert cv2.getNumThreads() == threads


def test_errors_are_one_line(spheremouse, tmp_path):
    code, _, err = spheremouse("bench", tmp_path / "nothing")
    assert (code, err.count("\n")) == (2, 1)
    assert err.startswith(f"spheremouse: {tmp_path / 'nothing'}: no such folder")
    code, _, err = spheremouse("bench", "--steps", 10)
    assert (code, err) == (2, "spheremouse: --steps: 10: the first 10 do not count; give more, or 0\n")
