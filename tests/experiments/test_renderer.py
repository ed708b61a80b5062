"""The comparison of renderers: edges of known blur, pairs of discs, sections of good, failed and missing results."""

import json

import numpy as np
import pytest
from scipy.special import ndtr

from spheremouse.ball.detect.appearance import appearance
from spheremouse.ball.truth import HIDDEN, VISIBLE, DiscTruth
from spheremouse.experiments import renderer
from spheremouse.experiments.kit.job import Request, Table
from spheremouse.experiments.report import renderer as renderer_module
from spheremouse.experiments.report.page import of_section, write_report
from spheremouse.simulate.ball.scene import default_scene

FINE = 9  # parts of a pixel's side in painted ellipses


def painted(look, size, inside, outside):
    """Ellipses of `look` on a plane, (h, w, 3), each pixel the mean over its square."""
    w, h = size
    grey = np.full((h, w), outside)
    part = (np.arange(FINE) + 0.5) / FINE - 0.5
    for c, S in zip(look.centroid, look.shape, strict=True):
        u0, v0 = np.floor(c).astype(int) - 15
        along = np.arange(30)[:, None] + part
        x, y = np.meshgrid(u0 + along.ravel() - c[0], v0 + along.ravel() - c[1])
        d = np.stack([x, y], axis=-1)
        dark = np.sum((d @ np.linalg.inv(S)) * d, axis=-1) < 1.0
        share = dark.reshape(30, FINE, 30, FINE).mean(axis=(1, 3))
        grey[v0 : v0 + 30, u0 : u0 + 30] += share * (inside - outside)
    return np.repeat(grey[:, :, None], 3, axis=2)


def truth(discs, states, area=100.0):
    n = len(discs)
    place = np.array([[10.0 * d, 5.0] for d in discs])
    return DiscTruth(np.zeros(n, int), np.array(discs), place, place, np.full(n, area), np.array(states))


def results_of(offset, area=80.0, n=40):
    """As a job gives them: ours is `offset` px off the recording, in both axes; edges are erf-shaped."""
    rows = [[0.5, area, 100.0, 100.0, 100.0 + offset, 100.0 + offset, 0.03, 100.0, 100.0, 0.04]] * n
    at = (np.arange(50) + 0.5) * 0.1 - 2.5
    edges = {name: [ndtr(at / s).tolist(), np.ones(50).tolist()] for name, s in
             (("ours", 0.3), ("Blender", 0.4), (renderer.LINEAR, 0.35))}  # fmt: skip
    job = {"frames": 3, "rows": rows, "edges": edges, "geometry": [0.0, 0.0, 0.0], "levels": [[30, 40, 190, 200]]}
    return {"far26-0": json.loads(json.dumps(job))}


@pytest.mark.parametrize(("sigma", "shift"), [(0.3, 0.0), (0.5, -0.2), (0.45, 0.15)])
def test_blur_and_middle_of_an_edge(sigma, shift):
    at = np.arange(-2.45, 2.5, 0.1)
    share = ndtr((at - shift) / sigma)
    assert renderer_module.blur_of(at, share) == pytest.approx(sigma, rel=0.02)
    assert renderer_module.middle_of(at, share) == pytest.approx(shift, abs=0.01)


def test_edges_that_are_none_have_no_blur():
    assert renderer_module.blur_of([0.0, 1.0], [0.0, 1.0]) is None
    assert renderer_module.middle_of([0.0, 1.0], [0.1, 0.2]) is None


def test_the_edge_of_painted_ellipses_is_a_pixel_wide_and_in_its_place():
    scene = default_scene(1, "far")
    a = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    directions = np.stack([0.35 * np.cos(a), 0.35 * np.sin(a), np.full(12, np.sqrt(1 - 0.35**2))], axis=1)
    look = appearance(directions, scene.rig(), scene.pose)
    sums = np.zeros((2, 50))
    renderer._add_edges(sums, painted(look, (640, 480), 30.0, 200.0), look)
    edge = renderer_module._profile(sums)
    assert renderer_module.middle_of(*edge) == pytest.approx(0.0, abs=0.02)
    assert renderer_module.blur_of(*edge) == pytest.approx(1 / np.sqrt(12), abs=0.03)
    levels = np.array(renderer._levels([painted(look, (640, 480), g, 200.0) for g in (30.0, 45.0)], look))
    assert levels == pytest.approx(np.tile([30.0, 45.0, 200.0, 200.0], (12, 1)), abs=1.0)


def test_light_is_grey_without_the_curve():
    grey = renderer._light(np.array([0.0, 188.0, 255.0]))
    assert grey == pytest.approx([0.0, 0.5 * 255.0, 255.0], abs=1.0)


def test_discs_are_paired_by_their_number_where_both_show_them():
    own, whole = renderer._whole_in_both(
        truth([1, 4, 7, 9], [VISIBLE, VISIBLE, HIDDEN, VISIBLE]),
        truth([0, 4, 7, 9], [VISIBLE, VISIBLE, VISIBLE, HIDDEN]),
    )
    assert own.disc.tolist() == whole.disc.tolist() == [4]
    small = truth([4], [VISIBLE], area=5.0)
    assert len(renderer._whole_in_both(truth([4], [VISIBLE]), small)[1]) == 0


def test_a_disc_without_a_detection_is_nan():
    found = renderer.Detections(np.array([[11.0, 5.0]]), np.array([0.09 * np.eye(2)]), np.array([80.0]))
    at = renderer._measured(found, np.array([[10.0, 5.0], [40.0, 5.0]]))
    assert at[0] == pytest.approx([11.0, 5.0, 0.3])
    assert np.all(np.isnan(at[1]))


@pytest.mark.parametrize(("offset", "word"), [(0.03, "It is reached."), (0.2, "It is missed")])
def test_a_section_says_whether_what_is_asked_is_reached(offset, word, tmp_path):
    section = renderer_module.section(Request(True, tmp_path), results_of(offset))
    page = write_report(tmp_path, {"renderer": of_section(renderer.TITLE, section)}, {}, "x")[0].read_text()
    assert word in page
    assert f"differ by {offset:.3f} px RMS" in page
    assert section.figures["blur_px"]["Blender"] == pytest.approx(0.4, rel=0.02)
    assert (tmp_path / "experiments" / "renderer-light.svg").stat().st_size > 5000


def test_of_the_missed_it_is_counted_who_makes_the_difference():
    rows = np.zeros((13, 10))
    rows[:, 0], rows[:, 1] = 0.9, 20.0
    rows[:, 4] = 0.1  # ours off by that in u
    rows[:3, 4] = 1.0
    rows[12, :2] = 0.2, 80.0  # large, near the middle: reached
    said = renderer_module._of_missed(rows, [{"low": 10.0, "high": 30.0}])
    assert "The 12 discs of the missed classes lie at 0.90" in said
    assert f"the 3 worst of them make {100 * 3.0 / 3.09:.0f} %" in said
    assert f"off the truth by 0.000 px there, ours by {np.sqrt(3.09 / 24):.3f} px" in said


def test_where_no_disc_is_found_in_both_nothing_is_said_of_classes(tmp_path):
    given = results_of(0.03)
    given["far26-0"]["rows"] = [[0.5, 80.0, 100.0, 100.0, *[None] * 6]]
    text = str(renderer_module.section(Request(True, tmp_path), given).parts)
    assert "No disc was found in both." in text
    assert "missed" not in text


def test_without_the_recording_nothing_is_done_and_that_is_said(tmp_path):
    assert renderer.jobs(Request(False, None)) == []
    assert "not at hand" in str(renderer_module.section(Request(False, None), {}).parts)
    failed = {j.key: {"error": "no such folder"} for j in renderer.jobs(Request(True, tmp_path))}
    parts = renderer_module.section(Request(True, tmp_path), failed).parts
    assert "no such folder" in str(parts)
    assert not any(isinstance(p, Table) for p in parts)


def test_jobs_share_the_frames():
    work = renderer.jobs(Request(False, renderer.Path("sets")))
    frames = [k for j in work for k in range(j.parameters["first"], 300, j.parameters["step"])]
    assert sorted(frames) == list(range(0, 300, 2))


def test_large_discs_of_the_reference_recording_agree(far26):
    found = renderer.compared(str(far26), 0, 150)
    rows = np.array([r for r in found["rows"] if None not in r])
    large = rows[rows[:, 1] >= 60.0]
    assert len(large) >= 3
    assert np.sqrt(np.mean((large[:, 4:6] - large[:, 7:9]) ** 2)) < 0.05
    assert max(found["geometry"][:2]) < 0.01
