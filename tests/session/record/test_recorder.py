"""Recordings: what was tracked comes back to the last bit, black where people are, bounded, and whole or not at all."""

import json
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from invoking import refusal
from reporting import counts_of, until
from typer.testing import CliRunner

from spheremouse.ball.build import build
from spheremouse.ball.events import CameraMoved
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import current
from spheremouse.capture import open_source
from spheremouse.commands import app
from spheremouse.errors import DatasetError, OutputError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.write import FilmWriter
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import exp
from spheremouse.session.ball.adapter import BallAdapter
from spheremouse.session.ball.recorded import ball_subject, recorded_mask
from spheremouse.session.offline import results, track
from spheremouse.session.overlay.pen import masked
from spheremouse.session.record import recorder as module
from spheremouse.session.record.archive import snapshot
from spheremouse.session.record.places import next_name, recordings_folder, tidy
from spheremouse.session.record.recorder import Recorder
from spheremouse.session.settings import Configuration, RecordSettings
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.simulate.ball.scene import default_scene
from spheremouse.tracker import Estimate, Frame, Status

PATIENCE = 60.0  # s, for what takes a moment
PLENTY = RecordSettings(free_megabytes=0.0)
EVERYTHING = replace(PLENTY, everything=True)


@cache
def film(bump=None):
    """Device, pose with covariances as estimated, and frames of a play."""
    made = prepare(SimulationOptions(motion="play", seconds=2.2, noise=4.0, seed=4, bump=bump))
    scene = made.scene
    random = np.random.default_rng(1).normal(size=(10, 10))
    C = 1e-8 * random @ random.T
    pose = Pose(exp(np.array([1e-4, 2e-4, 3e-4])) @ scene.pose.rotation, scene.pose.position, C[:6, :6], C[:6, 6:])
    n = len(scene.targets.ids)
    targets = replace(scene.targets, covariance=1e-8 * np.eye(3 * n) + 1e-9)
    rig = replace(scene.rig(), targets=targets, ball=replace(scene.rig().ball, covariance=C[6:, 6:]))
    return rig, pose, tuple(f.frame for f in simulate(made))


def as_live(frames, colour):
    """Stamps of a machine that has run for long, numbers of a camera that drops frames, and grey pictures but where
    `colour(i)`."""
    live = []
    for i, frame in enumerate(frames):
        if i % 17 == 5:
            continue
        image = frame.image if colour(i) else cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY)
        live.append(Frame(image, 86400.0 * np.pi + frame.stamp * (1.0 + 1e-9 * i), 4_294_967_000 + i))
    return live


class Recording(Recorder):
    """A recorder with a thread that writes."""

    def __init__(self, folder, *given, **options):
        super().__init__(folder, *given, **options)
        self.folder, self.result, self._given = folder, Future(), 0
        threading.Thread(target=self._run, daemon=True).start()
        until(lambda: self.open or self.result.done())

    def _run(self):
        try:
            self.result.set_result(self.write())
        except DatasetError as e:
            self.result.set_exception(e)

    def add(self, *given):
        taken = super().add(*given)
        self._given += taken
        return taken

    @property
    def waiting(self):
        return self._given - self.status().frames

    def finish(self):
        """Stop, and return the folder and the last words. Raises the error of `write`."""
        self.stop()
        return self.folder, self.result.result(PATIENCE)


def record(folder, frames, rig, pose, settings=PLENTY):
    """Track the frames while they are recorded, as the worker does; what tracking said, and the folder."""
    subject = ball_subject(rig, pose, Configuration())
    recorder = Recording(folder, subject, settings, "a camera")
    tracker, epochs = build(rig, pose, Settings()), []
    for epoch in track(iter(frames), tracker):
        epochs.append(epoch)
        until(lambda: recorder.waiting < 3)
        image = epoch.frame.image.copy()
        seen_from = current(epoch.state, tracker).pose
        subject = subject if subject.view is seen_from else ball_subject(rig, seen_from, Configuration())
        assert recorder.add(replace(epoch.frame, image=image), subject)
        image[:] = 77  # the buffer goes back to the driver
    return epochs, recorder.finish()[0]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """(number of frames, kind of pictures, settings) -> the frames, what tracking said, and the folder."""

    @cache
    def make(count, kind, settings):
        *device, frames = film()
        live = as_live(frames[:count], KINDS[kind])
        return live, *record(tmp_path_factory.mktemp("recording") / "made", live, *device, settings)

    return lambda count=None, kind="grey, targets in colour", settings=PLENTY: make(count, kind, settings)


def small(width=64, height=48):
    scene = default_scene(width=width, height=height)
    return scene.rig(), scene.pose


def begin(folder, settings=EVERYTHING, device=None, **options):
    """Return a recorder that takes frames, by default small ones."""
    return Recording(folder, ball_subject(*(device or small()), Configuration()), settings, **options)


def moved_subject(rig, pose):
    return ball_subject(rig, replace(pose, position=pose.position + np.array([0.05, 0.0, 0.0])), Configuration())


def small_frame(k, stamp=None):
    return Frame(np.zeros((48, 64), np.uint8), 0.1 * k if stamp is None else stamp, k)


def assert_same_epochs(a, b):
    assert len(a) == len(b)
    for x, y in zip(a, b, strict=True):
        assert (x.frame.stamp, x.frame.sequence) == (y.frame.stamp, y.frame.sequence)
        assert x.frame.image.shape == y.frame.image.shape
        for name in Estimate._fields:
            assert np.array_equal(getattr(x.estimate, name), getattr(y.estimate, name)), name
        assert (x.state.status, x.events) == (y.state.status, y.events)
        for name in ("attitude", "rate", "covariance", "discs"):
            assert np.array_equal(getattr(x.state.filter, name), getattr(y.state.filter, name)), name
        assert np.array_equal(x.state.detections.centre, y.state.detections.centre)


KINDS = {
    "colour": lambda i: True,
    "grey": lambda i: False,
    "grey, targets in colour": lambda i: i in (0, 40, 41),
    "colour, then grey": lambda i: i < 10,
}


# ---- there and back ----


@pytest.mark.parametrize("kind", ["grey, targets in colour", "colour, then grey"])
def test_a_recording_is_tracked_as_it_was_to_the_last_bit(recording, kind):
    rig, pose, _ = film()
    live, epochs, folder = recording(kind=kind)
    assert np.any(counts_of([e.estimate for e in epochs], rig), axis=1).sum() > 15
    keep = recorded_mask(rig, pose, Settings())
    with open_source(f"dataset:{folder}") as source:
        again = list(source)
        tracker = build(source.rig, source.rig.pose, Settings())
    for was, now in zip(live, again, strict=True):
        assert now.stamp == was.stamp
        assert now.sequence == was.sequence
        assert np.array_equal(now.image, masked(was.image, keep))
    assert_same_epochs(epochs, list(track(iter(again), tracker)))


@pytest.mark.slow
def test_a_bump_is_found_again(tmp_path):
    """The camera is pushed: the mask goes with the pose, and the targets are still in it where they stand then."""
    rig, pose, frames = film(bump=1.5)
    epochs, folder = record(tmp_path / "made", frames, rig, pose)
    assert any(isinstance(e, CameraMoved) for epoch in epochs for e in epoch.events)
    again = open_dataset(folder)
    tracker = build(again.rig, again.rig.pose, Settings())
    assert_same_epochs(epochs, list(track(read_frames(again), tracker)))


def test_device_and_pose_come_back_with_their_covariances(recording):
    rig, pose, _ = film()
    back = open_dataset(recording(3)[-1]).rig
    for part, names in (
        ("camera", ("intrinsic", "distortion", "covariance")),
        ("ball", ("radius", "centre", "covariance")),
        ("targets", ("ids", "codes", "position", "covariance", "radii")),
    ):
        for name in names:
            assert np.array_equal(getattr(getattr(back, part), name), getattr(getattr(rig, part), name)), name
    for name in ("rotation", "position", "covariance", "ball_covariance"):
        assert np.array_equal(getattr(back.pose, name), getattr(pose, name)), name
    assert (back.disc_radius, back.readout_s, back.exposure_s) == (rig.disc_radius, rig.readout_s, rig.exposure_s)


@pytest.mark.parametrize("size", [(64, 48), (63, 47)])
@pytest.mark.parametrize("kind", KINDS)
def test_whole_pictures_of_noise_come_back_bit_for_bit(tmp_path, size, kind):
    rng = np.random.default_rng(2)
    frames = [Frame(rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8), 0.1 * i, i) for i in range(45)]
    live = as_live(frames, KINDS[kind])
    recorder = begin(tmp_path / "made", EVERYTHING, small(*size))
    for frame in live:
        assert recorder.add(frame)
    folder, _ = recorder.finish()
    again = list(read_frames(open_dataset(folder)))
    assert [(f.stamp, f.sequence) for f in again] == [(f.stamp, f.sequence) for f in live]
    assert all(np.array_equal(a.image, b.image) for a, b in zip(again, live, strict=True))
    assert json.loads((folder / "scene.json").read_text())["kept"] == "everything"


def test_who_reads_the_video_alone_gets_the_same_luma(recording):
    live, _, folder = recording(12, settings=EVERYTHING)
    video = cv2.VideoCapture(str(folder / "video.mkv"))
    for frame in live:
        ok, image = video.read()
        assert ok
        luma = frame.image if frame.image.ndim == 2 else cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY)
        assert np.array_equal(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), luma)
    assert not video.read()[0]


def test_stamps_of_any_clock_come_back(tmp_path):
    """Stamps that stand still, go back, or are very large come back as they are."""
    stamps = [1.7e9 + 1 / 3, 1.7e9 + 1 / 3, 5e-324, -2.0, 0.1 + 0.2, 1e300]
    recorder = begin(tmp_path / "made")
    assert all(recorder.add(small_frame(k, stamp)) for k, stamp in enumerate(stamps))
    assert not recorder.add(small_frame(6, float("nan")))
    assert not recorder.add(Frame(np.zeros((40, 64), np.uint8), 1.0, 7))
    folder, _ = recorder.finish()
    assert [f.stamp for f in read_frames(open_dataset(folder))] == stamps
    assert recorder.status().dropped == 2


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_the_commands_replay_a_recording_without_further_options(recording, tmp_path):
    live, epochs, folder = recording()
    sent = np.sum(counts_of([e.estimate for e in epochs], film()[0]), axis=0)
    done = run("run", "--source", f"dataset:{folder}", "--output", f"text:{tmp_path / 'out.txt'}", "--no-status")
    assert done.exit_code == 0, done.output
    x, y, z = sent
    assert f"counts x {x:+d}, y {y:+d}, third {z:+d}" in done.stderr
    done = run("evaluate", folder, "--config", folder / "config.yaml", "--json", "-")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert (result["frames"], result["tracked"]) == (len(live), len(epochs))
    known = [e.state.filter for e in epochs if e.state.status is Status.TRACKING and e.state.filter.nis > 0.0]
    assert result["nis"] == pytest.approx(sum(f.nis for f in known) / sum(2 * len(f.used) for f in known), rel=1e-12)
    assert result["attitude_rmse_deg"]["combined"] is None
    assert result["frame_us"]["median"] > 0.0
    assert "no truth.csv" in done.stderr


# ---- what is kept ----


def test_nobody_beside_the_ball_reaches_the_disk(recording):
    """Every file but the pictures is text that holds no pixel; in the pictures all else is black."""
    live, _, folder = recording(20)
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert names == {"scene.json", "rig.yaml", "config.yaml", "stamps.csv", "video.mkv", "frames/000000.png"}
    assert "black" in json.loads((folder / "scene.json").read_text())["kept"]
    outside = recorded_mask(*film()[:2], Settings()) == 0
    assert np.mean(outside) > 0.5
    video = cv2.VideoCapture(str(folder / "video.mkv"))
    for _ in live:
        assert not video.read()[1][outside].any()
    assert not cv2.imread(str(folder / "frames" / "000000.png"))[outside].any()
    assert folder.stat().st_mode & 0o007 == 0


def test_a_camera_that_was_moved_leaves_nothing_of_the_view_before(tmp_path):
    device = small(160, 120)
    before, moved = ball_subject(*device, Configuration()), moved_subject(*device)
    recorder = begin(tmp_path / "made", PLENTY, device)
    white = np.full((120, 160, 3), 255, np.uint8)
    for i in range(40):
        until(lambda: recorder.waiting < 3)
        image = white if i % 7 else white[..., 0].copy()
        assert recorder.add(Frame(image, float(i), i), before if i < 20 else moved)
    a, b = (s.kept() > 0 for s in (before, moved))
    assert np.any(a & ~b)
    for i, frame in enumerate(read_frames(open_dataset(recorder.finish()[0]))):
        shown = frame.image if frame.image.ndim == 2 else frame.image.min(axis=2)
        assert np.array_equal(shown > 0, a if i < 20 else a | b if i == 20 else b), i


@pytest.mark.parametrize("settings", [PLENTY, EVERYTHING], ids=["masked", "everything"])
def test_the_pose_is_that_of_the_first_frame(tmp_path, settings):
    """Between the wish to record and the first frame somebody may push the camera."""
    *device, frames = film()
    moved = moved_subject(*device)
    recorder = begin(tmp_path / "made", settings, device)
    assert recorder.add(frames[0], moved)
    again = open_dataset(recorder.finish()[0])
    assert np.array_equal(again.rig.pose.position, moved.view.position)
    kept = masked(frames[0].image, moved.kept()) if settings is PLENTY else frames[0].image
    assert np.array_equal(next(iter(read_frames(again))).image, kept)


# ---- in step with the worker, and bounded ----


def test_the_worker_never_waits(tmp_path, monkeypatch):
    """A disk that takes nothing for a while: frames are dropped and counted, what was kept has its own stamps."""
    go_on, write = threading.Event(), FilmWriter.add

    def slow(self, frame):
        assert go_on.wait(PATIENCE)
        write(self, frame)

    monkeypatch.setattr(FilmWriter, "add", slow)
    *device, frames = film()
    recorder = begin(tmp_path / "made", EVERYTHING, device)
    taken = [i for i in range(300) if recorder.add(Frame(frames[i % 60].image, 0.01 * i, i))]
    most = int(module._MAX_QUEUED_BYTES / frames[0].image.size)
    assert taken == list(range(len(taken)))
    assert most <= len(taken) <= most + 1  # one is being written
    assert recorder.status().dropped == 300 - len(taken)
    go_on.set()
    until(lambda: recorder.waiting == 0)
    assert recorder.add(Frame(frames[0].image, 10.0, 1000))
    folder, words = recorder.finish()
    again = list(read_frames(open_dataset(folder)))
    assert [f.sequence for f in again] == [*taken, 1000]
    assert [f.stamp for f in again] == [*(0.01 * i for i in taken), 10.0]
    assert all(np.array_equal(f.image, frames[i % 60].image) for f, i in zip(again, taken, strict=False))
    assert f"{300 - len(taken)} dropped" in words


@pytest.mark.parametrize(
    ("change", "words", "frame"),  # and whether another frame comes
    [
        ({"time": 5.1}, "ended after 5 s", False),
        ({"time": 5.1}, "ended after 5 s", True),
        ({"time": 1.0, "free": 9e7}, "100 MB are free on the disk", True),  # which is looked at with a frame
    ],
)
def test_it_ends_after_its_time_and_before_the_disk_is_full(tmp_path, monkeypatch, change, words, frame):
    monkeypatch.setattr(module, "_CHECK_INTERVAL_S", 0.05)
    now = {"time": 0.0, "free": 1e9}
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=now["free"]))
    settings = RecordSettings(seconds=5.0, free_megabytes=100.0, everything=True)
    recorder = begin(tmp_path / "made", settings, clock=lambda: now["time"])
    assert recorder.add(small_frame(0))
    until(lambda: recorder.status().frames == 1)
    now |= change
    if frame:
        recorder.add(small_frame(1))
    assert words in recorder.result.result(PATIENCE)
    assert open_dataset(recorder.finish()[0]).frames == 1
    if "free" in change:
        with pytest.raises(DatasetError, match="100 MB are free"):
            begin(tmp_path / "next", settings)
    assert [p.name for p in tmp_path.iterdir()] == ["made"]


def test_it_ends_at_its_size(tmp_path):
    """What the video's writer holds back counts: it is no larger in the end."""
    *device, frames = film()
    recorder = begin(tmp_path / "made", replace(EVERYTHING, megabytes=30.0), device)
    for i in range(60):
        until(lambda: recorder.waiting < 3 or not recorder.active)  # it leaves frames at its end
        recorder.add(frames[i])
    folder, words = recorder.finish()
    assert "ended at 30 MB" in words
    assert 20e6 < sum(p.stat().st_size for p in folder.iterdir()) < 30e6
    assert 5 < open_dataset(folder).frames < 60


# ---- whole or not at all ----


def test_whole_pictures_of_a_ball_in_a_hand_have_to_be_asked_for(tmp_path):
    """They show the person who holds it."""
    subject = replace(ball_subject(*small(), Configuration()), parts="")
    with pytest.raises(DatasetError, match=r"with the person in them.*--everything"):
        Recorder(tmp_path / "made", subject, PLENTY)
    assert list(tmp_path.iterdir()) == []


def test_no_frame_is_no_recording(tmp_path):
    recorder = begin(tmp_path / "made")
    with pytest.raises(DatasetError, match="no frame"):
        recorder.finish()
    assert list(tmp_path.iterdir()) == []
    assert not recorder.add(small_frame(0))


def test_somebody_who_comes_first_is_not_overwritten(tmp_path):
    *device, frames = film()
    recorder = begin(tmp_path / "made", PLENTY, device)
    recorder.add(frames[0])
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "scene.json").write_text("{}")
    with pytest.raises(DatasetError, match="not empty"):
        recorder.finish()
    assert [p.name for p in tmp_path.rglob("*")] == ["made", "scene.json"]


PRELUDE = """
import os, resource, signal, sys
sys.path[:0] = [os.path.dirname(sys.argv[1]), os.path.join(os.path.dirname(sys.argv[1]), "../..")]
from pathlib import Path
from test_recorder import *
recorder = begin(Path(sys.argv[2]), EVERYTHING, small(640, 480))
def feed(n):
    rng = np.random.default_rng(0)
    for i in range(n):
        until(lambda: recorder.waiting < 3)
        recorder.add(Frame(rng.integers(0, 256, (480, 640), dtype=np.uint8), 0.1 * i, i))
    until(lambda: recorder.waiting == 0)
"""


def in_another_process(code, path):
    return subprocess.run(
        [sys.executable, "-c", PRELUDE + code, __file__, str(path)],
        check=False,
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE,
    )


@pytest.mark.slow
def test_a_disk_that_fills_up_leaves_nothing(tmp_path):
    """Writes fail half-way: here by a limit on the size of a file, since OpenCV's writer does not say so."""
    code = """
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, 2_000_000))
feed(20)
try:
    recorder.finish()
except DatasetError as e:
    print(e)
"""
    done = in_another_process(code, tmp_path / "made")
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 1
    assert "is the disk full?" in done.stdout
    assert str(tmp_path / "made") in done.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_kill_leaves_no_recording_and_what_it_leaves_is_removed(tmp_path):
    done = in_another_process("feed(5)\nos.kill(os.getpid(), 9)\n", tmp_path / "made")
    assert done.returncode == -signal.SIGKILL, done.stderr
    left = list(tmp_path.iterdir())
    assert len(left) == 1
    assert left[0].name.startswith(".made.")
    assert not (left[0] / "scene.json").exists()
    (tmp_path / ".hidden").mkdir()
    (tmp_path / "kept").mkdir()
    assert tidy(tmp_path) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == [".hidden", "kept"]


def test_tidying_leaves_alone_what_is_being_written(tmp_path):
    *device, frames = film()
    recorder = begin(tmp_path / "made", PLENTY, device)
    assert recorder.add(frames[0])
    assert tidy(tmp_path) == 0
    recorder.finish()
    assert tidy(tmp_path) == 0
    assert open_dataset(tmp_path / "made").frames == 1
    assert not list((tmp_path / "made").glob(".*"))
    assert tidy(tmp_path / "nowhere") == 0


# ---- where ----


def test_recordings_go_to_the_configured_folder_or_the_state_folder(monkeypatch, tmp_path):
    assert recordings_folder(RecordSettings(folder=str(tmp_path))) == tmp_path
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    assert str(recordings_folder(RecordSettings())) == "/state/spheremouse/recordings"
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/spheremouse")
    assert str(recordings_folder(RecordSettings())) == "/var/lib/spheremouse/recordings"


def test_names_are_dates_and_never_taken(tmp_path):
    now = time.struct_time((2026, 11, 21, 9, 5, 7, 5, 325, 0))
    assert next_name(tmp_path, now).name == "2026-11-21-090507"
    (tmp_path / "2026-11-21-090507").mkdir()
    assert next_name(tmp_path, now).name == "2026-11-21-090507-2"
    assert next_name(tmp_path, now, ".png").name == "2026-11-21-090507.png"


# ---- what may be wrong with a recording ----


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t[:-1], "2 rows, but scene.json has 3"),
        (lambda t: [t[0], t[2], t[1], t[3]], "frame 1 where 0 is due"),
        (lambda t: [*t[:2], t[2].replace("4294967001", "1.5"), t[3]], "whole number"),
        (lambda t: [*t[:3], t[3][:-1] + "2"], "colour must be 0 or 1"),
        (lambda t: [*t[:3], t[3].replace(t[3].split(",")[1], "soon")], "line 4: t: 'soon'"),
        (lambda t: ["frame,t", *t[1:]], "no column sequence, colour"),
    ],
)
def test_spoilt_stamps_are_named(recording, tmp_path, change, words):
    folder = shutil.copytree(recording(3)[-1], tmp_path / "made")
    rows = (folder / "stamps.csv").read_text().splitlines()
    after = change(rows)
    assert after != rows
    (folder / "stamps.csv").write_text("\n".join(after) + "\n")
    text = refusal(DatasetError, open_dataset, folder)
    assert "stamps.csv" in text
    assert words in text


def test_a_rig_file_that_was_mended_counts(recording, tmp_path):
    folder = shutil.copytree(recording(3)[-1], tmp_path / "made")
    text = (folder / "rig.yaml").read_text()
    line = next(row for row in text.splitlines() if row.startswith("disc_radius"))
    (folder / "rig.yaml").write_text(text.replace(line, "disc_radius: 0.0123"))
    assert open_dataset(folder).rig.disc_radius == 0.0123
    (folder / "rig.yaml").write_text(text.replace("width: 640", "width: 320"))
    with pytest.raises(DatasetError, match="320x480"):
        open_dataset(folder)
    (folder / "rig.yaml").write_text("schema: 1\n")
    with pytest.raises(DatasetError, match=r"rig\.yaml"):
        open_dataset(folder)


# ---- one picture ----


@pytest.mark.parametrize("grey", [False, True], ids=["colour", "grey"])
def test_a_snapshot_shows_what_the_tracker_sees_and_nobody_else(tmp_path, grey):
    rig, pose, frames = film()
    adapter = BallAdapter((replace(rig, pose=pose),), Configuration(), None, print)
    made = list(results(as_live(frames[:30], lambda i: not grey), adapter))[-1]
    before = made.frame.image.copy()
    path = snapshot(tmp_path / "a.png", adapter.picture(made, (1, 2, 3), False))
    image = cv2.imread(str(path))
    assert image.shape == (960, 1280, 3)
    assert np.array_equal(made.frame.image, before)
    away = cv2.erode((recorded_mask(rig, pose, Settings()) == 0).astype(np.uint8), np.ones((41, 41), np.uint8))
    away = cv2.resize(away, (1280, 960), interpolation=cv2.INTER_NEAREST) > 0
    away[-60:] = False  # the strip with the numbers
    assert np.count_nonzero(away) > 50_000
    assert not image[away].any()
    drawn = np.abs(image.astype(int) - (40, 40, 255)).max(axis=2) < 60  # the map's discs
    assert np.count_nonzero(drawn) > 50
    whole = cv2.imread(str(snapshot(tmp_path / "b.png", adapter.picture(made, (1, 2, 3), True))))
    assert np.mean(whole[away] > 0) > 0.9
    with pytest.raises(OutputError, match="there already"):
        snapshot(path, lambda: whole)
    with pytest.raises(OutputError, match="cannot be written"):
        snapshot(tmp_path / "none" / "a.png", lambda: whole)
