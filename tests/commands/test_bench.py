"""`spheremouse bench`: which steps count, and how the figures are related. Times themselves are not tested."""

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from spheremouse.commands.bench import WARM_UP, Film, Steps, lines, measure, report
from spheremouse.errors import DatasetError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames

CLIP = Path(__file__).parents[1] / "data" / "far26_clip"


def clip(frames):
    """The clip's first frames with the camera's pose known, so that few are enough."""
    recording = open_dataset(CLIP)
    rig = replace(recording.rig, pose=recording.pose)
    return Film("clip", rig, 0.25, lambda: islice(read_frames(recording), frames))


def test_a_film_as_short_as_the_warm_up_is_rejected():
    with pytest.raises(DatasetError, match="10 frames to track, but the first 10 do not count"):
        measure(clip(WARM_UP), 20)


def test_steps_go_on_beyond_the_film_and_keep_the_ball():
    done = []
    steps = measure(clip(WARM_UP + 6), 60, done.append)  # nearly four times through
    assert done == list(range(1, 61))
    assert len(steps.seconds) == len(steps.processor) == steps.tracked == 60 - WARM_UP
    assert steps.lost == 0
    assert len(steps.compared) == 3
    assert min(steps.compared) > 0.0
    assert np.all(steps.seconds > 0.0)


def test_a_ball_that_is_lost_is_counted():
    """The picture goes dark for two seconds, in steps of a quarter, once in the film: back and forth, four times."""
    film = clip(25)
    dark = range(14, 22)

    def frames():
        for k, frame in enumerate(film.frames()):
            yield replace(frame, image=np.zeros_like(frame.image)) if k in dark else frame

    steps = measure(replace(film, frames=frames), 2 * 48)
    assert steps.lost == 4
    assert steps.tracked < 96 - WARM_UP


def figures_of(tracked):
    seconds = np.full(10_000, 1e-3)
    seconds[:200], seconds[0] = 2.4e-3, 7.9e-3
    return report(clip(0), Steps(seconds, 0.5 * seconds, tracked, 0))


def test_ratios_are_over_the_median():
    figures = figures_of(10_000)
    assert figures["ratios"] == pytest.approx({"p99": 2.4, "max": 7.9})
    assert figures["processor_us"] == pytest.approx({"median": 500.0, "p99": 1200.0, "max": 3950.0})


@pytest.mark.parametrize(("tracked", "warned"), [(9_600, False), (9_400, True)])
def test_a_ball_that_is_mostly_lost_gives_a_warning(tracked, warned):
    assert any("tracked in less than 95 %" in line for line in lines(figures_of(tracked))) == warned


def test_the_command_prints_lines_and_writes_its_figures(spheremouse, tmp_path):
    path = tmp_path / "figures.json"
    code, out, err = spheremouse("bench", CLIP, "--steps", 15, "--json", path)
    assert (code, err) == (0, "")  # a bar is for terminals
    assert "tracked: 5 of 5; never lost" in out
    assert json.loads(path.read_text())["steps"] == 5

    assert spheremouse.fail("bench", tmp_path / "nothing").startswith(f"{tmp_path / 'nothing'}: no such folder")
