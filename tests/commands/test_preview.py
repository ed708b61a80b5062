"""`spheremouse preview` on films with known faults."""

import json

import cv2
import numpy as np
import pytest

from spheremouse.files.rig import rig_text
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate


@pytest.fixture(scope="module")
def shot():
    film = prepare(SimulationOptions(motion="rest", seconds=0.1))
    return next(iter(simulate(film))).frame.image, film.scene.rig()


def film_of(path, image):
    out = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 30.0, (image.shape[1], image.shape[0]))
    for _ in range(2):
        out.write(image)
    out.release()
    return f"video:{path}"


def test_the_picture_marks_the_targets_and_the_json_lists_them(spheremouse, shot, tmp_path):
    image, rig = shot
    source = film_of(tmp_path / "f.avi", image)
    code, out, err = spheremouse("preview", source, "--out", tmp_path / "p.png", "--json")
    assert (code, err) == (0, "")
    seen = json.loads(out)
    assert {t["code"] for t in seen["targets"]} == set(rig.targets.codes)
    assert (seen["size"], seen["colour"], seen["strangers"]) == ([640, 480], True, [])
    assert seen["blur_px"] < 0.5
    assert seen["spots"] > 5
    drawn = cv2.imread(str(tmp_path / "p.png"))
    assert drawn is not None
    assert drawn.shape == (960, 1280, 3)
    green = np.abs(drawn.astype(int) - (90, 220, 60)).max(axis=2) < 30
    for t in seen["targets"]:
        u, v = (round(2 * x) for x in t["place_px"])
        assert green[v - 40 : v + 41, u - 40 : u + 41].sum() > 100


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda i: (0.2 * i).astype(np.uint8), ("0 targets", "refused     CMY: too dark or too pale; more light")),
        (lambda i: cv2.GaussianBlur(i, (0, 0), 3.0), ("sharpness   blurred", "focus the lens")),
        (lambda i: cv2.cvtColor(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR), ("0 targets",)),
        (lambda i: i, ("4 targets: ", "sharpness   sharp", "refused     M in C, no third colour")),
    ],
)
def test_each_fault_is_reported_with_its_remedy(spheremouse, shot, tmp_path, change, words):
    source = film_of(tmp_path / "f.avi", change(shot[0]))
    code, out, err = spheremouse("preview", source, "--out", tmp_path / "p.png")
    assert (code, err) == (0, "")
    for each in words:
        assert each in out


def test_a_rig_of_another_device_is_reported(spheremouse, shot, tmp_path):
    image, rig = shot
    (tmp_path / "rig.yaml").write_text(rig_text(rig).replace(rig.targets.codes[0], "YCM"))
    source = film_of(tmp_path / "f.avi", image)
    _, out, _ = spheremouse("preview", source, "--out", tmp_path / "p.png", "--rig", tmp_path / "rig.yaml")
    assert f"3 of the rig's 4 targets: {' '.join(rig.targets.codes[1:])}; not in the rig: {rig.targets.codes[0]}" in out


def test_an_error_is_one_line_and_leaves_no_file(spheremouse, shot, tmp_path):
    source = film_of(tmp_path / "f.avi", shot[0])
    before = sorted(tmp_path.iterdir())
    for words, said in (
        ((source, "--at", "9"), "gave no frame from 9 s on: give a smaller --at"),
        ((source, "--out", tmp_path / "f.avi"), "is not a picture; end its name in .png"),
        ((source, "--out", tmp_path / "none" / "p.png"), "cannot be written"),
        (("video:/nowhere",), "no such file"),
        ((source, "--set", "rings.nix=1"), "unknown key"),
    ):
        out = () if "--out" in words else ("--out", tmp_path / "p.png")
        code, text, err = spheremouse("preview", *words, *out)
        assert (code, text, len(err.splitlines())) == (2, "", 1)
        assert said in err
    assert sorted(tmp_path.iterdir()) == before
