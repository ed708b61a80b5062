"""The command line as a user meets it: commands in, what stands on the two streams and the exit code out.

One small simulated recording serves all; the damaged ones are made from its frames.
"""

import csv
import hashlib
import json
import os
import re
import signal
import sys
import time
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from conftest import directions
from invoking import succeed

from spheremouse import commands as cli
from spheremouse.ball.disc_map import DiscMap
from spheremouse.capture.signals import SignalHandler
from spheremouse.commands.demo import play as demo
from spheremouse.files.ball_map import load_map, save_map, saved_now
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.rig import save_camera, save_rig
from spheremouse.geometry.rotation import log
from spheremouse.output.counts import MotionSettings
from spheremouse.session.timing import FrameTimes
from spheremouse.session.worker import Worker

QUICK = ("--set", "pose.frames=2")


@pytest.fixture(scope="module")
def roll(tmp_path_factory):
    """A dataset: one turn in 2 s, through phi = 90 degrees; made by the command."""
    path = tmp_path_factory.mktemp("cli") / "roll"
    words = ("--motion", "roll", "--turns", 1, "--seconds", 2, "--fps", 20, "--noise", 2)
    said = succeed(cli.app, "simulate", path, *words)
    assert said.startswith(f"{path}: 40 frames of 640x480 at 20 Hz, 26 discs, motion roll; ")
    assert said.count("\n") == 1  # no bar where there is no terminal
    return path


@pytest.fixture(scope="module")
def images(roll):
    return [frame.image for frame in read_frames(open_dataset(roll))]


@pytest.fixture
def variant(roll, tmp_path):
    """Makes a dataset like `roll` with other frames: (frames, **changes of scene.json) -> path."""

    def make(pictures, **changes):
        path = tmp_path / "variant"
        (path / "frames").mkdir(parents=True)
        scene = json.loads((roll / "scene.json").read_text())
        (path / "scene.json").write_text(json.dumps({**scene, "frames": len(pictures), **changes}))
        for i, image in enumerate(pictures):
            cv2.imwrite(str(path / "frames" / f"{i:06d}.png"), image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        return path

    return make


@pytest.fixture
def empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def motions(text):
    """Stamp, counts, increment and rate of the text output as an array, (n, 10)."""
    samples = [json.loads(line) for line in text.splitlines()]
    none = [0.0, 0.0, 0.0]
    rows = [[s["stamp"], *s["counts"], *(s["increment"] or none), *(s["rate"] or none)] for s in samples]
    return np.array(rows).reshape(-1, 10)


def video_frames(path):
    capture = cv2.VideoCapture(str(path))
    count = 0
    while capture.read()[0]:
        count += 1
    capture.release()
    return count


def test_a_run_gives_counts_that_sum_to_the_motion_and_says_what_happened(spheremouse, roll, tmp_path):
    picture = tmp_path / "last.png"
    out, err = spheremouse.succeed("run", "--source", f"dataset:{roll}", "--output", "text:-", "--overlay", picture)
    table = motions(out)
    recording = open_dataset(roll)
    assert len(table) == recording.frames
    np.testing.assert_allclose(table[:, 0], recording.truth.stamp)
    R = recording.truth.attitude
    turned = np.sum([log(b @ a.T) for a, b in pairwise(R)], axis=0)
    exact = MotionSettings().matrix(recording.rig.ball.radius) @ turned
    assert np.linalg.norm(exact) > 3000  # 3770 counts: a turn of a ball of 0.6 m
    assert np.max(np.abs(table[:, 1:4].sum(axis=0) - exact)) < 0.2 / 57.3 * 600  # 0.2 degrees
    x, y, z = table[:, 1:4].sum(axis=0).astype(int)
    assert f"40 frames; counts x {x:+d}, y {y:+d}, third {z:+d}; " in err
    lines = err.splitlines()
    assert sum("camera pose" in line for line in lines) == 1
    assert sum("one standard deviation" in line for line in lines) == 1
    assert not any("rot X" in line for line in lines)  # correlations: --verbose
    assert sum("tracking: " in line for line in lines) == 1
    assert sum("the ball turns" in line for line in lines) == 1
    assert cv2.imread(str(picture)).shape == (960, 1280, 3)
    assert list(tmp_path.iterdir()) == [picture]


def test_frames_ends_the_run_early_and_a_status_without_a_terminal_is_plain_lines(spheremouse, roll, tmp_path):
    log_file, video = tmp_path / "motion.txt", tmp_path / "seen.mkv"
    words = ("--output", f"text:{log_file}", "--frames", "7", "--status", "--overlay", video, *QUICK)
    out, err = spheremouse.succeed("run", "--source", f"dataset:{roll}", *words)
    assert out == ""
    assert len(motions(log_file.read_text())) == 7
    assert video_frames(video) == 7
    assert re.search(r"^ +0\.000 s  tracking  rate [-+.\d ]+ deg/s  counts ", err, re.MULTILINE)
    assert "\x1b" not in err


def test_a_rig_file_serves_a_bare_video_and_a_camera_file_replaces_its_camera(spheremouse, roll, tmp_path):
    rig = open_dataset(roll).rig
    save_rig(tmp_path / "rig.yaml", rig)
    save_camera(tmp_path / "other.yaml", replace(rig.camera, width=1280, height=960))
    source = ("run", "--source", f"video:{roll / 'video.mkv'}", "--output", "text:-", *QUICK)
    said = spheremouse.fail(*source)
    assert said == f"video:{roll}/video.mkv: has no description of the device; give its rig file with --rig FILE"
    out, _ = spheremouse.succeed(*source, "--rig", tmp_path / "rig.yaml", "--frames", "3")
    assert len(motions(out)) == 3
    said = spheremouse.fail(*source, "--rig", tmp_path / "rig.yaml", "--camera", tmp_path / "other.yaml")
    assert said.startswith("frame 0 is 640x480, the camera was calibrated at 1280x960: ")


@pytest.fixture
def device(roll, tmp_path):
    """The rig file of `roll` in a folder of its own."""
    folder = tmp_path / "device"
    folder.mkdir()
    save_rig(folder / "rig.yaml", open_dataset(roll).rig)
    return folder / "rig.yaml"


def test_the_second_run_of_a_device_knows_the_attitude_from_its_first_frame(spheremouse, roll, device):
    words = ("run", "--source", f"video:{roll / 'video.mkv'}", "--output", "text:-", "--rig", device, *QUICK)
    first, err = spheremouse.succeed(*words)
    file = device.with_name("rig.map.yaml")
    discs = len(load_map(file).map)
    assert discs >= 8
    assert f"map: {file}: {discs} discs saved\n" in err
    again, err = spheremouse.succeed(*words)
    assert f"map: {file}: {discs} discs, saved just now\n" in err
    assert re.search(r"^ +0\.0\d\d s  tracking: recognised by \d+ discs of the saved map$", err, re.MULTILINE)
    assert re.search(rf"^map: {re.escape(str(file))}: \d+ discs saved: {discs} discs stayed", err, re.MULTILINE)
    # the same pictures, the same motion: from a map or without one
    difference = motions(first)[:, 1:4].sum(axis=0) - motions(again)[:, 1:4].sum(axis=0)
    assert np.max(np.abs(difference)) < 0.2 / 57.3 * 600  # 0.2 degrees
    assert sorted(p.name for p in device.parent.iterdir()) == ["rig.map.yaml", "rig.yaml"]


@pytest.mark.parametrize("live", [(), ("--realtime",)])
def test_a_table_has_the_samples_of_the_text_and_the_description_of_its_run(spheremouse, roll, device, tmp_path, live):
    import pandas as pd  # the oldest and newest environments of `make nightly` do without it

    path = tmp_path / "a.csv"
    words = ("--output", f"text:{tmp_path / 'a.txt'}", "--output", f"csv:{path}", "--rig", device, "--no-map")
    _, _err = spheremouse.succeed("run", "--source", f"dataset:{roll}", *words, "--frames", "20", *live, *QUICK)
    samples = [json.loads(line) for line in (tmp_path / "a.txt").read_text().splitlines()]
    table = pd.read_csv(path, comment="#").set_index("sequence")
    both = [s for s in samples if s["status"] == "tracking" and s["sequence"] in table.index]
    known = table.loc[[s["sequence"] for s in both]]
    for name in ("quaternion", "rate", "increment", "count"):
        rows = [s["counts" if name == "count" else name] for s in both]
        np.testing.assert_allclose(known.filter(regex=f"^{name}_[wxyz]$").to_numpy(), rows, rtol=1e-12)
    (run,) = json.loads((tmp_path / "a.csv.json").read_text())["runs"]
    assert run["rows"] == len(table)
    if not live:  # else a slow computer skips frames, and an output those that are too late
        assert len(both) == len(samples) == len(table) == 20
    assert run["configuration"]["pose"]["frames"] == 2
    assert run["rig"] == {"file": str(device), "sha256": hashlib.sha256(device.read_bytes()).hexdigest()}
    assert (run["source"]["spec"], run["versions"]["numpy"]) == (f"dataset:{roll}", np.__version__)
    names = sorted(p.relative_to(roll).as_posix() for p in roll.rglob("*") if p.is_file())
    lines = [f"{hashlib.sha256((roll / name).read_bytes()).hexdigest()}  {name}\n" for name in names]
    assert run["source"]["recording"]["sha256"] == hashlib.sha256("".join(lines).encode()).hexdigest()


def test_a_recording_is_replayed_without_a_map_unless_it_is_asked_for(spheremouse, roll, device, empty_folder):
    words = ("--output", "null", *QUICK)
    before = sorted(p.name for p in roll.iterdir())
    for source, more in ((f"dataset:{roll}", ()), (f"video:{roll / 'video.mkv'}", ("--no-map",))):
        _, err = spheremouse.succeed("run", "--source", source, *words, "--rig", device, "--frames", "3", *more)
        assert "map" not in err
    assert [p.name for p in device.parent.iterdir()] == ["rig.yaml"]
    assert sorted(p.name for p in roll.iterdir()) == before
    spheremouse.succeed("run", "--source", f"dataset:{roll}", *words, "--map", "asked.yaml")
    assert len(load_map(empty_folder / "asked.yaml").map) >= 8


def test_a_map_is_shown(spheremouse, empty_folder, roll):
    d = directions(12, 3)
    found = DiscMap(d, 1e-6 * np.eye(24), np.arange(12))
    save_map(empty_folder / "a", saved_now(found, open_dataset(roll).rig))
    code, out, err = spheremouse("map", "show", "a")
    assert (code, err) == (0, "")
    lines = [line.split() for line in out.splitlines()]
    assert out.startswith("a: 12 discs of radius 20 mm on a ball of 0.6 m; saved ")
    for i, (x, y, z) in enumerate(d):
        latitude, longitude = np.rad2deg([np.arcsin(y), np.arctan2(x, z)])
        assert lines[2 + i] == [str(i), f"{latitude:+.1f}", f"{longitude:+.1f}", "0.057", str(i)]


@pytest.mark.parametrize("level", [0, 255])
def test_pictures_of_one_colour_are_refused_in_one_line(spheremouse, images, variant, level):
    flat = [np.full_like(f, level) for f in images[:3]]
    said = spheremouse.fail("run", "--source", f"dataset:{variant(flat)}", "--output", "text:-", *QUICK)
    assert said.startswith("0 of 4 targets found (none), at least 3 are needed; missing: ")


def test_views_with_too_few_targets_are_passed_over(spheremouse, images, variant):
    hidden = [f.copy() for f in images[:4]]
    for image in hidden[:2]:
        image[320:400, 220:300] = image[320:400, 490:580] = 90
    out, err = spheremouse.succeed("run", "--source", f"dataset:{variant(hidden)}", "--output", "text:-", *QUICK)
    assert len(motions(out)) == 2  # a recording is tracked from the first view that showed enough
    assert err.startswith(
        "views passed over: 2 of 4 targets found (YMC, CMY), at least 3 are needed; missing: MCY, CYM"
    )


def test_a_truncated_recording_is_tracked_as_far_as_it_goes(spheremouse, images, variant, tmp_path):
    path = variant(images[:5], frames=60)
    video = tmp_path / "seen.avi"
    words = ("--output", "text:-", "--overlay", video, *QUICK)
    code, out, err = spheremouse("run", "--source", f"dataset:{path}", *words)
    assert code == 2
    assert len(motions(out)) == 5
    assert video_frames(video) == 5
    summary, error = err.splitlines()[-2:]
    assert summary.startswith("5 frames; counts ")
    assert error == f"spheremouse: {path}/frames: ends after 5 of 60 frames"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--source", "dataset:nowhere"], "nowhere: no such folder; "),
        (["--source", "synthetic:motoin=roll"], "synthetic: motoin: unknown key; "),
        (["--output", "txt:-"], "unknown output 'txt:-'; did you mean text?\n"),
        (["--map", "nowhere/m.yaml"], "nowhere/m.yaml: no such folder; name a place for the map with --map, "),
        (["--no-map", "--map=m.yaml"], "--map and --no-map: give one of the two"),
        (["--overlay", "nowhere/seen.mkv"], "nowhere/seen.mkv: there is no folder nowhere; "),
        (["--output", "text:seen.mkv", "--overlay", "seen.mkv"], "seen.mkv: is read or written by this very command; "),
        (
            ["--source", f"synthetic:{'seconds=1,' * 40}", "--overlay", "nowhere/seen.mkv"],
            "nowhere/seen.mkv: there is no folder nowhere; ",
        ),
    ],
    ids=lambda p: p[-1] if isinstance(p, list) else "",
)
def test_a_slip_is_answered_in_one_line(spheremouse, roll, empty_folder, words, message):
    given = {"--source": f"dataset:{roll}", "--output": "text:-"} | dict(zip(words[::2], words[1::2], strict=True))
    said = spheremouse.fail("run", *(w for pair in given.items() for w in pair))
    assert f"{said}\n".startswith(message)
    assert list(empty_folder.iterdir()) == []


def test_an_internal_error_asks_for_a_report_and_shows_its_traceback_only_on_request(spheremouse, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError("one\ntwo")

    monkeypatch.setattr("spheremouse.session.setup.open_source", broken)
    words = ("run", "--source", "synthetic", "--output", "null")
    code, out, err = spheremouse(*words)
    assert (code, out) == (70, "")
    assert err.startswith("spheremouse: internal error, please report it ")
    assert err.endswith("ZeroDivisionError: one two\n")
    assert err.count("\n") == 1
    monkeypatch.setattr(sys, "argv", ["spheremouse", "--debug", *words])
    with pytest.raises(ZeroDivisionError):
        cli.main()


def test_a_signal_ends_a_run_between_two_frames_with_everything_complete(spheremouse, roll, tmp_path, monkeypatch):
    """It arrives while the ninth frame is worked on."""
    work = Worker.work

    def work_and_signal(worker, arrival, colour=False):
        made = work(worker, arrival, colour)
        if worker.frames == 9:
            os.kill(os.getpid(), signal.SIGINT)
        return made

    monkeypatch.setattr(Worker, "work", work_and_signal)
    video = tmp_path / "seen.mkv"
    words = ("--realtime", "--output", "text:-", "--overlay", video, *QUICK)
    out, err = spheremouse.succeed("run", "--source", f"dataset:{roll}", *words)
    assert len(motions(out)) == 9
    assert err.splitlines()[-1].startswith("9 frames; counts ")
    assert "Traceback" not in err
    assert [p.name for p in tmp_path.iterdir()] == ["seen.mkv"]
    assert video_frames(video) == 9


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=["SIGTERM", "SIGINT"])
def test_a_signal_while_a_frame_is_worked_on_is_heard_after_it(number):
    with SignalHandler() as stopping:
        got = []
        for frame in stopping.frames(iter(range(5))):
            if frame == 2:
                os.kill(os.getpid(), number)
            got.append(frame)
    assert (got, stopping.stop_requested) == ([0, 1, 2], True)


def test_a_signal_while_a_frame_is_awaited_ends_the_wait():
    def slow():
        yield 0
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(60)
        yield 1

    before = signal.getsignal(signal.SIGTERM)
    with SignalHandler() as stopping:
        assert list(stopping.frames(slow())) == [0]
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_second_signal_is_a_second_wish_only_after_a_while(monkeypatch):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with SignalHandler() as stopping:
            for _ in range(3):
                os.kill(os.getpid(), signal.SIGINT)
            assert stopping.stop_requested
            monkeypatch.setattr("spheremouse.capture.signals._DUPLICATE_SIGNAL_S", -1.0)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_the_demo_writes_its_files_and_its_counts_are_the_true_ones(spheremouse, tmp_path):
    out, err = spheremouse.succeed("demo", "--out", tmp_path / "demo", "--seconds", "2", "--seed", "1")
    for name, meaning in demo.FILES.items():
        assert re.search(f"{re.escape(str(tmp_path / 'demo' / name))} +{re.escape(meaning)}", out)
        assert (tmp_path / "demo" / name).stat().st_size > 1000
    assert sorted(p.name for p in (tmp_path / "demo").iterdir()) == sorted(demo.FILES)
    sent, exact = re.search(r"counts sent +(\S+ \S+ \S+) +exact would be (\S+ \S+ \S+)", out).groups()
    lines = (tmp_path / "demo" / "motion.csv").read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert [sum(int(row[f"count_{axis}"]) for row in rows) for axis in "xyz"] == [int(n) for n in sent.split()]
    assert "60 of 60 rows" in (tmp_path / "demo" / "motion.csv.json").read_text()
    assert max(abs(int(a) - int(b)) for a, b in zip(sent.split(), exact.split(), strict=True)) <= 2
    assert "60 of 60" in out
    assert re.search(r"next:\n  \S*spheremouse demo --seed 2 +another ball", out)
    assert "\x1b" not in out + err


def test_times_are_summed_up_like_numpy_does():
    rng = np.random.default_rng(0)
    seconds = rng.lognormal(-4.0, 0.5, 5000)
    times = FrameTimes()
    for i, s in enumerate(seconds):
        times.add(s, i / 100.0)
    for share in (0.1, 0.5, 0.99):
        assert times.quantile(share) == pytest.approx(np.quantile(seconds, share))
        assert times.recent_quantile(share) == pytest.approx(np.quantile(seconds[-101:], share))
    assert times.rate == pytest.approx(100.0)
