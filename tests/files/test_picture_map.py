"""Map files of a pattern: what is saved reads back the same, and what is damaged is refused in one line."""

import re
from datetime import UTC, datetime

import numpy as np
import pytest

from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.texture.picture_map import PictureMap, with_known
from spheremouse.ball.texture.view import anchor_directions
from spheremouse.files.ball_map import SavedMap, load_map, map_text, save_map

WHEN = datetime(2026, 2, 3, 4, 5, 6, tzinfo=UTC)
REMEDY = "; mend that, or move the file away: a new map is made as the ball turns"


def saved_map(seed=0, cells=(64, 32)):
    rng = np.random.default_rng(seed)
    pictures = [
        with_known(rng.normal(0.0, 0.2, (6, n, n)), rng.uniform(0.1, 20, (6, n, n)) * (rng.random((6, n, n)) < 0.8))
        for n in cells
    ]
    anchors = anchor_directions()[:18]
    A = rng.normal(0.0, 1e-4, (36, 36))
    parts = DiscMap(anchors, A @ A.T, rng.integers(10, 1000, 18))
    return SavedMap(PictureMap(*pictures, parts, 0.0123, 0.9, 0.4), 0.6, None, WHEN, "0.1.0")


@pytest.fixture
def good():
    return map_text(saved_map())


@pytest.mark.parametrize("seed", range(3))
def test_a_saved_picture_reads_back_the_same(tmp_path, seed):
    path, before = tmp_path / "a.yaml", saved_map(seed)
    save_map(path, before)
    after = load_map(path)
    assert (after.ball_radius, after.disc_radius, after.saved, after.version) == (0.6, None, WHEN, "0.1.0")
    assert (after.map.noise, after.map.correlation, after.map.details) == (0.0123, 0.9, 0.4)
    for a, b in ((before.map.fine, after.map.fine), (before.map.coarse, after.map.coarse)):
        known = a.weight > 0.0
        np.testing.assert_allclose(b.value[known], a.value[known], rtol=0, atol=0.51 / 1024)
        np.testing.assert_allclose(b.weight, a.weight, rtol=0, atol=0.51 / 8)
        np.testing.assert_array_equal(b.weight > 0.0, known)
        assert all(part.dtype == np.float32 and part.flags.writeable and part.flags.c_contiguous for part in b)
    np.testing.assert_allclose(after.map.parts.directions, before.map.parts.directions, atol=2e-9)
    np.testing.assert_array_equal(after.map.parts.sightings, before.map.parts.sightings)
    assert map_text(after).splitlines()[:9] == map_text(before).splitlines()[:9]


def test_the_largest_picture_of_pure_noise_is_read(tmp_path):
    save_map(tmp_path / "a.yaml", saved_map(1, (320, 80)))
    assert load_map(tmp_path / "a.yaml").map.fine.value.shape == (6, 320, 320)


def test_any_yaml_reader_reads_the_file(good):
    from ruamel.yaml import YAML

    data = YAML(typ="safe", pure=True).load(good)
    assert data["cells"] == [64, 32]
    assert len(data["picture"]) > 1000


def test_a_damaged_picture_is_refused_in_one_line(good, refusal):
    said = ": picture: is damaged, or has another number of cells" + REMEDY
    start = good.index("picture: |") + 200
    for text in (
        good[:start] + ("A" if good[start] != "A" else "B") + good[start + 1 :],
        good[:-300],
        good[: start - 180],
        good + "  AAAA\n",
        good[:start] + "?" + good[start:],
        good.replace("cells: [64, 32]", "cells: [64, 40]"),
    ):
        assert re.sub(r"^:\d+", "", refusal(text)) == said


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("noise: 0.0123", "noise: 0", "noise: must be"),
        ("correlation: 0.9", "correlation: 1.5", "correlation: must be"),
        ("cells: [64, 32]", "cells: [64, 33]", "cells[1]: must be"),
        ("cells: [64, 32]", "cells: [100000, 32]", "cells[0]: must be"),
        ("schema: 1", "schema: 2", "schema: is 2; this program reads version 1"),
        ("ball_radius: 0.6", "ball_radius: none", "ball_radius: must be a number"),
        ('saved: "2026', 'saved: "x2026', "saved: is"),
    ],
)
def test_a_wrong_value_is_refused_with_its_line(good, refusal, old, new, says):
    assert old in good
    said = refusal(good.replace(old, new, 1))
    assert says in said
    assert said.endswith(REMEDY)


@pytest.mark.parametrize("garbage", [b"", b"\npicture: |\n", b"\x00\xff" * 500, b"schema: 1\npicture: |\n  AAAA\n"])
def test_garbage_is_refused_in_one_line(refusal, garbage):
    assert refusal(garbage).endswith(REMEDY)
