"""`spheremouse match` from the recording to the configuration, on a small simulated film and a simulated trackball."""

import json
import shutil

import numpy as np
import pytest

from spheremouse.commands import match as cli_match
from spheremouse.files import config
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.mouse_log import MouseLog, read_log, write_log
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.film import SimulationOptions, prepare
from spheremouse.simulate.ball.profile import play
from spheremouse.simulate.ball.trackball import Trackball, rate_of, simulate_log, trackball_matrix
from spheremouse.simulate.to_dataset import write_simulation

MATRIX = trackball_matrix(-480.0, 480.0)
LAG = 0.0171
OPTIONS = SimulationOptions(motion="play", seconds=7.0, fps=20.0, noise=2.0, seed=8)


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    path = tmp_path_factory.mktemp("match") / "film"
    for _ in write_simulation(path, prepare(OPTIONS)):
        pass
    return path


@pytest.fixture
def log(film, tmp_path):
    truth = open_dataset(film).truth
    seen = simulate_log(rate_of(truth), truth.stamp[0], truth.stamp[-1] + 1.0, Trackball(MATRIX, lag=LAG), 2)
    path = tmp_path / "trackball.csv"
    write_log(path, seen)
    return path


@pytest.fixture(scope="module")
def remembered():
    return {}


@pytest.fixture(autouse=True)
def _tracked_once(monkeypatch, remembered):
    """A film is tracked once for all tests."""
    really = cli_match.track_recording

    def tracked(recording, plan, stamps):
        key = (recording, plan.configuration.pose, stamps)
        if key not in remembered:
            remembered[key] = really(recording, plan, stamps)
        return remembered[key]

    monkeypatch.setattr(cli_match, "track_recording", tracked)


def test_the_scale_is_found_and_written_as_a_configuration(spheremouse, film, log, tmp_path):
    out, figures = tmp_path / "scale.yaml", tmp_path / "figures.json"
    code, said, complaints = spheremouse("match", film, log, "--out", out, "--json", figures)
    assert (code, complaints) == (0, "")
    assert "verdict: the two agree" in said
    assert f"{out}: written; next: spheremouse run --config {out}" in said
    found = json.loads(figures.read_text())
    sigma = np.array(found["sigma_counts_per_rad"])
    assert np.all(np.abs(np.array(found["matrix_counts_per_rad"]) - MATRIX) < 5.0 * sigma + 2.0)
    assert found["lag_s"] == pytest.approx(LAG, abs=5.0 * found["lag_sigma_s"])
    motion = config.load(out, Configuration).motion
    np.testing.assert_allclose(motion.matrix(0.6)[:2], MATRIX, atol=5.0)
    assert motion.matrix(0.6)[2, 1] == pytest.approx(600.0, rel=1e-3)
    text = out.read_text()
    code, _, complaints = spheremouse("match", film, log, "--out", out)
    assert code == 2
    assert f"{out}: there already" in complaints
    assert out.read_text() == text
    assert spheremouse("match", film, log, "--out", out, "--force")[0] == 0


def test_with_these_settings_there_is_nothing_to_set(spheremouse, film, log, tmp_path):
    out = tmp_path / "scale.yaml"
    assert spheremouse("match", film, log, "--out", out)[0] == 0
    code, said, _ = spheremouse("match", film, log, "--config", out)
    assert code == 0
    assert said.endswith("the settings are right already\n")


def test_a_log_of_another_time_writes_nothing(spheremouse, film, tmp_path):
    path, out = tmp_path / "other.csv", tmp_path / "scale.yaml"
    write_log(path, simulate_log(play(20.0, np.random.default_rng(77)).rate, 0.0, 20.0, Trackball(MATRIX)))
    code, said, _ = spheremouse("match", film, path, "--out", out)
    assert code == 1
    assert "verdict: the log follows the ball at no lag" in said
    assert not out.exists()


def test_unusable_input_is_one_line_and_exit_code_2(spheremouse, film, log, tmp_path):
    empty = tmp_path / "empty.csv"
    seen = read_log(log)
    write_log(empty, MouseLog(seen.stamp, 0.0 * seen.counts, seen.wheel, seen.lost))
    short = tmp_path / "short.csv"
    keep = seen.stamp < seen.stamp[0] + 2.0
    write_log(short, MouseLog(seen.stamp[keep], seen.counts[keep], seen.wheel[keep], seen.lost[keep]))
    broken = tmp_path / "broken.csv"
    broken.write_text("t,dx,dy\n1,2\n")
    for words, what in (
        ((film, empty), f"{empty}: no motion in it"),
        ((film, short), f"{short}: has less than 3 s of motion in common"),
        ((film, broken), f"{broken}, line 2: 2 cells under 3 columns"),
        ((film, tmp_path / "no.csv"), "no such file"),
        ((tmp_path / "no", log), "no such recording"),
        ((film / "video.mkv", log), "give its rig file with --rig"),
        ((film, log, "--out", tmp_path / "no" / "x.yaml"), "there is no folder"),
        ((film, log, "--set", "motion.scale_q=1"), "unknown key"),
    ):
        code, said, complaints = spheremouse("match", *words)
        assert (code, said, len(complaints.splitlines())) == (2, "", 1), complaints
        assert what in complaints


def test_a_video_with_a_table_of_stamps_is_as_good_as_the_dataset(spheremouse, film, log, tmp_path):
    from spheremouse.files.rig import save_rig

    rig, video, stamps = tmp_path / "rig.yaml", tmp_path / "film.mkv", tmp_path / "stamps.csv"
    dataset = open_dataset(film)
    save_rig(rig, dataset.rig)
    shutil.copy(film / "video.mkv", video)
    stamps.write_text("frame,t\n" + "".join(f"{k},{t + 500.0}\n" for k, t in enumerate(dataset.truth.stamp)))
    code, said, complaints = spheremouse("match", video, log, "--rig", rig, "--stamps", stamps)
    assert (code, complaints) == (0, "")
    assert "the clock of the log is 499.983 s behind that of the frames" in said
    stamps.write_text("frame,t\n0,1.0\n")
    code, _, complaints = spheremouse("match", video, log, "--rig", rig, "--stamps", stamps, "--set", "pose.frames=2")
    assert code == 2
    assert f"{stamps}:2: 1 frames, but the recording has more" in complaints
