"""The figures of `spheremouse bench`: what counts, and how it hangs together. How long a frame takes is not tested."""

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

from spheremouse.cli_bench import BLOBS, DETECT, FILTER, SIMPLE, STEP, WARM_UP, Film, measure, report
from spheremouse.errors import DatasetError
from spheremouse.recording import open_dataset, read_frames

CLIP = Path(__file__).parent / "data" / "far26_clip"


def clip(frames):
    """The clip's first frames with the camera's pose known, so that few are enough."""
    recording = open_dataset(CLIP)
    rig = replace(recording.rig, pose=recording.pose)
    return Film("clip", rig, 0.25, lambda: islice(read_frames(recording), frames))


def test_every_frame_after_the_warm_up_counts_in_every_round():
    threads = cv2.getNumThreads()
    times = measure(clip(WARM_UP + 3), repeat=2)
    assert cv2.getNumThreads() == threads
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


def test_a_film_as_short_as_the_warm_up_is_refused():
    with pytest.raises(DatasetError, match="10 frames to track, and the first 10 do not count"):
        measure(clip(WARM_UP))


def bench(*words, **variables):
    without = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    command = [sys.executable, "-m", "spheremouse", "bench", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env={**without, **variables})


def test_the_command_runs_on_one_thread_and_writes_its_figures(tmp_path):
    path = tmp_path / "figures.json"
    done = bench(CLIP, "--frames", 12, "--json", path)
    assert done.returncode == 0, done.stderr
    assert "step : multi-mask detector = " in done.stdout
    assert "tracked: 2 of 2 frames" in done.stdout
    figures = json.loads(path.read_text())
    assert figures["frames"] == 2
    assert figures["threads"] == {"OpenCV": "1", "OMP_NUM_THREADS": "1"}


def test_whoever_sets_the_threads_keeps_them():
    figures = json.loads(bench(CLIP, "--frames", 11, "--json", "-", OMP_NUM_THREADS="2").stdout)
    assert figures["threads"] == {"OpenCV": "1", "OMP_NUM_THREADS": "2"}


def test_errors_come_through_in_one_line(tmp_path):
    done = bench(tmp_path / "nothing")
    assert done.returncode == 2
    assert done.stderr.startswith(f"spheremouse: {tmp_path / 'nothing'}: no such folder")
    assert done.stderr.count("\n") == 1
