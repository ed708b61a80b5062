"""Sizes, places, hands: layouts are what they are called; tiny films; pages of given, lost and missing results."""

import json

import numpy as np
import pytest
from experiments import discs
from experiments.discs import HANDS, LAYOUTS, SIZES, directions_of, in_rows, jobs
from experiments.kit.job import Request
from experiments.report.discs import page
from experiments.report.page import said
from experiments.report.plot import save

QUICK, WHOLE = Request(True, None), Request(False, None)


def film(error, lost=0, tracked=60, **more):
    axes = {"x": error, "y": error, "z": error, "combined": error}
    row = {"frames": 60, "tracked": tracked, "lost_episodes": lost, "mean_discs": 5.0, "attitude_rmse_deg": axes,
           "rate_rmse_deg_s": {k: 10 * v for k, v in axes.items()}, "detection": {"centre_rms_px": error}}  # fmt: skip
    bound = {"attitude_deg": {"combined": 0.5 * error}, "rate_deg_s": {"combined": 5.0 * error}}
    rows = dict.fromkeys(("ekf1", "ekf2", "so3"), row)
    return {"frames": 60, "in_view_share": 0.6, "diameter_px": 7.0, "rows": rows, "bound": bound, **more}


def nothing():
    row = {"frames": 60, "tracked": 0, "lost_episodes": 0, "mean_discs": None, "attitude_rmse_deg": {"combined": None},
           "rate_rmse_deg_s": {"combined": None}, "detection": None}  # fmt: skip
    rows = dict.fromkeys(("ekf1", "ekf2", "so3"), row)
    return {"frames": 60, "in_view_share": 0.6, "diameter_px": 3.0, "rows": rows, "bound": None}


def laid(error, recognised, lost=0):
    return film(error, lost, in_view=5, recognised=recognised, mistaken=0.0)


def results():
    """What bears out all that is claimed."""
    errors = {"8": 0.03, "10": 0.028, "14": 0.027, "20": 0.02, "30": 0.03}
    sizes = {f"size-{mm}-0": film(error) for mm, error in errors.items()}
    certain = {"designed": 1.0, "spread": 1.0, "even": 0.0, "rows": 0.1, "random": 0.95}
    layouts = {name: laid({"even": 0.01, "random": 0.03}.get(name, 0.02), share) for name, share in certain.items()}
    shares = {"none": 0.6, "one": 0.5, "two": 0.45, "two_large": 0.4}
    return {
        "size-4-0": nothing(),
        "size-6-0": film(3.0),
        **sizes,
        "size-20-1": film(0.022),
        **{f"layout-{name}-0": result for name, result in layouts.items()},
        "layout-cluster-0": laid(0.5, 0.98, lost=1),
        **{f"hands-{name}-0": film(0.01 / share, in_view_share=share) for name, share in shares.items()},
        "hands-two_very_large-0": film(3.0, in_view_share=0.2),
        "hands-none-1": {"error": "too dark"},
    }


def rows(text, title):
    """The cells of the table under a heading."""
    lines = text.partition(f"### {title}")[2].partition("\n| ")[2].partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


@pytest.mark.parametrize("kind", list(LAYOUTS))
def test_layouts_are_unit_vectors_without_overlap(kind):
    d = directions_of(kind, 3)
    assert d.shape == (discs.DISCS, 3)
    assert np.linalg.norm(d, axis=1) == pytest.approx(np.ones(len(d)))
    apart = np.arccos(np.clip(d @ d.T - 2.0 * np.eye(len(d)), -1.0, 1.0))
    assert np.min(apart) > 2.0 * 0.02 / 0.6  # two radii: they do not touch
    if kind != "cluster":
        assert np.linalg.norm(d.mean(axis=0)) < 0.35  # all over the ball
    else:
        assert np.all(d[:, 2] > np.cos(np.radians(75.0)))


def test_rows_are_symmetric_under_half_a_turn_upside_down():
    d = in_rows()
    turned = d * (1.0, -1.0, -1.0)  # half a turn about x
    assert np.max(np.min(np.linalg.norm(turned[:, None] - d[None], axis=2), axis=1)) < 1e-9


def test_an_irregular_layout_is_recognised_and_a_regular_one_is_not():
    recognised, mistaken = discs.recognition(directions_of("designed", 1))
    assert recognised > 0.98
    assert mistaken == 0.0
    g = (1 + np.sqrt(5)) / 2
    icosahedron = np.array([np.roll([0, a, b * g], k) for a in (-1, 1) for b in (-1, 1) for k in range(3)])
    assert discs.recognition(icosahedron / np.hypot(1, g))[0] == 0.0


def test_a_larger_disc_is_seen_larger_and_followed():
    small, large = (json.loads(json.dumps(discs.of_size(mm, 0, 4))) for mm in (10, 20))
    assert large["diameter_px"] == pytest.approx(2.0 * small["diameter_px"])
    assert large["diameter_px"] == pytest.approx(640.0 * 0.04 / 1.75)
    for result in (small, large):
        assert result["rows"]["so3"]["tracked"] == 4
        assert result["bound"]["attitude_deg"]["combined"] < 0.1


def test_hands_hide_discs():
    free, hidden = (discs.with_hands(kind, 0, 24) for kind in ("none", "two very large"))
    assert hidden["in_view_share"] < 0.75 * free["in_view_share"]
    assert hidden["rows"]["so3"]["frames"] == 3  # from half a second after they came


def test_films_of_a_case_come_together_and_what_is_lost_has_no_error():
    text = said("discs", page, results()).text
    sizes = rows(text, "Size")
    assert [row[0] for row in sizes[::4]] == ["4", "6", "8", "10", "14", "20", "30"]
    assert sizes[0] == ["4", "1", "3.0", "60", "–", "–", "`ekf1`", "lost", "lost", "1 of 1"]
    assert sizes[20] == ["20", "2", "7.0", "60", "5.0", "0.021", "`ekf1`", "0.0210", "0.210", "0 of 2"]
    assert sizes[23] == [*[""] * 6, "bound", "0.0105", "0.105", ""]
    assert rows(text, "Places")[12][:6] == ["rows: in rows", "1", "5.0", "10.0", "0.0", "5.0"]
    assert rows(text, "Places")[16][0] == "random"
    hands = rows(text, "Hands")
    assert [row[0] for row in hands[::4]] == list(HANDS)
    assert hands[18] == [*[""] * 4, "`so3`", "lost", "lost", "1 of 1"]
    assert "is 1.2 times that without hands with one hand, 1.3 times with two and 1.5 times" in text
    assert "- hands-none-1: too dark" in text


@pytest.mark.parametrize(
    ("key", "result", "doubts"),
    [
        ("size-6-1", film(0.5), 0),  # lost in one of two
        ("size-6-0", film(0.5), 1),  # held as well
        ("size-10-1", film(0.028, tracked=50), 1),  # lost
        ("size-30-0", film(0.021), 1),  # as good as 20 mm
        ("size-14-0", film(0.024), 1),
        ("size-14-0", film(0.019), 2),
        ("layout-rows-0", laid(0.02, 0.1, lost=1), 1),
        ("layout-spread-0", laid(0.009, 1.0), 1),
        ("layout-even-0", laid(0.01, 0.97), 1),
        ("layout-cluster-0", laid(0.5, 1.0, lost=1), 1),
        ("layout-designed-0", laid(0.02, 0.98), 1),
        ("hands-one-0", film(0.05), 1),
        ("hands-two_very_large-0", film(0.5), 1),
        ("hands-two-0", film(0.01 / 0.45, lost=1), 1),
    ],
)
def test_a_claim_that_is_contradicted_is_marked(key, result, doubts):
    given = results()
    assert said("discs", page, given).doubts == 0
    assert said("discs", page, {**given, key: result}).doubts == doubts


def test_a_film_in_which_no_pose_was_found_is_lost_and_said():
    unfound = {"frames": 9, "in_view_share": 0.5, "diameter_px": 7.0, "rows": {}, "bound": None, "unfound": "no target"}
    text = said("discs", page, {"hands-two-0": unfound, "hands-none-0": film(88.0), "hands-none-1": film(0.02)}).text
    assert "hands-two-0 (no target)" in text
    assert [row[-3:] for row in rows(text, "Hands")[::4]] == [["lost", "lost", "1 of 2"], ["lost", "lost", "1 of 1"]]


def test_figures_draw_and_those_of_what_is_missing_are_left_out(tmp_path):
    whole = said("discs", page, results()).drawings
    assert [drawing.name for drawing in whole] == ["discs-size", "discs-layout", "discs-hands"]
    for drawing in whole:
        assert save(drawing, tmp_path).stat().st_size > 5000
    assert [d.name for d in said("discs", page, {"size-6-0": film(0.02)}).drawings] == ["discs-size"]


def test_jobs_are_sizes_layouts_and_hands():
    keys = [job.key for job in jobs(WHOLE)]
    assert len(set(keys)) == len(keys)
    assert len(keys) == 3 * (len(SIZES) + len(HANDS)) + 2 * len(LAYOUTS)
    assert 3 <= len(jobs(QUICK)) < 6
