"""The report of a device: what it says is what was calibrated, and the page stands alone."""

import io
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from elements import Elements
from experiments.kit.observations import calibrated, simulated_calibration
from rich.console import Console

from spheremouse.calibrate.device.advice import advise
from spheremouse.calibrate.photos import read_photos
from spheremouse.calibrate.report.device import (
    arrow_scale,
    device_json,
    photo_picture,
    print_device,
    write_device_report,
)

PROVENANCE = {"made_by": "spheremouse 9.9, calibrate device", "date": "2026-01-02T03:04:05+00:00"}


@pytest.fixture(scope="module")
def calibration():
    return calibrated(simulated_calibration(np.random.default_rng(0)))


@pytest.fixture(scope="module")
def free():
    return calibrated(simulated_calibration(np.random.default_rng(1), scale_free=True))


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photos")
    for k in range(7):
        cv2.imwrite(str(folder / f"shot <{k}> & more.png"), np.full((1080, 1920, 3), 100 + k, np.uint8))
    return read_photos([folder])


def names(photos):
    return [p.path.name for p in photos]


def written(path, calibration, photos):
    write_device_report(path, calibration, photos, PROVENANCE, advise(calibration, names(photos)))
    return path.read_text("utf-8")


def decoded(data):
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture.astype(float)


@pytest.mark.parametrize("which", ["calibration", "free"])
def test_json_is_the_calibration(which, request, photos):
    c = request.getfixturevalue(which)
    found = json.loads(json.dumps(device_json(c, names(photos), advise(c, names(photos))), allow_nan=False))
    assert np.array([t["position"] for t in found["targets"]]) == pytest.approx(c.targets)
    sigma = np.sqrt(np.diag(c.covariance))
    assert np.ravel([t["sigma"] for t in found["targets"]]) == pytest.approx(sigma[c.block("targets")])
    assert np.ravel([d["sigma"] for d in found["discs"]]) == pytest.approx(sigma[c.block("discs")])
    assert [d["photos"] for d in found["discs"]] == c.sightings.tolist()
    ball = found["ball"]
    s = np.array([ball["sigma"][axis] for axis in "XYZR"])
    assert np.array(ball["correlation"]) * np.outer(s, s) == pytest.approx(c.ball_covariance)
    assert ball["center"] == pytest.approx(c.centre)
    assert [p["file"] for p in found["photos"]] == names(photos)[:6]
    for p, pose in zip(found["photos"], c.poses, strict=True):
        assert np.array(p["T_obj_cam"]) == pytest.approx(pose.matrix())
        assert np.array(p["sigma"]) ** 2 == pytest.approx(np.diag(pose.covariance))
    assert sum(p["points"] for p in found["photos"]) == np.sum(c.measured.used)
    squares = sum(p["points"] * p["rms_px"] ** 2 for p in found["photos"])
    assert np.sqrt(squares / np.sum(c.measured.used)) == pytest.approx(found["rms_px"])
    assert found["scale_free"] is (which == "free")
    assert [a["text"] for a in found["advice"]] == [a.text for a in advise(c, names(photos))]


def test_distances_add_up_and_are_better_than_the_tape(calibration, free, photos):
    found = device_json(calibration, names(photos), advise(calibration, names(photos)))["distances"]
    assert len(found) == 4
    for d in found:
        assert d["adjusted"] - d["metres"] == pytest.approx(d["residual"], abs=1e-9)
        assert 0.3 * d["sigma"] < d["adjusted_sigma"] < d["sigma"]
    assert device_json(free, names(photos), advise(free, names(photos)))["distances"] == []


def test_text_has_radius_and_advice(calibration, photos):
    out = io.StringIO()
    print_device(calibration, advise(calibration, names(photos)), Console(file=out, width=200))
    text = out.getvalue()
    sigma = 1e3 * np.sqrt(calibration.ball_covariance[3, 3])
    assert f"{1e3 * calibration.radius:.2f} mm   ± {sigma:.2f} mm" in text
    for a in advise(calibration, names(photos)):
        assert a.text[:60] in text


@pytest.mark.parametrize("which", ["calibration", "free"])
def test_page_needs_nothing_beside_it_and_says_all(which, request, photos, tmp_path):
    pytest.importorskip("matplotlib")
    c = request.getfixturevalue(which)
    text = written(tmp_path / "r.html", c, photos)
    elements = Elements(text)
    assert all(link.startswith(("data:", "#")) for link in elements.links)
    assert elements.tags.count("svg") == 1
    assert elements.tags.count("img") == 6
    assert elements.tags.count("script") == elements.tags.count("link") == 0
    words = elements.words
    assert all(name in words for name in names(photos)[:6])  # escaped, else they would be elements
    assert all(value in words for value in PROVENANCE.values())
    assert all(
        a.text.replace("`", "") in words.replace(" target_radii ", "target_radii") for a in advise(c, names(photos))
    )
    assert text.index('class="advice"') < text.index("<table")
    assert ("from the tape" in words) is (which == "calibration")
    assert "nan" not in words


def test_a_photo_of_which_nothing_was_used_has_no_rms(calibration, photos, tmp_path):
    m = calibration.measured
    used = m.used & (m.photo != 3)
    c = replace(calibration, measured=replace(m, used=used))
    found = device_json(c, names(photos), advise(c, names(photos)))["photos"][3]
    assert (found["points"], found["rms_px"]) == (0, None)
    assert "nan" not in Elements(written(tmp_path / "r.html", c, photos)).words


def test_picture_marks_points_where_they_are_and_arrows_reach_the_prediction(calibration):
    c, m = calibration, calibration.measured
    i = int(np.flatnonzero(m.photo == 0)[0])
    far = next(k for k in np.flatnonzero(m.photo == 0) if np.linalg.norm(m.centre[k] - m.centre[i]) > 150.0)
    used, residual = m.used.copy(), m.residual.copy()
    used[i], residual[far] = False, (0.5, 0.0)
    c = replace(c, measured=replace(m, used=used, residual=residual))
    image = np.full((1080, 1920, 3), 60, np.uint8)
    picture = decoded(photo_picture(c, 0, image))
    scale = picture.shape[1] / 1920
    assert picture.shape[0] == round(1080 * scale)

    def near(at, reach=2):
        x, y = np.round(scale * at).astype(int)
        return picture[y - reach : y + reach + 1, x - reach : x + reach + 1].reshape(-1, 3)

    red = near(m.centre[i])
    assert np.max(red[:, 2] - red[:, 0]) > 80.0
    tip = m.centre[far] + arrow_scale(c, 1920) * residual[far]
    assert near(tip).max() > 180.0
    beyond = m.centre[far] + 1.4 * arrow_scale(c, 1920) * residual[far]
    assert near(beyond, 1).max() < 120.0
