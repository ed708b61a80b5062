"""Wrong calibrations: rigs, what becomes of the mouse, and pages made from given results, missing and failed ones."""

import json
from dataclasses import replace

import numpy as np
import pytest
from experiments import mistakes
from experiments.kit import tour
from experiments.kit.job import Request
from experiments.mistakes import FREE, KINDS, TOLD, jobs, wrong
from experiments.report.mistakes import page
from experiments.report.page import said
from experiments.report.plot import save
from numpy.testing import assert_allclose, assert_array_equal

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


def rows(text, title):
    """The cells of the table under a title."""
    lines = text.partition(title)[2].partition("|")[2].partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


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
    seen = mistakes.detections.look_at(film, mistakes.kit.settings_of(["tracker=ekf2"]))
    run = mistakes.detections.filtered(seen, mistakes.kit.settings_of(["tracker=ekf2"]), film)
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


def test_rigs_of_all_films_come_together_and_those_without_a_pose_count():
    evening = rows(said("mistakes", page, results()).text, "**A whole evening (medians)**")
    no_lift = next(row for row in evening[4:] if row[2] == f"`{FREE}`")
    # errors of 0.5, 1.5 and 9.0; no pose, and 1.5° and 9° are far off; a scale without its sign
    assert no_lift == ["", "", f"`{FREE}`", "1.50", "15.0", "7.5", "1.5", "1.5", "3", "95"]
    assert [row[2] for row in evening] == [f"`{w}`" for w in (*("ekf1", "ekf2", "so3", FREE) * 2, TOLD)]
    assert [row[:2] for row in evening[::4]] == [["right rig", "2"], ["1", "4"], ["", ""]]


def test_sizes_stand_in_order_with_the_right_rig_between():
    text = said("mistakes", page, results()).text
    focal = rows(text, "**Focal length (medians)**")
    assert [row[0] for row in focal[::4]] == ["-5", "-1", "right rig", "1", "5"]
    assert focal[8] == ["right rig", "1", "`ekf1`", "0.10", "1.0", "0.5", "0.1", "0.1", "0", "95"]
    assert [row[-2] for row in focal[16:]] == ["0", "0", "1", "0"]  # 5 % too long
    assert rows(text, "**Radius (medians)**")[0] == ["-10", "1", "`ekf1`", *["–"] * 5, "1", "–"]
    assert rows(text, "**What `so3` makes")[0] == ["focal length, %", "5", "-2.5", "0.5", "0.5", "0.50"]
    assert rows(text, "**What `so3` makes")[2] == ["centre, mm", "10", *["–"] * 4]
    assert "moves the ball's edge by 1.2 px" in text
    assert "medians of 3 films" in text
    assert "Of the 8 wrong rigs it loses the ball with 1; `so3, no lift`" in text


def borne(given, mistake="focal length, %"):
    return next(row for row in rows(said("mistakes", page, given).text, "### What may be off") if row[0] == mistake)[1:]


def test_what_may_be_off_is_the_largest_size_with_all_smaller_ones_well():
    assert borne(results()) == ["1", "5", "1"]  # `so3` loses the ball where the focal length is too long by 5 %
    assert borne(results(), "radius, mm") == ["–", "–", "10"]
    assert borne(results(), "centre, mm") == ["–"] * 3
    for bad in ({"direction": None}, {"direction": 2.5}, {"wobble": 5.5}, {"tracked": 80}, {"lost": 1}):
        one = cell(0.1)
        one["rows"][FREE] |= bad
        assert borne({"camera-1": film_of(focal={"0.01": [one], "0.02": [cell(0.1)]})}) == ["2", "–", "1"]


def whole():
    """Results that bear out all that is claimed."""
    found = {}
    for name in ("focal", "radius", "centre", "lens", "targets"):
        found[name] = {"0.1": [cell(0.5)]}
        found[name]["0.1"][0]["rows"]["ekf2"] = row(0.2 if name != "targets" else 0.9)
    found["focal"]["0.1"][0]["rows"]["so3"]["lost"] = 1
    evenings = [cell(9.0), cell(9.0), cell(1.0)]
    for one in evenings:
        one["rows"][TOLD] = row(9.5)
    return {"lens-0.1-1": film_of(**found, evening={"1": evenings})}


@pytest.mark.parametrize(
    "contradict",
    [
        lambda film, one: film["mistakes"]["focal"]["0.1"][0]["rows"]["so3"].update(lost=0),
        lambda film, one: film["mistakes"]["lens"]["0.1"][0]["rows"]["ekf2"].update(wobble=0.6),
        lambda film, one: film["mistakes"]["targets"]["0.1"][0]["rows"]["ekf2"].update(wobble=0.4),
        lambda film, one: [e["rows"].update({TOLD: row(6.0)}) for e in one],
        lambda film, one: one.__setitem__(0, {"rows": {**cell(1.0)["rows"], TOLD: row(9.5)}}),
        lambda film, one: film["right"]["rows"]["so3"].update(wobble=13.0),
    ],
)
def test_a_claim_that_is_contradicted_is_marked(contradict):
    given = whole()
    assert said("mistakes", page, given).doubts == 0
    film = given["lens-0.1-1"]
    contradict(film, film["mistakes"]["evening"]["1"])
    assert said("mistakes", page, given).doubts == 1


def test_an_evening_is_well_where_the_pointer_is_straight_and_steady():
    table = rows(said("mistakes", page, whole()).text, "**3 such evenings (medians)**")
    assert table[0] == ["`ekf1`", "9.00", "90.0", "45.0", "9.0", "9.0", "2", "1"]
    assert table[-1] == [f"`{TOLD}`", "9.50", "95.0", "47.5", "9.5", "9.5", "3", "0"]


def test_wobbles_are_compared_where_they_differ_most():
    given = {"camera-1": film_of(focal={"0.01": [cell(0.2)], "0.05": [cell(0.5)]})}
    for size, error in (("0.05", 9.0), ("0.01", 0.1)):
        given["camera-1"]["mistakes"]["focal"][size][0]["rows"]["so3"] = row(error)
    given["places-1"] = film_of(centre={"0.01": [cell(0.2)]})
    text = said("mistakes", page, given).text
    assert "medians of 1 films" in text
    assert rows(text, "differ most:")[0] == [
        "focal length, %",
        "5",
        "9.0",
        "0.5",
        "2",
        "1",
    ]


@pytest.mark.parametrize("keys", [("camera-1", "places-1", "lens-0.1-1", "lens-0.1-2"), ("places-1", "camera-1")])
def test_a_page_says_what_failed_and_its_figures_draw(tmp_path, keys):
    found = said("mistakes", page, {key: results()[key] for key in keys})
    assert "- places-1: too little memory" in found.text
    assert [d.name for d in found.drawings] == ["mistakes-errors", "mistakes-mouse", "mistakes-evening"]
    for drawing in found.drawings:
        assert save(drawing, tmp_path).stat().st_size > 5000


def test_jobs_have_keys_of_their_own_and_quick_ones_are_few():
    whole, quick = jobs(WHOLE), jobs(QUICK)
    assert len({j.key for j in whole}) == len(whole)
    assert sum(j.cost for j in quick) < 15.0
    assert sum(j.cost for j in whole) < 320.0
    tried = set()
    for job in quick:
        tried |= set(job.parameters["mistakes"])
    assert tried == set(KINDS)
