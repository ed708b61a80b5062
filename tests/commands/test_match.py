"""`spheremouse match` from the recording to the configuration, on a small simulated film and a simulated trackball."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import shared
from experiments.kit.trackball import Trackball, rate_of, simulate_log, trackball_matrix

from spheremouse.commands import match as cli_match
from spheremouse.files import config
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.mouse_log import MouseReport, read_log, write_log
from spheremouse.session.settings import Configuration
from spheremouse.simulate.ball.film import SimulationOptions, prepare
from spheremouse.simulate.ball.profile import play
from spheremouse.simulate.to_dataset import write_simulation

MATRIX = trackball_matrix(-480.0, 480.0)
LAG = 0.0171
OPTIONS = SimulationOptions(motion="play", seconds=9.0, fps=12.0, noise=2.0, seed=8)


def save(path, log):
    rows = zip(log.stamp.tolist(), log.counts.tolist(), strict=True)
    write_log(path, "simulated", (MouseReport(t, round(dx), round(dy)) for t, (dx, dy) in rows))


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    path = tmp_path_factory.mktemp("match") / "film"
    list(write_simulation(path, prepare(OPTIONS)))
    return path


@pytest.fixture
def log(film, tmp_path):
    truth = open_dataset(film).truth
    seen = simulate_log(rate_of(truth), truth.stamp[0], truth.stamp[-1] + 1.0, Trackball(MATRIX, lag=LAG), 2)
    path = tmp_path / "trackball.csv"
    save(path, seen)
    return path


@pytest.fixture(scope="module", autouse=True)
def _tracked_once():
    once = shared(cli_match.track_recording, lambda recording, plan: (recording, plan.configuration.pose))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli_match, "track_recording", once)
        yield


def test_the_scale_is_found_and_written_as_a_configuration(spheremouse, film, log, tmp_path):
    out = tmp_path / "scale.yaml"
    code, said, complaints = spheremouse("match", film, log, "--out", out)
    assert (code, complaints) == (0, "")
    assert "verdict: the two agree" in said
    assert f"{out}: written; next: spheremouse run --config {out}" in said
    motion = config.load(out, Configuration).motion
    np.testing.assert_allclose(motion.matrix(0.6)[:2], MATRIX, atol=5.0)
    assert motion.matrix(0.6)[2, 1] == pytest.approx(600.0, rel=1e-3)
    said, _ = spheremouse.succeed("match", film, log, "--config", out)
    assert said.endswith("the settings are right already\n")
    text = out.read_text()
    assert f"{out}: there already" in spheremouse.fail("match", film, log, "--out", out)
    assert out.read_text() == text
    spheremouse.succeed("match", film, log, "--out", out, "--force")


def test_a_log_of_another_time_writes_nothing(spheremouse, film, tmp_path):
    path, out = tmp_path / "other.csv", tmp_path / "scale.yaml"
    save(path, simulate_log(play(20.0, np.random.default_rng(77)).rate, 0.0, 20.0, Trackball(MATRIX)))
    code, said, _ = spheremouse("match", film, path, "--out", out)
    assert code == 1
    assert "verdict: the log does not follow the ball" in said
    assert not out.exists()


def test_unusable_input_is_one_line_and_exit_code_2(spheremouse, film, log, tmp_path):
    empty, short, broken = (tmp_path / f"{name}.csv" for name in ("empty", "short", "broken"))
    seen = read_log(log)
    save(empty, replace(seen, counts=0.0 * seen.counts))
    keep = seen.stamp < seen.stamp[0] + 2.0
    save(short, replace(seen, stamp=seen.stamp[keep], counts=seen.counts[keep]))
    broken.write_text("t,dx,dy\n1,2\n")
    for words, what in (
        ((film, empty), f"{empty}: no motion in it"),
        ((film, short), f"{short}: has less than 8 s of motion in common"),
        ((film, broken), f"{broken}, line 2: 2 cells under 3 columns"),
        ((film, tmp_path / "no.csv"), "no such file"),
        ((tmp_path / "no", log), "no such recording"),
        ((film / "video.mkv", log), "give its rig file with --rig"),
        ((film, log, "--out", tmp_path / "no" / "x.yaml"), "there is no folder"),
        ((film, log, "--set", "motion.scale_q=1"), "unknown key"),
    ):
        assert what in spheremouse.fail("match", *words)
