"""The picture of a pattern as a map: compared, turned, and recognised by the next run."""

from dataclasses import replace

import numpy as np
import pytest

from spheremouse.ball.build import begin
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.events import Found, NewMap, Recognised
from spheremouse.ball.texture.method import TEXTURE
from spheremouse.ball.texture.picture_map import PictureMap, look, resize, unfold
from spheremouse.ball.texture.view import anchor_directions
from spheremouse.ball.track import step
from spheremouse.geometry.rotation import log
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.tracker import Status
from tests.ball.texture.painted import DETECTOR, HALF, NOISE, cell_directions, picture_of, plain, waves
from tests.ball.texture.test_method import DT, events, follow
from tests.ball.texture.test_search import random_turn

WHOLE = 64 / 30.0  # s, of the frames that a search of all attitudes takes


def a_map(texture):
    anchors = anchor_directions()
    parts = DiscMap(anchors, 1e-8 * np.eye(2 * len(anchors)), np.full(len(anchors), 50))
    fine, coarse = (picture_of(view, texture) for view in (DETECTOR.fine, DETECTOR.coarse))
    return PictureMap(fine, coarse, parts, NOISE, 0.9, 0.5)


def angle(R):
    return np.degrees(np.linalg.norm(log(R)))


@pytest.fixture(scope="module")
def first_run(speckle):
    """Frames of a run, its tracker, its map, and R_ball_true: the true attitude is that of the map times this."""
    made, tracker, steps = speckle
    found = TEXTURE.to_map(steps[-1].state)
    assert found is not None
    return made, tracker, found, steps[-1].estimate.rotation.T @ made[-1].attitude


def test_a_picture_turned_by_a_rotation_is_the_same_ball_at_that_rotation():
    rng = np.random.default_rng(1)
    whole = a_map(waves(1))
    for _ in range(3):
        R = random_turn(rng)
        turned = whole.turned(R)
        x = rng.normal(size=(200, 3))
        value, _ = look(whole.fine, x)
        np.testing.assert_allclose(look(turned.fine, x @ R.T)[0], value, atol=0.25 * np.abs(value).max())  # blurred
        found = whole.compare(turned)
        assert found is not None
        assert angle(found.rotation @ R.T) < 0.1
        assert not whole.compare_at(turned, np.eye(3)).same_ball


def test_the_same_picture_is_the_same_ball_and_others_are_not():
    whole = a_map(waves(1))
    assert whole.compare_at(whole, np.eye(3)).correlation > 0.999
    assert whole.compare(a_map(waves(2))) is None
    assert whole.compare(a_map(plain)) is None


def test_look_is_exact_at_the_cells_and_the_amount_is_that_of_the_sphere():
    picture = a_map(waves(3)).coarse
    x = cell_directions(picture.value.shape[1])
    value, weight = look(picture, x[:, 5:-5, 5:-5] * 3.0)  # the length is of no account
    np.testing.assert_allclose(value, picture.value[:, 5:-5, 5:-5], atol=1e-6)
    assert weight.min() == 20.0
    whole = a_map(waves(3))
    assert whole.amount == pytest.approx(100.0)
    part = np.where(x[..., 2] > 0.5, whole.coarse.weight, 0.0).astype(np.float32)  # a cap of a quarter of the sphere
    assert replace(whole, coarse=whole.coarse._replace(weight=part)).amount == pytest.approx(25.0, abs=0.5)


def test_an_unfolded_picture_has_y_above_z_in_the_middle_and_x_right_of_it():
    picture = a_map(plain).coarse
    x = cell_directions(picture.value.shape[1])
    for axis, row, column in ((1, 0, 180), (2, 90, 180), (0, 90, 270)):
        spot = picture._replace(value=np.where(x[..., axis] > 0.9, 0.3, 0.0).astype(np.float32))
        image = unfold(spot, 360)
        assert image.shape == (180, 360, 3)
        assert (image[row, column] == image[row, column, 0]).all()
        assert image[row, column, 0] > 200
        assert image[179 - row, (column + 180) % 360, 0] == 128
    nothing = unfold(picture._replace(weight=np.zeros_like(picture.weight)), 360)
    assert (nothing[..., 0] != nothing[..., 1]).all()


@pytest.mark.parametrize("cells", [160, 104, 240])
def test_a_picture_with_other_cells_shows_the_same(cells):
    picture = a_map(waves(4)).fine
    other = resize(picture, cells)
    assert other.value.shape == (6, cells, cells)
    x = np.random.default_rng(4).normal(size=(500, 3))
    before, after = (look(p, x)[0] for p in (picture, other))
    assert np.corrcoef(before, after)[0, 1] > 0.8
    half = picture._replace(weight=np.where(np.arange(picture.value.shape[2]) < 50, picture.weight, 0.0))
    seen = resize(half, cells).weight[0, 0] > 0.0
    edge = (50 * 2.0 / picture.value.shape[2] - 1.0) * HALF
    at = (2.0 * (np.arange(cells) + 0.5) / cells - 1.0) * HALF
    assert not seen[at > edge + 0.01].any()
    assert seen[at < edge - 0.05].all()


@pytest.mark.parametrize("k", [*(pytest.param(k, marks=pytest.mark.slow) for k in (11, 33, 55, 74)), 0, 22, 44, 66])
def test_the_next_run_knows_the_attitude_from_the_picture_alone(first_run, k):
    """The ball rests at any attitude of the first run: it is recognised in the time of one search, and rightly."""
    made, tracker, found, true = first_run
    state = begin(tracker, 0.0, known=found)
    for n in range(66):
        made_of = replace(made[k].frame, stamp=n * DT, sequence=n)
        state, estimate, happened = step(state, made_of, tracker)
        assert estimate.confirmed == state.absolute == (state.status is Status.TRACKING)
        assert not estimate.increment.any()
        if happened:
            break
    assert [type(e) for e in happened] == [Recognised]
    assert happened[0].saved
    assert angle(estimate.rotation @ true @ made[k].attitude.T) < 0.3
    again = TEXTURE.to_map(state)
    assert again is None or found.compare_at(again, np.eye(3)).same_ball


@pytest.mark.slow
def test_another_ball_is_never_taken_for_the_saved_one_and_begins_anew(first_run):
    _, tracker, found, _ = first_run
    options = SimulationOptions(pattern="speckle", motion="roll", turns=0.75, seconds=6.0, noise=3.0, size=(320, 240))
    other = [m.frame for m in simulate(prepare(replace(options, seed=7, layout=8)))]
    steps = follow(other, tracker, begin(tracker, other[0].stamp, known=found))
    assert events(steps)[:2] == [NewMap, Found]
    assert not any(s.state.absolute for s in steps)


@pytest.mark.slow
def test_a_picture_without_details_says_nothing_against_the_saved_one(first_run):
    made, tracker, found, _ = first_run
    cover = [replace(made[0].frame, image=np.full_like(made[0].frame.image, 90), stamp=n * 0.1) for n in range(150)]
    steps = follow(cover, tracker, begin(tracker, 0.0, known=found))
    assert events(steps) == []
    assert steps[-1].state.status is Status.SEARCHING


def test_no_map_is_learnt_before_the_ball_has_turned(first_run):
    made, tracker, found, _ = first_run
    rests = [replace(made[0].frame, stamp=n * DT, sequence=n) for n in range(20)]
    assert TEXTURE.to_map(follow(rests, tracker)[-1].state) is None
    assert TEXTURE.to_map(begin(tracker, 0.0, known=found)) is None
