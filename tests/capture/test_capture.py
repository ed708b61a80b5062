"""Sources on real files: a small video written here, cut, bent and missing; the pacing; the ways to name a source."""

import math
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from spheremouse.capture import open_source, pace, section, video
from spheremouse.errors import SpheremouseError
from spheremouse.tracker import Frame

FPS = 30.0
FRAMES = 40


def write_video(path, frames=FRAMES, fps=FPS, codec="FFV1"):
    """A video of noise (so that bytes are spread evenly) that counts its frames in the top-left corner."""
    rng = np.random.default_rng(1)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), fps, (64, 48))
    assert writer.isOpened()
    for i in range(frames):
        image = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
        image[:8, :8] = i * 5
        writer.write(image)
    writer.release()
    return path


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    return write_video(tmp_path_factory.mktemp("video") / "film.mkv")


def failing(spec):
    frames = []
    with pytest.raises(SpheremouseError) as e, open_source(spec) as source:
        frames.extend(source)
    assert "\n" not in str(e.value)
    return frames, str(e.value)


def test_a_video_gives_its_frames_with_exact_times(film):
    """Matroska keeps whole milliseconds; the stamps are k/30 s all the same."""
    with open_source(f"video:{film}") as source:
        assert (source.live, source.rig, source.fps, source.count) == (False, None, FPS, FRAMES)
        frames = list(source)
    assert [f.sequence for f in frames] == list(range(FRAMES))
    np.testing.assert_allclose([f.stamp for f in frames], np.arange(FRAMES) / FPS, rtol=0, atol=1e-12)
    assert frames[7].image.shape == (48, 64, 3)
    assert frames[7].image.dtype == np.uint8
    assert [int(f.image[2, 2, 0]) for f in frames] == [5 * i for i in range(FRAMES)]


def test_a_truncated_video_gives_what_is_there_and_says_how_much(film, tmp_path):
    data = film.read_bytes()
    half = tmp_path / "half.mkv"
    half.write_bytes(data[: len(data) // 2])
    frames, message = failing(f"video:{half}")
    assert 15 <= len(frames) <= 22
    assert message == f"{half}: ends after {len(frames)} of 40 frames; the file is truncated or damaged there"


def test_the_promise_of_a_variable_rate_is_not_held_against_a_video():
    """Promised frames are duration times rate; a video whose last stamp is at the end is whole."""
    assert video.is_cut_short(read=150, last=4.97, fps=30.0, count=300)
    assert not video.is_cut_short(read=150, last=9.9, fps=30.0, count=300)  # 15 frames a second, 10 s
    assert not video.is_cut_short(read=299, last=298 / 30, fps=30.0, count=300)
    assert not video.is_cut_short(read=3, last=0.1, fps=None, count=None)


def test_stamps_increase_whatever_the_container_says():
    """Dropped frames stay a longer step; variable times stay; nonsense is one interval after the last."""

    def stamps(container, fps):
        last, out = -np.inf, []
        for t in container:
            last = video.stamp(t, last, fps)
            out.append(last)
        return out

    np.testing.assert_allclose(stamps([0, 0.033, 0.067, 0.133], 30.0), [0, 1 / 30, 2 / 30, 4 / 30], atol=1e-12)
    np.testing.assert_allclose(stamps([0, 0.020, 0.049], 30.0), [0, 0.020, 0.049], atol=1e-12)
    np.testing.assert_allclose(stamps([0, 0, 0, 0], 50.0), [0, 0.02, 0.04, 0.06], atol=1e-12)
    np.testing.assert_allclose(stamps([np.nan, -1, 0.5, 0.1], 10.0), [0, 0.1, 0.5, 0.6], atol=1e-12)
    assert np.all(np.diff(stamps(np.round(np.arange(500) / 29.97, 3), 30.0)) > 0)


def test_what_is_no_video_is_refused(tmp_path):
    (tmp_path / "text.mkv").write_text("no video")
    (tmp_path / "empty.mkv").write_bytes(b"")
    cases = {
        f"video:{tmp_path / 'none.mkv'}": "no such file",
        f"video:{tmp_path}": "is no file; name a video file, or write dataset:",
        f"video:{tmp_path / 'text.mkv'}": "not a video that OpenCV can read",
        f"video:{tmp_path / 'empty.mkv'}": "not a video that OpenCV can read",
        "video:": "needs a file",
    }
    for name, text in cases.items():
        frames, message = failing(name)
        assert frames == []
        assert text in message


def test_opencv_and_ffmpeg_add_no_lines_of_their_own(film, tmp_path):
    """In a process of its own: FFmpeg's verbosity is fixed when it is first used."""
    (tmp_path / "half.mkv").write_bytes(film.read_bytes()[:100_000])
    (tmp_path / "text.mkv").write_text("no video")
    for name, expected in {"half.mkv": "ends after", "text.mkv": "not a video"}.items():
        program = (
            "import sys\nfrom spheremouse.capture import open_source\n"
            "try:\n    list(open_source(sys.argv[1]))\nexcept Exception as e:\n    print(e)\n"
        )
        command, root = (sys.executable, "-c", program, f"video:{tmp_path / name}"), Path(__file__).parents[2]
        run = subprocess.run(command, capture_output=True, text=True, check=True, cwd=root)
        assert expected in run.stdout
        assert (run.stdout.count("\n"), run.stderr) == (1, "")


def test_a_simulated_camera_brings_its_rig():
    with open_source("synthetic:motion=play,seconds=0.1,noise=2, size=[320, 240] ,fps=20") as source:
        assert source.rig is not None
        assert (source.rig.camera.width, source.fps, source.count, source.live) == (320, 20.0, 2, False)
        frames = list(source)
    assert [(f.stamp, f.sequence, f.image.shape) for f in frames] == [(0.0, 0, (240, 320, 3)), (0.05, 1, (240, 320, 3))]
    with open_source("synthetic") as source:
        assert source.count == 300


def test_a_simulation_that_cannot_be():
    assert (
        "synthetic: motion: must be 'thesis', 'roll', 'play', 'still', 'rest', 'creep', 'flick' or 'axes', is 'fly'"
        in failing("synthetic:motion=fly")[1]
    )
    meant = "did you mean seconds or dim_seconds or lift_seconds?"
    assert failing("synthetic:secnds=1")[1] == f"synthetic: secnds: unknown key; {meant}"
    assert "synthetic: x: not KEY=VALUE" in failing("synthetic:x")[1]
    assert "seconds" in failing("synthetic:seconds=-1")[1]


def test_a_camera_that_is_not_there(capfd):
    assert "opencv:99: no camera there" in failing("opencv:99")[1]
    assert "needs the number of a camera" in failing("opencv:front")[1]
    assert "needs the number of a camera" in failing("opencv:-1")[1]
    assert "unknown key widht; did you mean width" in failing("opencv:99,widht=640")[1]
    assert "height must be a whole number, is '480p'" in failing("opencv:99,height=480p")[1]
    assert capfd.readouterr() == ("", "")


def test_unknown_kinds_are_told_the_known_ones():
    _, message = failing("vidoe:film.mkv")
    assert message == "unknown source 'vidoe:film.mkv'; did you mean video?"
    kinds = "known here: dataset, opencv, synthetic, v4l2, video"
    for name in ("_capture:x", "file.open:x", ":x"):
        assert failing(name)[1].endswith(f"; {kinds}")
    for name in ("", "film.mkv", "os", "__init__", "../roll"):
        assert failing(name)[1].endswith(f"; sources are written KIND:ARGUMENT; {kinds}")


def test_real_time_holds_frames_back_by_their_stamps_and_drops_none(monkeypatch):
    """Against a clock of the test: a slow consumer is never made to wait, a quick one always until the stamp."""
    now = [100.0]
    slept = []

    def sleep(seconds):
        slept.append(seconds)
        now[0] += seconds

    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "sleep", sleep)
    image = np.zeros((1, 1), np.uint8)
    stamps = [5.0, 5.1, 5.2, 5.3]
    given = []
    for frame, work in zip(pace(Frame(image, s, i) for i, s in enumerate(stamps)), [0.0, 0.25, 0.0, 0.0], strict=True):
        given.append((frame.sequence, round(now[0], 9)))
        now[0] += work
    assert given == [(0, 100.0), (1, 100.1), (2, 100.35), (3, 100.35)]
    assert slept == pytest.approx([0, 0.1, 0, 0])


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
