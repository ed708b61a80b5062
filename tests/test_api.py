"""`import spheremouse as sm`: the public names, and the same figures as those of the commands."""

import json
import re
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from control_world import answer
from invoking import succeed

import spheremouse as sm
from spheremouse.commands import app
from spheremouse.files.yaml import SCHEMAS
from spheremouse.output import Report
from spheremouse.output.sample import to_object
from spheremouse.session.control.server import ControlServer
from spheremouse.session.settings import ControlSettings
from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand

ROOT = Path(__file__).parents[1]
CLIP = ROOT / "tests" / "data" / "far26_clip"
TIMES = ("frame_us", "stages_us", "fps")  # of a report: they differ from run to run


@pytest.fixture(scope="module")
def recording():
    return sm.open_dataset(CLIP)


@pytest.fixture(scope="module")
def samples(recording):
    return list(sm.track(recording))


CONNECT = "spheremouse.session.control.client, spheremouse.output.sample"  # all that `connect` needs


def without_times(report):
    return {key: value for key, value in report.items() if key not in TIMES}


def test_the_public_names():
    assert sorted(sm.__all__) == [
        *("Configuration", "Estimate", "Rig", "Sample", "Source", "SpheremouseError", "Status", "__version__"),
        *("connect", "evaluate", "load_configuration", "load_rig", "open_dataset", "open_source", "smooth", "track"),
    ]
    assert set(sm.__all__) <= set(dir(sm))
    for name in sm.__all__:
        assert not isinstance(getattr(sm, name), ModuleType), name
        assert name == "__version__" or getattr(sm, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'tracks'"):
        _ = sm.tracks  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    ("module", "packages"),
    [
        ("spheremouse", ("numpy", "cv2", "scipy")),
        ("spheremouse.output", ("cv2", "scipy")),
        (CONNECT, ("cv2", "scipy")),
        ("spheremouse.session.control.client", ("numpy", "cv2", "scipy")),  # a page or tray then needs little memory
    ],
)
def test_the_import_alone_loads_no_other_package(module, packages):
    code = f"import sys, {module}; print([m for m in {packages} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert found.stdout == "[]\n"


def test_the_example_of_the_readme_runs_as_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    succeed(app, "simulate", "demo/roll", "--motion", "roll", "--seconds", "0.2")
    capsys.readouterr()
    for page in ("README.md", "docs/python.md"):
        example = re.search(r"^```python\n(import spheremouse.+?)^```", (ROOT / page).read_text(), re.M | re.S)
        assert example is not None, page
        exec(example[1], {})
        lines = capsys.readouterr().out.splitlines()
        assert len(lines) == 6, page
        assert [float(line.split()[0]) for line in lines] == sorted(float(line.split()[0]) for line in lines)


def test_samples_are_those_that_the_command_writes(recording, samples, tmp_path):
    for words, made in (((), samples), (("--smooth",), sm.smooth(samples))):
        file = tmp_path / f"{len(words)}.jsonl"
        succeed(app, "track", CLIP, *words, "--output", f"text:{file}")
        written = [json.loads(line) for line in file.read_text().splitlines()]
        assert len(written) == len(made) == recording.frames
        for line, sample in zip(written, made, strict=True):
            assert line == to_object(sample, tuple(line["counts"]))


def test_the_report_is_that_of_the_command(recording, tmp_path):
    file = tmp_path / "report.json"
    succeed(app, "evaluate", CLIP, "--smooth", "--json", file)
    for smooth, report in zip((False, True), json.loads(file.read_text()), strict=True):
        assert without_times(sm.evaluate(recording, smooth=smooth)) == without_times(report)


def test_samples_without_an_observation_cannot_be_smoothed(samples):
    with pytest.raises(sm.SpheremouseError, match="frame 3 has no observation"):
        sm.smooth([samples[2], replace(samples[3], observation=None)])


@pytest.mark.slow
def test_a_hand_held_ball_has_samples_and_a_report(tmp_path):
    path = tmp_path / "hand"
    for _ in write_wand(path, prepare_wand(WandOptions("hand", seed=3, fps=20.0, seconds=1.0, size=(480, 360)))):
        pass
    recording = sm.open_dataset(path)
    samples = list(sm.track(recording))
    assert len(samples) == recording.frames
    assert {s.coordinates for s in samples} == {"cam"}
    seen = [k for k, s in enumerate(samples) if s.confirmed]
    off = np.array([samples[k].position - recording.truths[0].position[k] for k in seen])
    report = sm.evaluate(recording)
    assert report["frames"] == recording.frames
    assert np.linalg.norm(off, axis=1).max() < 0.02  # m, of a ball of 0.1 m
    with pytest.raises(sm.SpheremouseError, match="no observation"):
        sm.smooth(samples)
    for use in (sm.track, sm.evaluate):
        with pytest.raises(sm.SpheremouseError, match="cannot track this recording; use tracker=wand"):
            use(recording, settings=sm.load_configuration(None, "tracker=so3"))


def test_another_tracker_is_refused_before_the_first_frame(recording):
    wand, published = (sm.load_configuration(None, f"tracker={name}") for name in ("wand", "ekf1"))
    for use in (sm.track, sm.evaluate):
        with pytest.raises(sm.SpheremouseError, match="cannot track this recording; use tracker=so3"):
            use(recording, settings=wand)
    with pytest.raises(sm.SpheremouseError, match="no smoother for tracker ekf1; use so3"):
        sm.evaluate(recording, settings=published, smooth=True)


def test_a_source_is_tracked_with_a_rig(recording):
    with sm.open_source(f"dataset:{CLIP}") as source:
        assert next(sm.track(source)).sequence == 0
    with sm.open_source(f"video:{CLIP / 'video.mkv'}") as film, pytest.raises(sm.SpheremouseError, match="--rig FILE"):
        next(sm.track(film))
    with sm.open_source(f"video:{CLIP / 'video.mkv'}") as film:
        assert next(sm.track(film, recording.rig)).sequence == 0


def test_a_recording_without_targets_and_pose_is_refused(recording):
    rig = replace(recording.rig, pose=None, targets=replace(recording.rig.targets, ids=(), codes=()))
    with pytest.raises(sm.SpheremouseError, match="calibrate the device first"):
        list(sm.track(recording, rig))


def test_settings_come_from_a_file_and_assignments(tmp_path):
    file = tmp_path / "config.yaml"
    file.write_text(f"schema: {SCHEMAS['configuration']}\nmotion:\n  counts_per_mm: 3.0\n")
    settings = sm.load_configuration(file, "motion.scale_x=2")
    assert (settings.motion.counts_per_mm, settings.motion.scale_x) == (3.0, 2.0)
    with pytest.raises(sm.SpheremouseError, match="nothing"):
        sm.load_configuration(None, "nothing=1")


def test_the_samples_of_a_service_are_those_of_its_run(samples, tmp_path_factory):
    path, taken = tmp_path_factory.mktemp("s") / "c", []  # short, since a socket's path is
    with pytest.raises(sm.SpheremouseError, match="no daemon runs"):
        next(sm.connect(path))
    with ControlServer(path, ControlSettings(), answer) as server:
        received = sm.connect(path)
        thread = threading.Thread(target=lambda: taken.append(next(received)))
        thread.start()
        while not taken:
            server.submit(Report((1, 2, 3), None, 1.5, (samples[20],)))
            thread.join(0.01)
        thread.join()
        received.close()
    assert taken[0].stamp == samples[20].stamp
    assert np.allclose(taken[0].rotation, samples[20].rotation, rtol=0.0, atol=1e-12)
