"""Map files: what is saved reads back the same, and what is damaged is refused in one line that says what to do."""

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from conftest import directions
from hypothesis import given, settings
from hypothesis import strategies as st

from spheremouse.ball.detect.projection import CANDIDATES, GREY, normalise
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.errors import ConfigurationError
from spheremouse.files import ball_map
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.geometry.rotation import tangent_basis

CAMERA = InteriorOrientation(640, 480, 600.0, 600.0, 320.0, 240.0)
RIG = Rig(CAMERA, Ball(0.6), Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3)), 0.02)
WHEN = datetime(2026, 2, 3, 4, 5, 6, tzinfo=UTC)
REMEDY = "; mend that, or move the file away: a new map is made as the ball turns"


def random_map(seed, discs, rank=None):
    """Well correlated errors of very different sizes; with a `rank`, some combinations are known exactly."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(discs, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    n = 2 * discs
    A = rng.normal(size=(n, n if rank is None else rank)) * 10.0 ** rng.uniform(-5, -2, (n, 1))
    A[:, 0] *= 30.0
    return DiscMap(d, A @ A.T, rng.integers(1, 10**6, discs))


def saved(disc_map):
    return ball_map.SavedMap(disc_map, 0.6, 0.02, WHEN, "0.1.0")


def read_back(folder, saved_map):
    ball_map.save_map(folder / "m.yaml", saved_map)
    return ball_map.load_map(folder / "m.yaml")


@pytest.fixture
def good():
    return ball_map.map_text(saved(random_map(0, 6)))


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), discs=st.integers(1, 12), thin=st.booleans())
def test_a_saved_map_reads_back_the_same(tmp_path_factory, seed, discs, thin):
    """Also where the covariance is singular: a quadratic form in any direction keeps its value."""
    before = saved(random_map(seed, discs, rank=1 + discs // 2 if thin else None))
    after = read_back(tmp_path_factory.getbasetemp(), before)
    assert (after.ball_radius, after.disc_radius, after.saved, after.version) == (0.6, 0.02, WHEN, "0.1.0")
    np.testing.assert_allclose(after.map.directions, before.map.directions, rtol=0, atol=2e-9)
    np.testing.assert_allclose(np.linalg.norm(after.map.directions, axis=1), 1.0, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(after.map.sightings, before.map.sightings)
    P, Q = before.map.covariance, after.map.covariance
    sigma = np.sqrt(np.diag(P))
    np.testing.assert_allclose(Q / np.outer(sigma, sigma), P / np.outer(sigma, sigma), rtol=0, atol=3e-4)
    np.testing.assert_array_equal(Q, Q.T)
    # a standard deviation in any combination of errors that are scaled alike
    v = np.random.default_rng(seed).normal(size=(50, len(P))) / sigma
    there, back = (np.sqrt(np.einsum("ki,ij,kj->k", v, C, v)) for C in (P, Q))
    np.testing.assert_allclose(back, there, rtol=0, atol=1e-3 * np.linalg.norm(v * sigma, axis=1).max())


def test_a_map_keeps_the_centre_of_an_eccentric_ball(tmp_path):
    centred = random_map(4, 6)
    known = replace(centred, eccentricity=np.array([1.2345e-3, 0.0, -3e-4]), eccentricity_sigma=1.5e-4)
    after = read_back(tmp_path, saved(known)).map
    np.testing.assert_allclose(after.eccentricity, known.eccentricity, atol=1e-7)
    assert after.eccentricity_sigma == known.eccentricity_sigma
    assert "centre" not in ball_map.map_text(saved(centred))


@pytest.mark.parametrize("projection", [*CANDIDATES, normalise(np.array([-0.123456, 0.3, 0.7]))])
def test_a_map_keeps_the_colours_of_its_discs(tmp_path, projection):
    after = read_back(tmp_path, saved(replace(random_map(4, 6), projection=projection))).map.projection
    written = (tmp_path / "m.yaml").read_text()
    assert ("weights" in written) == (projection != GREY)  # without them it is what older versions wrote
    np.testing.assert_allclose(after.weights, projection.weights, rtol=0, atol=1e-6)
    assert after.needs_colour == projection.needs_colour


def test_what_is_known_best_of_a_map_survives_its_digits(tmp_path):
    """All discs off by one common turn of 1°, one to another by 0.003°: the digits of correlations would lose it."""
    d = directions(20, 1)
    common = np.concatenate([b.T @ np.cross([0.0, 0.0, 1.0], u) for b, u in zip(tangent_basis(d), d, strict=True)])
    fine, coarse = np.deg2rad(0.003), np.deg2rad(1.0)
    P = fine**2 * np.eye(40) + coarse**2 * np.outer(common, common)
    Q = read_back(tmp_path, saved(DiscMap(d, P, np.ones(20, dtype=np.intp)))).map.covariance
    assert np.linalg.eigvalsh(Q)[:39] == pytest.approx(fine**2, rel=0.05)
    assert np.linalg.eigvalsh(Q)[39] == pytest.approx(np.linalg.eigvalsh(P)[39], rel=1e-3)


def test_the_axes_of_a_disc_on_the_seam_of_the_tangent_basis_stay(tmp_path):
    """Directions are rounded; at z = 0 the axes of the covariance jump, and must not."""
    z = np.array([1e-12, -1e-12, 1e-10, -1e-10, 0.0, -0.0])
    angle = np.linspace(0.0, 5.0, 6)
    d = np.stack([np.cos(angle), np.sin(angle), z], axis=1)
    after = read_back(tmp_path, saved(DiscMap(d, 1e-6 * np.eye(12), np.ones(6, dtype=np.intp)))).map.directions
    np.testing.assert_allclose(tangent_basis(after), tangent_basis(d), rtol=0, atol=1e-8)


def test_a_map_of_120_discs_is_a_small_file(tmp_path):
    assert len(read_back(tmp_path, saved(random_map(3, 120))).map) == 120
    assert (tmp_path / "m.yaml").stat().st_size < 250_000
    assert len(ball_map.map_text(saved(random_map(3, 26)))) < 16_000


def test_names_and_date():
    assert ball_map.map_path(Path("at/rig.yaml")) == Path("at/rig.map.yaml")
    assert ball_map.map_path(Path("my.rig.yaml")) == Path("my.rig.map.yaml")
    assert ball_map.old_path(Path("at/rig.map.yaml")) == Path("at/rig.map.old.yaml")
    now = ball_map.saved_now(random_map(0, 5), RIG)
    assert (now.ball_radius, now.disc_radius) == (0.6, 0.02)
    assert abs(now.saved - datetime.now(UTC)) < timedelta(minutes=1)
    assert ball_map.age(now.saved) == "just now"
    assert ball_map.age(now.saved - timedelta(hours=5, minutes=10)) == "5 hours ago"
    assert ball_map.age(now.saved - timedelta(days=400)) == "400 days ago"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("disc_radius", "disk_radius", ":3: disc_radius: missing; radius of a disc in m (and 1 more)"),
        ("2026-02-03T", "2026-02-33T", ":5: saved: is '2026-02-33T"),
        ("+00:00", "", ":5: saved: '2026-02-03T04:05:06' has no time zone"),
        ("direction: [", "direction: [7", ":9: discs[0].direction: has length "),
        ("discs:", "weights: [0, 0, 0]\ndiscs:", ":8: weights: are all 0; remove the line"),
        ('"100000"', '"90000"', ":16: correlation_root[0]: its squares must sum to 100000 squared"),
        ('"100000"', '"100000 1"', ":16: correlation_root[0]: must be 1 whole numbers, is '100000 1'"),
        ('"100000"', '"1e5"', ":16: correlation_root[0]: must be 1 whole numbers"),
        ('  - "100000"\n', "", ":15: correlation_root: has 11 lines for 6 discs; each disc has two"),
    ],
)
def test_what_is_wrong_is_named_with_its_line_and_what_to_do(good, refusal, old, new, says):
    assert old in good
    message = refusal(good.replace(old, new, 1))
    assert message.startswith(says), message
    assert message.endswith(REMEDY)


def test_a_file_cut_off_anywhere_or_with_a_byte_changed_is_refused_or_still_a_map(good, tmp_path):
    """Never a traceback, never a map that is none: a cut is seen always, a digit mostly."""
    path = tmp_path / "m.yaml"
    rng = np.random.default_rng(0)
    raw = good.encode()
    for end in rng.integers(0, len(raw) - 2, 40):
        path.write_bytes(raw[:end])
        with pytest.raises(ConfigurationError) as e:
            ball_map.load_map(path)
        assert "\n" not in str(e.value)
    for _ in range(60):
        text = bytearray(raw)
        text[rng.integers(len(text))] = rng.integers(256)
        path.write_bytes(bytes(text))
        try:
            loaded = ball_map.load_map(path)
        except ConfigurationError:
            continue
        assert np.linalg.eigvalsh(loaded.map.covariance).min() > -1e-12
        np.testing.assert_allclose(np.linalg.norm(loaded.map.directions, axis=1), 1.0)


def test_a_map_of_another_ball_than_the_rigs_is_refused(tmp_path):
    made = saved(random_map(0, 6))
    ball_map.check_fits(made, replace(RIG, ball=Ball(0.61), disc_radius=0.022), tmp_path, "discs")  # calibrated anew
    for rig, problem in (
        (replace(RIG, ball=Ball(0.03)), "was made with a ball of radius 0.6 m, the rig has 0.03 m: name this"),
        (replace(RIG, disc_radius=0.01), "was made with discs of radius 0.02 m, the rig has 0.01 m: name this"),
    ):
        with pytest.raises(ConfigurationError, match=re.escape(problem)):
            ball_map.check_fits(made, rig, tmp_path, "discs")
