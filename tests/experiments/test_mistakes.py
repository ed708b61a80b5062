"""Wrong calibrations: rigs, what becomes of the mouse, and pages made from given results, missing and failed ones."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from spheremouse.experiments import mistakes
from spheremouse.experiments.kit import tour
from spheremouse.experiments.kit.job import Figure, Request, Table
from spheremouse.experiments.mistakes import FREE, KINDS, TOLD, jobs, wrong
from spheremouse.experiments.report import mistakes as mistakes_module
from spheremouse.experiments.report.mistakes import section
from spheremouse.experiments.report.page import write_report
from spheremouse.geometry.camera import project
from spheremouse.simulate.ball.scene import default_scene
from spheremouse.tracker import Status

QUICK, WHOLE = Request(True, None), Request(False, None)
RIG = default_scene().rig()


@pytest.fixture(scope="module")
def film():
    return tour.filmed({}, 1, 1.2)


def row(error, lost=0, **more):
    mouse = {"scale": -5.0 * error, "direction": error, "spin": 0.1, "wobble": error, **more}
    return {"attitude": error, "rate": 10.0 * error, "lost": lost, "tracked": 95, "frames": 100, **mouse}


def cell(error, lost=0):
    return {"rows": {name: row(error, lost if name == "so3" else 0) for name in ("ekf1", "ekf2", "so3", FREE, TOLD)}}


def film_of(**found):
    right = {"right": cell(0.1), "bound": {"attitude": 0.01, "rate": 0.2}, "edge": 1.2}
    return {"mistakes": found, "moved": {"rms": 40.0, "peak": 80.0, "acceleration": 3.0}, **right}


def results():
    return {
        "camera-1": film_of(
            focal={"-0.05": [cell(0.5)], "-0.01": [cell(0.2)], "0.01": [cell(0.2)], "0.05": [cell(0.5, lost=1)]},
            radius={"0.01": [cell(3.0)], "-0.01": [{"error": "the ball is not in the picture"}]},
        ),
        "places-1": {"error": "too little memory"},
        "lens-0.1-1": film_of(lens={"0.1": [cell(0.4)]}, evening={"1": [cell(0.5), {"error": "no pose"}]}),
        "lens-0.1-2": film_of(lens={"0.1": [cell(0.6)]}, evening={"1": [cell(1.5), cell(9.0)]}),
    }


def words(found):
    return "\n".join(part for part in found.parts if isinstance(part, str))


def tables(found):
    return {part.title.removesuffix(" (medians)"): part for part in found.parts if isinstance(part, Table)}


# ---- wrong rigs ----


def test_each_mistake_is_of_the_size_that_it_says_and_alone():
    assert wrong(RIG, "focal", 0.05, 1).camera.fx == pytest.approx(1.05 * RIG.camera.fx)
    assert wrong(RIG, "radius", -0.01, 1).ball.radius == pytest.approx(0.59)
    shift = wrong(RIG, "centre", 0.02, 1).targets.position - RIG.targets.position
    assert_allclose(shift, np.tile(shift[0], (4, 1)))
    assert np.linalg.norm(shift[0]) == pytest.approx(0.02)
    off = np.concatenate([(wrong(RIG, "targets", 0.01, k).targets.position - RIG.targets.position) for k in range(200)])
    assert np.std(off) == pytest.approx(0.01, rel=0.05)
    for name in ("radius", "centre", "targets"):
        assert wrong(RIG, name, 0.01, 1).camera is not RIG.camera
        assert wrong(RIG, name, 0.01, 1).camera.intrinsic == RIG.camera.intrinsic
    assert_array_equal(wrong(RIG, "focal", 0.05, 1).targets.position, RIG.targets.position)


def test_a_mistake_says_nothing_of_itself_and_comes_again():
    for name in KINDS:
        one, two, other = (wrong(RIG, name, 0.01, draw) for draw in (1, 1, 2))
        assert not np.any(one.targets.covariance)
        assert not np.any(one.ball.covariance)
        assert_array_equal(one.targets.position, two.targets.position)
        if name in ("centre", "targets", "evening"):
            assert np.any(one.targets.position != other.targets.position)


def test_an_evening_has_all_mistakes_in_proportion():
    rigs = [wrong(RIG, "evening", 2.0, k) for k in range(400)]
    sigma = mistakes.EVENING
    assert np.std([r.camera.fx / RIG.camera.fx - 1.0 for r in rigs]) == pytest.approx(2.0 * sigma["focal"], rel=0.15)
    assert np.std([r.ball.radius for r in rigs]) == pytest.approx(2.0 * sigma["radius"], rel=0.15)
    assert np.std([r.camera.cx for r in rigs]) == pytest.approx(2.0 * sigma["principal"], rel=0.15)
    both = np.hypot(sigma["centre"], sigma["targets"])
    assert np.std([r.targets.position[2, 1] for r in rigs]) == pytest.approx(2.0 * both, rel=0.15)
    said = mistakes.told(RIG, 2.0)
    assert np.sqrt(said.targets.covariance[4, 4]) == pytest.approx(2.0 * both)
    assert np.sqrt(said.ball.covariance[3, 3]) == pytest.approx(2.0 * sigma["radius"])


def test_a_lens_that_is_left_out_is_flat():
    bent = replace(RIG, camera=replace(RIG.camera, distortion=np.array([-0.2, 0.0, 0.0, 0.0, 0.0])))
    flat = wrong(bent, "lens", 0.2, 1)
    assert not np.any(flat.camera.distortion)
    assert np.any(bent.camera.distortion)


def test_the_lens_at_the_edge_of_the_ball_is_where_it_bends_the_outline(film):
    pose, camera = film.truth.pose, film.rig.camera
    far, radius = np.linalg.norm(pose.position), film.rig.ball.radius
    limb = np.array([0.0, np.cos(np.arcsin(radius / far)) * radius, radius * radius / far])  # the camera is on Z
    bent = replace(camera, distortion=np.array([-0.1, 0.0, 0.0, 0.0, 0.0]))
    there = pose.to_cam(limb[None])
    moved = np.linalg.norm(project(there, camera)[0] - project(there, bent)[0])
    assert mistakes.at_edge(film, 0.1) == pytest.approx(moved, rel=1e-6)


# ---- the mouse ----


def test_scale_direction_spin_and_wobble_are_told_apart():
    rng = np.random.default_rng(0)
    made = rng.standard_normal((400, 3))
    angle = np.radians(3.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    A = 1.1 * np.column_stack([turn, [0.02, 0.0]])
    found = mistakes._compared(made @ A.T, made)
    assert found["scale"] == pytest.approx(10.0)
    assert found["direction"] == pytest.approx(3.0)
    assert found["spin"] == pytest.approx(2.2)
    assert found["wobble"] == pytest.approx(0.0, abs=1e-9)
    noisy = mistakes._compared(made[:, :2] + 0.05 * rng.standard_normal((400, 2)), made)
    assert noisy["wobble"] == pytest.approx(5.0, rel=0.1)
    assert abs(noisy["scale"]) < 1.0


def test_axes_of_different_speed_lead_astray():
    made = np.random.default_rng(0).standard_normal((100, 3))
    found = mistakes._compared(made[:, :2] * (1.1, 1.0 / 1.1), made)
    assert found["scale"] == pytest.approx(0.0, abs=1e-9)
    k = 1.1**2
    assert found["direction"] == pytest.approx(np.degrees(np.arcsin((k - 1.0) / (k + 1.0))), rel=1e-3)


def test_a_ball_that_turns_about_one_axis_tells_no_direction():
    made = np.outer(np.linspace(-1.0, 1.0, 50), [1.0, 0.0, 0.0])
    assert mistakes._compared(made[:, :2], made) is None
    assert mistakes._compared(np.zeros((50, 2)), np.zeros((50, 3))) is None


def test_a_scale_is_that_of_the_radius_by_which_it_was_sent(film):
    seen = mistakes.sights.look_at(film, mistakes.kit.settings_of(["tracker=ekf2"]))
    run = mistakes.sights.filtered(seen, mistakes.kit.settings_of(["tracker=ekf2"]), film)
    right, large = (mistakes.mouse(run, film.truth.motion, radius, 0.6) for radius in (0.6, 0.66))
    assert 1.0 + large["scale"] / 100.0 == pytest.approx(1.1 * (1.0 + right["scale"] / 100.0), rel=1e-9)
    assert large["direction"] == pytest.approx(right["direction"], abs=1e-6)
    few = replace(run, status=(*run.status[:5], *[Status.LOST for _ in run.status[5:]]))
    assert mistakes.mouse(few, film.truth.motion, 0.6, 0.6) is None


def test_errors_grow_with_the_mistake(film):
    rigs = [film.rig, wrong(film.rig, "radius", 0.005, 1), wrong(film.rig, "radius", 0.01, 1)]
    rows = [mistakes.followed(film, rig)["rows"] for rig in rigs]
    assert set(rows[0]) == {"ekf1", "ekf2", "so3", FREE}
    right, small, large = (r["ekf2"]["attitude"] for r in rows)
    assert 2.0 * right < small < large
    assert rows[0]["so3"]["direction"] < 1.0


def test_a_film_gives_what_json_holds_and_a_missing_pose_is_said():
    found = json.loads(json.dumps(mistakes.with_mistakes(1, 0.6, {"focal": ([0.02], 1), "targets": ([0.2], 1)})))
    assert found["mistakes"]["focal"]["0.02"][0]["rows"]["so3"]["frames"] == 18
    assert "error" in found["mistakes"]["targets"]["0.2"][0]
    assert found["edge"] == 0.0
    assert found["bound"]["attitude"] > 0.0


# ---- pages ----


def test_rigs_of_all_films_come_together_and_failed_ones_count():
    found = mistakes_module.points(results(), KINDS["evening"])
    assert len(found[1.0]) == 4
    assert mistakes_module.lost(found[1.0], FREE) == 3  # no pose; 1.5° and 9° are far off
    assert mistakes_module.median(found[1.0], FREE, "attitude") == pytest.approx(1.5)
    assert mistakes_module.median(found[1.0], FREE, "scale") == pytest.approx(7.5)  # without its sign
    assert mistakes_module.held(found[1.0], FREE) == pytest.approx(0.95)
    assert list(mistakes_module.points(results(), KINDS["radius"])) == [-0.01, 0.01]
    assert mistakes_module.points(results(), KINDS["centre"]) == {}


def test_what_may_be_off_is_the_largest_size_with_all_smaller_ones_well():
    focal = mistakes_module.points(results(), KINDS["focal"])
    assert mistakes_module.limit_of(focal, FREE) == 0.05
    assert mistakes_module.limit_of(focal, "so3") == 0.01  # too long by 5 %: lost
    assert mistakes_module.limit_of(mistakes_module.points(results(), KINDS["radius"]), FREE) is None
    assert not mistakes_module.bears([{"rows": {FREE: {**row(0.1), "direction": None}}}], FREE)
    assert not mistakes_module.bears([{"rows": {FREE: row(0.1, wobble=5.5)}}], FREE)
    assert not mistakes_module.bears([{"rows": {FREE: row(0.1, tracked=80)}}], FREE)
    assert mistakes_module.lost([{"rows": {FREE: row(0.1, tracked=80)}}], FREE) == 1
    assert not mistakes_module.bears([{"rows": {}}], FREE)


def test_the_page_says_all_that(tmp_path):
    found = section(WHOLE, results())
    page = write_report(tmp_path, {"mistakes": (mistakes.TITLE, found)}, "x")[0].read_text()
    assert "Of the 8 wrong rigs it loses the ball with 1; `so3, no lift`" in page
    assert "focal length 5 % too large: scale -2.5 %, direction 0.5°" in page
    assert "lens with k1 = −0.1 (1.2 px at the ball's edge): scale -2.5 %" in page
    assert "`so3` bears a focal length off by 1 %, an uncorrected lens with k1 = −0.1 and does not bear even" in page
    assert "places-1: too little memory" in page
    focal = tables(found)["Focal length"]
    assert focal.rows[0] == ("right rig", "1", "`ekf1`", "0.10", "1.0", "0.5", "0.1", "0.1", "0", "95")
    assert focal.rows[4][:3] == ("-5", "1", "`ekf1`")
    assert [r[-2] for r in focal.rows[16:]] == ["0", "0", "1", "0"]  # 5 % too long
    radius = tables(found)["Radius"]
    assert radius.rows[4] == ("-10", "1", "`ekf1`", *["–"] * 5, "1", "–")
    evening = tables(found)["A whole evening"]
    assert [r[2] for r in evening.rows[5:]] == [f"`{w}`" for w in ("ekf1", "ekf2", "so3", FREE, TOLD)]
    assert page.count("such evenings") == 1
    for table in tables(found).values():
        assert {len(r) for r in table.rows} == {len(table.head)}
    for name in ("errors", "mouse", "evening"):
        assert (tmp_path / "experiments" / f"mistakes-{name}-dark.svg").stat().st_size > 5000


def same(cells):
    """Where the test for a lifted ball changes nothing."""
    for cell_ in cells:
        if "rows" in cell_:
            cell_["rows"]["so3"] = cell_["rows"][FREE]


def test_a_lift_test_that_stops_nothing_is_said_and_has_no_row():
    given = results()
    for film in given.values():
        for kind in film.get("mistakes", {}).values():
            for cells in kind.values():
                same(cells)
    found = section(WHOLE, given)
    assert "that test stops none of these 8 rigs" in words(found)
    assert FREE not in words(found).replace("`bearing.lifted=1`", "")
    assert {r[2] for r in tables(found)["Focal length"].rows} == {"`ekf1`", "`ekf2`", "`so3`"}


def test_wrong_rigs_are_not_judged_where_the_right_one_misses():
    given = results()
    for film in given.values():
        if "right" in film:
            film["right"] = {"rows": {w: row(0.1, wobble=13.0) for w in ("ekf1", "ekf2", "so3", FREE)}}
    text = words(section(WHOLE, given))
    assert "`so3` misses that with the right rig itself in 3 of 3 films of 3.3 s" in text
    assert "bears a focal length" not in text


def test_one_film_in_several_jobs_is_counted_once():
    given = {"camera-1": film_of(focal={"0.01": [cell(0.2)]}), "places-1": film_of(centre={"0.01": [cell(0.2)]})}
    assert len(mistakes_module._distinct(given)) == 1
    assert "medians of 1 films" in words(section(WHOLE, given))


def test_what_so3_bears_worse_than_ekf2_is_told_from_the_rest():
    found = {"focal": {0.01: [cell(0.2)], 0.05: [cell(0.5)]}, "targets": {0.001: [cell(0.2)]}}
    for error, here in ((9.0, found["focal"][0.05]), (1.5, found["focal"][0.01])):
        here[0]["rows"]["so3"] = row(error)
    text = mistakes_module._said_of_wobble(found)
    assert "more with a focal length off by 5 % (9.0 % against 0.5 %; at 2 of 2 sizes)" in text
    assert "less with targets off by 1 mm in each coordinate (0.2 % against 0.2 %; at 1 of 1 sizes)" in text


def test_telling_that_does_harm_is_said_and_a_film_that_failed_is_a_row():
    worse = cell(0.5)
    worse["rows"][TOLD] = row(2.0)
    given = {"lens-0.1-1": film_of(evening={"1": [worse]}), "lens-0.1-2": {"error": "too dark"}}
    found = section(WHOLE, given)
    assert "makes it worse: attitude 2.00° in place of 0.50°" in words(found)
    last = tables(found)["A whole evening"].rows[-1]
    assert last[:2] == ("1", "films: 1 of 2 failed")
    assert "makes it worse" not in words(section(WHOLE, {"lens-0.1-1": film_of(evening={"1": [cell(0.5)]})}))


def test_a_page_without_results_is_still_a_page():
    assert words(section(WHOLE, {}))
    failed = {job.key: {"error": "no film"} for job in jobs(QUICK)}
    found = section(QUICK, failed)
    assert words(found).count("no film") == len(failed)
    assert not [p for p in found.parts if isinstance(p, Figure | Table)]


def test_jobs_have_keys_of_their_own_and_quick_ones_are_few():
    whole, quick = jobs(WHOLE), jobs(QUICK)
    assert len({j.key for j in whole}) == len(whole)
    assert sum(j.cost for j in quick) < 15.0
    assert sum(j.cost for j in whole) < 320.0
    tried = set()
    for job in quick:
        tried |= set(job.parameters["mistakes"])
    assert tried == set(KINDS)
