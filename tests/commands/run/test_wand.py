"""`run --tracker wand` as a user meets it: on a small film with exact truth; commands in, text out."""

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import write_video
from experiments.kit.balls import contrast_ball
from scipy.spatial.transform import Rotation

from spheremouse.errors import ConfigurationError
from spheremouse.files.dataset.wand import open_wand
from spheremouse.files.rig import save_camera
from spheremouse.files.wand import save_wand
from spheremouse.session.run_config import CommandLineOverrides, check_kinds, read_run_config
from spheremouse.simulate.to_dataset import write_wand
from spheremouse.simulate.wand.film import WandOptions, prepare_wand
from spheremouse.wand.axes import UPRIGHT
from spheremouse.wand.ball import grzonka_ball
from spheremouse.wand.settings import ColourSettings

WAND = ("run", "--tracker", "wand")


def film(path, **options):
    given = {"seed": 3, "fps": 20.0, "seconds": 2.0, "size": (480, 360), **options}
    list(write_wand(path, prepare_wand(WandOptions("hand", **given))))
    return path


@pytest.fixture(scope="module")
def hand(tmp_path_factory):
    return film(tmp_path_factory.mktemp("wand") / "hand")


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    return film(tmp_path_factory.mktemp("wand") / "two", balls=2, seconds=1.0)


@pytest.fixture(scope="module")
def camera(hand):
    path = hand.parent / "camera.yaml"
    save_camera(path, open_wand(hand).camera)
    return path


def read(text):
    """Samples as arrays by their keys, and `sigma`, (n, 3) m, of the position; NaN where nothing is known."""
    samples = [json.loads(line) for line in text.splitlines()]
    none = {key: np.full(3, np.nan) for key in ("position", "yaw_pitch_roll", "counts")}
    none |= {"position_covariance": np.full((3, 3), np.nan), "stamp": np.nan, "ball": np.nan}
    table = {key: np.array([empty if s[key] is None else s[key] for s in samples]) for key, empty in none.items()}
    return table | {"sigma": np.sqrt(np.diagonal(table["position_covariance"], axis1=1, axis2=2))}


def test_six_axes_are_those_of_the_truth(spheremouse, hand):
    out, err = spheremouse.succeed(*WAND, "--source", f"dataset:{hand}", "--output", "text:-")
    said = err.splitlines()
    assert said[0] == "ball: grzonka, 100 mm across, 8 discs"
    assert said[1].endswith("tracking: grzonka is followed")
    table, truth = read(out), open_wand(hand).truth
    assert table["stamp"].tolist() == truth.stamp.tolist()
    # the same angles by other means: SciPy's, of a turn that begins with the upright ball
    pitch, roll, yaw = Rotation.from_matrix(truth.rotation @ UPRIGHT.T).as_euler("XZY", degrees=True).T
    error = np.degrees(table["yaw_pitch_roll"]) - np.stack([yaw, pitch, roll], axis=1)
    error = (error + 180.0) % 360.0 - 180.0
    assert np.abs(error).max() < 10.0
    error = table["position"] - truth.position
    assert np.abs(error / table["sigma"]).max() < 6.0
    assert np.abs(error).max() < 0.05
    assert np.ptp(yaw) > 40.0  # it did turn


@pytest.mark.parametrize("by", ["turn", "shift"])
def test_the_pointer_is_the_integral_of_the_true_motion(spheremouse, hand, by):
    words = ("--source", f"dataset:{hand}", "--output", "text:", "--set", f"wand.pointing.by={by}")
    table, truth = read(spheremouse(*WAND, *words)[1]), open_wand(hand).truth
    sums = np.cumsum(table["counts"], axis=0)
    if by == "turn":
        R = Rotation.from_matrix(truth.rotation)
        way = np.vstack([np.zeros(3), np.cumsum((R[1:] * R[:-1].inv()).as_rotvec(), axis=0)])
        true = 1800 * np.stack([way[:, 1], way[:, 0], -way[:, 2]], axis=1)  # the holder faces the camera
        sigma = np.radians(2.0)
    else:
        true = 4800 * (truth.position - truth.position[0]) * (-1, 1, -1)
        sigma = table["sigma"]
    # at either end the pose is off by 3 sigma at most; play takes up 2
    assert (np.abs(sums - true) <= 8.0 * (1800 if by == "turn" else 4800) * sigma + 1.0).all()
    assert np.abs(true[:, 0]).max() > 200
    assert np.corrcoef(sums[:, 0], true[:, 0])[0, 1] > 0.99


def test_samples_may_go_beside_the_pointer_and_the_configuration_may_say_all(spheremouse, hand, camera, tmp_path):
    source, log = ("--source", f"dataset:{hand}", "--frames", 5), tmp_path / "samples.jsonl"
    out, _ = spheremouse.succeed(*WAND, *source, "--output", "text:-")
    assert spheremouse(*WAND, *source, "--output", "null", "--output", f"text:{log}")[:2] == (0, "")
    assert log.read_text() == out
    save_wand(tmp_path / "ball.yaml", grzonka_ball())
    log.unlink()
    file = tmp_path / "config.yaml"
    file.write_text(
        f"schema: 2\ntracker: wand\nsource: dataset:{hand}\noutput: ['null', 'text:{log}']\ncamera_file: {camera}\n"
        "wand: {balls: [ball.yaml], pointing: {by: shift}}\n"
    )
    spheremouse.succeed("run", "--config", file, "--frames", 5)
    poses, expected = ([json.loads(line)["position"] for line in text.splitlines()] for text in (log.read_text(), out))
    assert poses == [pytest.approx(position, abs=1e-9) for position in expected]
    file.write_text(file.read_text().replace("by: shift", "by: shove"))
    assert f"{file}:6: wand.pointing.by: must be 'turn' or 'shift'" in spheremouse.fail("run", "--config", file)


def test_several_balls_and_which_of_them_points(spheremouse, two, tmp_path):
    words = (*WAND, "--source", f"dataset:{two}", "--output", "text:-", "--set", "wand.points=2")
    out, err = spheremouse.succeed(*words)
    table, truths = read(out), open_wand(two).truths
    assert "tracking: grzonka 2 is followed" in err
    followed = []
    for k in range(2):
        mine = np.flatnonzero(table["ball"] == k + 1)
        off = [np.nanmedian(np.abs(table["position"][mine] - t.position), axis=0) for t in truths]
        followed.append(int(np.argmin([np.linalg.norm(o) for o in off])))
        assert off[followed[-1]].max() < 0.02
        assert table["counts"][mine].any() == (k == 1)
    assert sorted(followed) == [0, 1]  # balls that look alike are counted as they are found
    save_wand(tmp_path / "one.yaml", grzonka_ball())
    _, err = spheremouse.succeed(
        *WAND, "--source", f"dataset:{two}", "--output", "null", "--ball", tmp_path / "one.yaml"
    )
    assert err.count("a second ball like grzonka is in view: declare it too, or take it away") == 1


def test_a_declared_ball_that_is_never_found_is_told_at_the_end(spheremouse, hand, tmp_path):
    save_wand(tmp_path / "ball.yaml", grzonka_ball())
    two = ("--ball", tmp_path / "ball.yaml") * 2
    words = (*WAND, "--source", f"dataset:{hand}", "--output", "null", "--frames", 3, *two)
    _, err = spheremouse.succeed(*words)
    last = err.splitlines()[-1]
    assert last.startswith("grzonka 2 was never found: no ball like grzonka 2 in view: hold it into the picture")
    code, _, err = spheremouse(*words, "--set", "wand.points=2")
    assert code == 2
    assert "was never found" not in err  # the error says so
    assert err.splitlines()[-1].startswith(f"spheremouse: dataset:{hand}: no ball like grzonka 2 in view")


def refused(result):
    code, _, err = result
    lines = [line for line in err.splitlines() if line.startswith("spheremouse: ")]
    assert (code, len(lines)) == (2, 1), err
    return lines[0].removeprefix("spheremouse: ")


def test_what_does_not_go_together_is_refused(spheremouse, hand, camera, tmp_path):
    source = ("--source", f"dataset:{hand}")
    video = ("--source", f"video:{hand / 'video.mkv'}", "--output", "null")
    for words, reason in (
        ((*source, "--output", "null", "--ball", "nix.yaml"), "nix.yaml: no such file; check the path"),
        (video, f"video:{hand / 'video.mkv'}: has no description of the camera; give its file with --camera FILE"),
        ((*source, "--output", "text:-", "--output", "text:-"), "output: text:- is given twice; leave one out"),
        (("--source", "synthetic", "--output", "null"), "synthetic: simulates no wand; film one with"),
        ((*source, "--output", "null", "--set", "wand.points=2"), "wand.points: is 2, but there is one ball"),
        (("--source", f"dataset:{tmp_path}", "--output", "null"), f"{tmp_path / 'scene.json'}: missing"),
    ):
        assert refused(spheremouse(*WAND, *words)).startswith(reason)
    words = ("run", *source, "--output", "null")
    assert refused(spheremouse(*words)).endswith("this is a recording of a wand; use --tracker wand")
    assert camera.exists()


def test_balls_that_disagree_about_a_colour_are_refused(spheremouse, hand, tmp_path):
    save_wand(tmp_path / "a.yaml", contrast_ball())
    save_wand(tmp_path / "b.yaml", replace(contrast_ball(), name="other"), {"dark": ColourSettings(value_max=50.0)})
    words = ("--source", f"dataset:{hand}", "--output", "null")
    said = refused(spheremouse(*WAND, *words, "--ball", tmp_path / "a.yaml", "--ball", tmp_path / "b.yaml"))
    assert said.startswith(f"{tmp_path / 'b.yaml'}: colours.dark: other bounds than in {tmp_path / 'a.yaml'}")


def test_a_film_without_the_ball_ends_in_words(spheremouse, camera, tmp_path):
    rng = np.random.default_rng(0)
    room = rng.integers(60, 140, (360, 480, 3), dtype=np.uint8)
    room[50:75, 50:400] = (30, 30, 190)  # a red shelf and a blue curtain
    room[100:360, 420:] = (190, 60, 30)
    words = (*WAND, "--camera", camera, "--output", "null", "--source")
    said = refused(spheremouse(*words, write_video(tmp_path / "room.avi", [room] * 4, "MJPG")))
    assert "no ball like grzonka in view: hold it into the picture" in said
    assert said.endswith("(looked for in 4 frames)")
    grey = np.repeat(room[:, :, :1], 3, axis=2)
    said = refused(spheremouse(*words, write_video(tmp_path / "grey.avi", [grey] * 4, "MJPG")))
    assert "(the frames are grey, or dark)" in said
    said = refused(spheremouse(*words, write_video(tmp_path / "small.avi", [room[:240, :320]] * 4, "MJPG")))
    assert said.startswith("frame 0 is 320x240, the camera was calibrated at 480x360: set the camera to that mode")


def test_a_running_daemon_does_not_become_another_program():
    """`ctl reload` and `ctl set` go through this."""
    before, after = (
        read_run_config(CommandLineOverrides(None, (f"tracker={t}", "source=opencv:0", "output=null")))
        for t in ("so3", "wand")
    )
    check_kinds(after)
    for a, b in ((after, before), (before, after)):
        with pytest.raises(ConfigurationError, match="stop this run and start again"):
            check_kinds(a, b)
