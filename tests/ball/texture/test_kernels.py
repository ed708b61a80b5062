"""The native functions of the texture refuse wrong arrays by name, and survive any number in right ones."""

from typing import Any

import numpy as np
import pytest

from spheremouse.ball.texture.picture import first_seen, learn, tiles_in_view, tiles_to_learn, weigh
from spheremouse.geometry.rotation import exp, log
from spheremouse.native import kernels
from tests.ball.texture.painted import DETECTOR, NOISE, contrast_at, picture_of, plain, waves

VIEW = DETECTOR.coarse
R = exp(np.array([0.3, -0.2, 0.1]))
SEEN = first_seen(VIEW, contrast_at(VIEW, waves(0), R, np.random.default_rng(0)))
PICTURE = picture_of(VIEW, waves(0))
SAMPLES: dict[str, Any] = {
    "contrast": SEEN.contrast,
    "direction": VIEW.direction,
    "odds": SEEN.least,
    "offset": SEEN.offset,
}
ALL = np.arange(len(VIEW.tiles))
WHOLE = np.random.default_rng(1).normal(0.0, 0.05, VIEW.inside.shape).astype(np.float32)
BAD = [np.nan, np.inf, -np.inf, 0.0, 3e38]


def _members(samples: dict[str, Any]) -> Any:
    return tuple((SAMPLES | samples).values())


def aligned(
    *,
    R=R,
    noise: Any = NOISE,
    place: Any = 0.2 * VIEW.pixel,
    value=PICTURE.value,
    weight=PICTURE.weight,
    **samples: Any,
) -> Any:
    more = {"anchor_of": VIEW.anchor_of, "across": VIEW.across}
    more |= {name: samples.pop(name) for name in list(samples) if name in more}
    members = _members(samples)
    return kernels.align_texture(members, (value, weight), R, noise, place, VIEW.pixel, *more.values())


def shifted(*, R=R, noise: Any = NOISE, value=PICTURE.value, weight=PICTURE.weight, **samples: Any) -> Any:
    more = {"camera": np.array([0.3, 0.5, 3.8]), "axes": np.eye(3)[:2].copy()}
    more |= {name: samples.pop(name) for name in list(samples) if name in more}
    given = R, noise, 0.1 * VIEW.pixel, VIEW.pixel, more["camera"], more["axes"]
    return kernels.shift_of_texture(_members(samples), (value, weight), *given)


def correlated(*, attitudes=R[None], most=200, value=PICTURE.value, weight=PICTURE.weight, **samples: Any) -> Any:
    return kernels.correlate_texture(_members(samples), (value, weight), attitudes, most)


def learnt(*, R=R, chart=VIEW.chart, known=PICTURE.known, tiles=ALL, forget=False, most=20.0, **seen: Any) -> Any:
    value, weight, after = PICTURE.value.copy(), PICTURE.weight.copy(), known.copy()
    members: Any = {
        "contrast": WHOLE,
        "number": VIEW.number,
        "odds": SEEN.least,
        "offset": SEEN.offset,
        "step": VIEW.step,
    }
    members = tuple((members | seen).values())
    kernels.learn_texture(members, (value, weight, after), tiles, chart, R, most, forget)
    return value, weight, after


def weighed(*, R=R, mean=SEEN.mean, odds_after=SEEN.odds, offset_after=SEEN.offset, noise=NOISE, **samples: Any) -> Any:
    after = mean.copy(), odds_after.copy(), offset_after.copy()
    kernels.weigh_static(_members(samples), PICTURE[:2], R, after, noise, 0.2, 0.01, 3.0)
    return after


def doubted(*, first=SEEN.first, own=SEEN.odds, **samples: Any) -> Any:
    return kernels.leave_out_doubtful(_members(samples), first, own, 0.03, 0.02)


@pytest.mark.parametrize("function", [aligned, correlated, doubted, shifted, weighed])
@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("contrast", SEEN.contrast[: len(SEEN.contrast) // 2].copy()),
        ("odds", SEEN.odds[1:].copy()),
        ("offset", SEEN.offset[1:].copy()),
        ("offset", None),
    ],
)
def test_wrong_samples_are_named(function, name, wrong):
    with pytest.raises(TypeError, match=rf"\b{name}\b"):
        function(**{name: wrong})


OTHER_NAMES: dict[Any, str] = {
    (weighed, "odds"): "odds_after",
    (weighed, "offset"): "offset_after",
    (learnt, "axes"): "chart",
    (learnt, "spacing"): "chart",
}


@pytest.mark.parametrize(
    ("function", "name", "wrong"),
    [
        (aligned, "value", PICTURE.value[:5].copy()),
        (aligned, "value", PICTURE.value[:, 1:, 1:].copy()),
        (aligned, "weight", PICTURE.weight[:, 8:, 8:].copy()),
        (correlated, "weight", PICTURE.weight[:, 8:, 8:].copy()),
        (aligned, "anchor_of", VIEW.anchor_of[:, 1:].copy()),
        (aligned, "across", VIEW.across[:, :2].copy()),
        (doubted, "first", SEEN.first[1:].copy()),
        (doubted, "own", SEEN.odds[1:].copy()),
        (learnt, "known", PICTURE.known[:, 1:].copy()),
        (learnt, "contrast", WHOLE[:0]),
        (learnt, "offset", SEEN.offset[1:].copy()),
        (learnt, "step", "far"),
        (learnt, "axes", VIEW.chart._replace(axes=np.eye(2))),
        (learnt, "spacing", VIEW.chart._replace(spacing="wide")),
        (learnt, "chart", VIEW.chart[:3]),
        (shifted, "camera", np.zeros(2)),
        (shifted, "axes", np.eye(3)),
        (weighed, "mean", SEEN.mean[1:].copy()),
        (weighed, "odds", SEEN.odds.reshape(1, -1)),
        (weighed, "offset", SEEN.offset[1:].copy()),
    ],
)
def test_other_wrong_arrays_are_named(function, name, wrong):
    with pytest.raises(TypeError, match=rf"\b{name}\b"):
        function(**{str(OTHER_NAMES.get((function, name), name)): wrong})


@pytest.mark.parametrize("anchor", [-1, 20])
def test_an_anchor_that_does_not_exist_is_refused(anchor):
    with pytest.raises(IndexError, match="anchor_of"):
        aligned(anchor_of=np.full_like(VIEW.anchor_of, anchor))


def test_a_sample_or_a_tile_that_does_not_exist_is_refused():
    with pytest.raises(IndexError, match="number"):
        learnt(number=VIEW.number + 1)
    with pytest.raises(IndexError, match="step"):
        learnt(step=0)
    for wrong in (-1, len(ALL)):
        with pytest.raises(IndexError, match="tiles"):
            learnt(tiles=np.array([wrong]))


@pytest.mark.parametrize("bad", BAD)
def test_an_attitude_that_is_no_rotation_crashes_nothing(bad):
    """A filter that diverges gives any matrix."""
    wrong = np.full((3, 3), bad)
    assert not aligned(R=wrong)[4]
    assert np.all(np.isfinite(correlated(attitudes=wrong[None])))
    for part in (*learnt(R=wrong), *weighed(R=wrong)):
        assert np.all(np.isfinite(part))


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("axis", [0, 1, 2, slice(None)])
def test_directions_that_are_none_are_no_part_of_the_ball(bad, axis):
    direction = VIEW.direction.copy()
    direction[axis, ::40] = bad
    found, whole = aligned(direction=direction), aligned()
    assert found[4]
    assert np.allclose(found[0], whole[0], atol=0.5 * VIEW.pixel)
    assert np.all(np.isfinite(correlated(direction=direction)))


@pytest.mark.parametrize("most", [-5, -1, 0, 10**9])
def test_any_number_of_samples_may_be_asked_for(most):
    assert correlated(most=most)[0] == pytest.approx(0.95 if most > 0 else 0.0, abs=0.05)


def test_a_picture_of_a_single_tile_on_each_face_has_a_place_for_each_corner():
    """The corner of the cube is beside the last cell: the next one would be that of another face, or of no picture."""
    memory = np.full((7, 8, 8), np.nan, np.float32)
    memory[:6] = np.random.default_rng(0).normal(size=(6, 8, 8))
    corners = np.array([[x, y, z] for x in (-0.999, 0.999) for y in (-0.999, 0.999) for z in (-1.0, 1.0)])
    direction: Any = np.resize(corners, VIEW.direction.T.shape).T
    found = aligned(
        direction=np.ascontiguousarray(direction, dtype=np.float32),
        value=memory[:6],
        weight=np.ones((6, 8, 8), np.float32),
        anchor_of=np.zeros((6, 1, 1), np.int64),
        R=np.eye(3),
    )
    assert found[3] == direction.shape[1]


def test_no_information_comes_from_what_stands_still_or_is_unknown():
    still, unknown = np.full_like(SEEN.odds, -3.1), np.zeros_like(PICTURE.weight)
    changes: list[dict[str, Any]] = [{"odds": still}, {"weight": unknown}]
    for change in changes:
        found = aligned(**change)
        assert found[3] == 0
        assert not np.any(found[5])
        assert not found[4]
    assert correlated(odds=still)[0] == correlated(weight=unknown)[0] == 0.0


def test_the_information_of_the_anchors_is_that_of_their_pixels():
    """With one anchor it is the sum of those of all."""
    each, one = aligned(), aligned(anchor_of=np.zeros_like(VIEW.anchor_of), across=np.eye(3)[None] * (2.0 / 3.0))
    for member in (5, 6, 7):
        assert np.allclose(each[member].sum(axis=0), one[member][0], rtol=1e-9, atol=1e-9 * np.abs(each[member]).max())


def test_an_alignment_from_the_attitude_found_stays_there():
    """It moves by what the rounds leave, 1e-4 rad."""
    found = aligned(R=exp(np.array([2e-3, 0.0, 1e-3])) @ R)
    assert np.linalg.norm(log(aligned(R=found[0])[0] @ found[0].T)) < 1e-4


@pytest.mark.parametrize("known", [0.0, 10.0])
def test_turns_learn_all_of_a_picture_in_parts(known):
    """Each tile that is not known yet in one turn, and each that is in 8."""
    start, every = picture_of(VIEW, plain, known), 1 if known == 0.0 else 8
    parts = [tiles_to_learn(VIEW, start, R, turn) for turn in range(every)]
    whole = tiles_in_view(VIEW, R)
    assert np.array_equal(np.sort(np.concatenate(parts)), whole)  # none twice
    assert max(len(p) for p in parts) < 1.5 * len(whole) / every
    seen = learn(VIEW, SEEN, WHOLE, start, R, ALL).weight
    assert np.array_equal(learn(VIEW, SEEN, WHOLE, start, R, whole).weight, seen)  # the others show nothing
    for part in parts:
        start = learn(VIEW, SEEN, WHOLE, start, R, part)
    assert np.array_equal(start.weight, seen)


@pytest.mark.parametrize("noise", [1e-30, 1e30])
def test_odds_stay_within_twelve_nats(noise):
    seen = SEEN._replace(contrast=contrast_at(VIEW, waves(1), np.eye(3)))
    for _ in range(10):
        seen = weigh(VIEW, seen, PICTURE, R, noise)
    assert np.abs(seen.odds).max() <= 12.0
    assert (np.abs(seen.odds).max() > 11.0) == (noise < 1.0)
