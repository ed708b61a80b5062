"""`spheremouse bench`: which frames count, and how the figures are related. Times themselves are not tested."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from spheremouse.commands.bench import BLOBS, DETECT, FILTER, SIMPLE, STEP, WARM_UP
from spheremouse.commands.bench import measure as benchmark
from spheremouse.commands.bench.measure import (
    Film,
    Steps,
    Times,
    back_and_forth,
    by_size,
    compare,
    in_a_row,
)
from spheremouse.commands.bench.report import notes, report
from spheremouse.errors import DatasetError
from spheremouse.files.dataset.ball import open_dataset, read_frames

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

    figures = report(clip(0), times, 2)
    us = {name: t["median"] for name, t in figures["us"].items()}
    assert us[STEP] == pytest.approx(1e6 * np.median(times.seconds[STEP]))
    assert figures["us"][SIMPLE]["max"] == pytest.approx(1e6 * times.seconds[SIMPLE].max())
    assert figures["us"][STEP]["share_of_interval"] == pytest.approx(us[STEP] / 0.25e6)
    assert figures["step_to_blobs"] == pytest.approx(us[STEP] / us[BLOBS])
    assert figures["step_to_SimpleBlobDetector"] == pytest.approx(us[STEP] / us[SIMPLE])
    assert figures["times_faster_than_real_time"] == pytest.approx(0.25e6 / us[STEP])


@pytest.mark.parametrize("measure", [compare, lambda film: in_a_row(film, 20)])
def test_a_film_as_short_as_the_warm_up_is_rejected(measure):
    with pytest.raises(DatasetError, match="10 frames to track, but the first 10 do not count"):
        measure(clip(WARM_UP))


def test_back_and_forth_every_frame_is_next_to_the_one_before():
    assert [back_and_forth(k, 3) for k in range(9)] == [0, 1, 2, 1, 0, 1, 2, 1, 0]
    assert [back_and_forth(k, 1) for k in range(3)] == [0, 0, 0]
    order = np.array([back_and_forth(k, 7) for k in range(100)])
    assert set(np.abs(np.diff(order))) == {1}
    assert set(order) == set(range(7))


def test_steps_in_a_row_go_on_beyond_the_film_and_keep_the_ball():
    steps = in_a_row(clip(WARM_UP + 6), 60)  # nearly four times through
    assert len(steps) == len(steps.processor) == 60 - WARM_UP
    assert steps.tracked == 60 - WARM_UP
    assert steps.lost == 0
    assert steps.memory is None  # too early to say
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


def test_memory_is_that_of_the_process():
    """A process of its own, since memory of other tests may be freed here at any moment."""
    code = """
import numpy as np
from spheremouse.commands.bench.measure import resident_bytes
before = resident_bytes()
held = np.ones(1 << 25)
print(0 if before is None else (resident_bytes() - before) / held.nbytes)
"""
    grown = float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)
    if not sys.platform.startswith("linux"):
        assert grown == 0
        pytest.skip("no /proc")
    assert 0.95 < grown < 1.05  # of 256 MB


def test_the_number_of_opencv_threads_is_restored():
    threads = cv2.getNumThreads()
    with benchmark.one_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == threads


def test_every_size_is_tracked_for_as_many_steps():
    sizes = ((320, 240), (480, 360))
    steps = by_size(sizes, frames=80, steps=40)
    assert tuple(steps) == sizes
    assert [(len(s), s.tracked, s.lost) for s in steps.values()] == [(30, 30, 0)] * 2


def made(n, median, p99=None, worst=None, tracked=None, memory=None):
    """Return steps with a median, 2 % of them with `p99` and one with `worst`."""
    seconds = np.full(n, median)
    if p99 is not None:
        seconds[: n // 50] = p99
    if worst is not None:
        seconds[0] = worst
    return Steps(seconds, seconds, n if tracked is None else tracked, 0, "", memory)


def figures_of(step, blobs, simple, row=None, sizes=None, tracked=300):
    """Return the report of given times."""
    seconds = {STEP: step, DETECT: step / 2, FILTER: step / 2, BLOBS: blobs, SIMPLE: simple}
    times = Times({name: np.full(300, s) for name, s in seconds.items()}, tracked)
    return report(clip(0), times, row=row, sizes=sizes)


def test_ratios_are_those_of_medians():
    n = 10_000 - WARM_UP
    sizes = {(640, 480): made(500, 1e-3), (1280, 720): made(500, 1.4e-3), (1920, 1080): made(500, 2.1e-3)}
    row = made(n, 1e-3, 2.4e-3, 7.9e-3)
    assert figures_of(1e-3, 10.1e-3, 11.9e-3, row, sizes)["ratios"] == pytest.approx(
        {BLOBS: 10.1, SIMPLE: 11.9, "p99": 2.4, "max": 7.9, "1280x720": 1.4, "1920x1080": 2.1}
    )
    assert figures_of(1e-3, 5e-3, 4e-3)["ratios"] == pytest.approx({BLOBS: 5.0, SIMPLE: 4.0})


def test_a_ball_that_is_mostly_lost_gives_a_warning():
    tracked, lost = (figures_of(1, 2, 3, tracked=n) for n in (290, 200))
    warning = "tracked in less than 95 %"
    assert [any(warning in line for line in notes(f)) for f in (tracked, lost)] == [False, True]


def bench(*words, **variables):
    without = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    command = [sys.executable, "-m", "spheremouse", "bench", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env={**without, **variables})


def test_the_command_runs_on_one_thread_and_writes_its_figures(tmp_path):
    path = tmp_path / "figures.json"
    done = bench(CLIP, "--frames", 12, "--steps", 15, "--no-sizes", "--json", path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # a bar is for terminals
    assert "tracked: 2 of 2 compared, 5 of 5 in a row" in done.stdout
    assert "ratio" in done.stdout
    for verdict in ("met", "judged", "target", "≥", "≤"):
        assert verdict not in done.stdout
    figures = json.loads(path.read_text())
    assert figures["frames"] == 2
    assert figures["steady"]["steps"] == 5
    assert figures["sizes"] == {}
    assert figures["threads"] == {"OpenCV": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def test_a_given_number_of_threads_is_kept():
    only = ("--frames", 11, "--steps", 0, "--no-sizes", "--json", "-")
    figures = json.loads(bench(CLIP, *only, OMP_NUM_THREADS="2").stdout)
    assert figures["threads"] == {"OpenCV": "1", "OMP_NUM_THREADS": "2", "NUMBA_NUM_THREADS": "1"}
    assert figures["steady"] is None


def test_errors_are_one_line(tmp_path):
    done = bench(tmp_path / "nothing")
    assert done.returncode == 2
    assert done.stderr.startswith(f"spheremouse: {tmp_path / 'nothing'}: no such folder")
    assert done.stderr.count("\n") == 1
    done = bench("--steps", 10)
    assert done.returncode == 2
    assert done.stderr == "spheremouse: --steps: 10: the first 10 do not count; give more, or 0\n"
