"""Sizes, places, hands: layouts are what they are called; tiny films; sections of given, lost and missing results."""

import json

import numpy as np
import pytest

from spheremouse.experiments import discs
from spheremouse.experiments.discs import HANDS, LAYOUTS, SIZES, directions_of, in_rows, jobs
from spheremouse.experiments.kit.job import Figure, Request, Table
from spheremouse.experiments.report.discs import section
from spheremouse.experiments.report.page import write_report

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
    return film(error, lost, in_view=5, contradictions=4.0, recognised=recognised, mistaken=0.0)


def results():
    return {
        "size-4-0": nothing(),
        "size-8-0": film(0.024),
        "size-14-0": film(0.02),
        "size-14-1": film(0.022),
        "size-30-0": film(0.06),
        "layout-spread-0": laid(0.02, 1.0),
        "layout-rows-0": laid(0.015, 0.1),
        "layout-cluster-0": laid(0.5, 1.0, lost=1),
        "hands-none-0": film(0.02),
        "hands-two-0": {**film(0.05), "in_view_share": 0.4},
        "hands-two_very_large-0": {**film(3.0), "in_view_share": 0.2},
        "size-20-0": {"error": "too dark"},
    }


def words(found):
    return "\n".join(part for part in found.parts if isinstance(part, str))


def tables(found):
    return [part for part in found.parts if isinstance(part, Table)]


@pytest.mark.parametrize("kind", [k for k in LAYOUTS if k != "designed"])
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


def test_the_advice_is_the_smallest_disc_that_is_nearly_as_good_as_the_best(tmp_path):
    found = section(WHOLE, results())
    text = words(found)
    assert "holds the ball in all films with 8, 14, 30 mm (8 mm are 7.0 px across" in text  # 20 failed
    assert "best with 14 mm (0.0210°)" in text
    assert "Advice: a radius of 8 mm" in text
    assert "With 30 mm it is worse again (0.0600°)" in text
    assert "size-20-0: too dark" in text
    rows = tables(found)[0].rows
    assert rows[0] == ("4", "1", "3.0", "60 %", "–", "–", "`ekf1`", "lost", "lost", "1 of 1")
    assert rows[8][:2] == ("14", "2")
    assert rows[10] == (*[""] * 6, "`so3`", "0.0210", "0.210", "0 of 2")
    assert rows[11] == (*[""] * 6, "bound", "0.0105", "0.105", "")
    assert rows[12][:2] == ("20", "failed")
    page = write_report(tmp_path, {"discs": (discs.TITLE, found)}, "x")[0].read_text()
    assert "rows: in rows" in page
    for name in ("discs-size", "discs-layout", "discs-hands"):
        assert (tmp_path / "experiments" / f"{name}-dark.svg").stat().st_size > 5000


def test_a_layout_that_is_lost_or_ambiguous_is_not_advised():
    text = words(section(WHOLE, results()))
    assert "It is lost with: cluster (1 of 1)." in text
    assert "with: rows (10.0 %)." in text
    assert "of those tried, *spread* is never lost and recognised" in text
    assert "the attitude is best with *rows* (0.0150°) and worst with *spread* (0.0200°)" in text
    assert "random: random" not in str(section(WHOLE, {"layout-random-0": laid(0.02, 1.0)}).parts)
    assert "worst" not in words(section(WHOLE, {"layout-random-0": laid(0.02, 1.0)}))


def test_what_is_lost_has_no_error_and_failures_are_counted():
    given = {"hands-none-0": film(88.0), "hands-none-1": film(0.02), "hands-none-2": {"error": "too dark"}}
    (table,) = tables(section(WHOLE, given))
    assert table.rows[0][1] == "1 of 3 failed"
    assert table.rows[0][4:] == ("`ekf1`", "lost", "lost", "1 of 2")
    assert "88" not in str(table.rows)


def test_hands_are_borne_down_to_the_share_at_which_the_attitude_gets_away():
    text = words(section(WHOLE, results()))
    assert "two (40 % wholly in view): 2.5 times the error without" in text
    assert "two very large (20 % wholly in view): lost in 1 of 1 films" in text
    assert "40 % of the discs on its side or more stay wholly in view" in text
    gap = {**results(), "hands-one-0": {**film(3.0), "in_view_share": 0.5}}
    assert "60 % of the discs on its side or more" in words(section(WHOLE, gap))  # one is lost, though two is not


def test_a_camera_without_pose_is_a_row_that_says_so():
    unfound = {"frames": 9, "in_view_share": 0.5, "diameter_px": 7.0, "rows": {}, "bound": None, "unfound": "no target"}
    found = section(WHOLE, {"hands-two-0": unfound, "hands-none-0": film(0.02)})
    assert "hands-two-0: no target" in words(found)
    assert next(r for r in tables(found)[0].rows if r[0] == "two")[-3:] == ("lost", "lost", "1 of 1")


def test_a_section_without_results_has_no_figure():
    for given in ({}, {job.key: {"error": "too little memory"} for job in jobs(QUICK)}):
        found = section(QUICK, given)
        assert not [p for p in found.parts if isinstance(p, Figure | Table)]
        assert ("too little memory" in words(found)) == bool(given)


def test_jobs_are_sizes_layouts_and_hands():
    keys = [job.key for job in jobs(WHOLE)]
    assert len(set(keys)) == len(keys)
    assert len(keys) == 3 * (len(SIZES) + len(HANDS)) + 2 * len(LAYOUTS)
    assert 3 <= len(jobs(QUICK)) < 6
