"""The comparison of renderers: edges of known blur, pairs of discs."""

import numpy as np
import pandas as pd
import pytest
from experiments import renderer
from experiments.renderer import blur_of
from scipy.special import ndtr

from spheremouse.ball.detect.appearance import appearance
from spheremouse.ball.truth import HIDDEN, VISIBLE, DiscTruth
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


@pytest.mark.parametrize(("sigma", "shift"), [(0.3, 0.0), (0.5, -0.2), (0.45, 0.15)])
def test_blur_and_middle_of_an_edge(sigma, shift):
    at = np.arange(-2.45, 2.5, 0.1)
    edge = pd.Series(ndtr((at - shift) / sigma), index=at)
    edge.iloc[[3, 40]] = np.nan  # cells without pixels
    assert blur_of(edge) == pytest.approx(sigma, rel=0.02)


def test_the_edge_of_painted_ellipses_is_a_pixel_wide_and_in_its_place():
    scene = default_scene(1, "far")
    a = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    directions = np.stack([0.35 * np.cos(a), 0.35 * np.sin(a), np.full(12, np.sqrt(1 - 0.35**2))], axis=1)
    look = appearance(directions, scene.rig(), scene.pose)
    sums = np.zeros((2, 50))
    renderer.add_edges(sums, painted(look, (640, 480), 30.0, 200.0), look)
    edges = dict.fromkeys((*renderer.GREY, renderer.LINEAR), sums)
    edge = renderer.edge_profiles({"far26-0": {"edges": edges}})["ours"]
    assert blur_of(edge) == pytest.approx(1 / np.sqrt(12), abs=0.03)


def test_light_is_grey_without_the_curve():
    grey = renderer.linear_light(np.array([0.0, 188.0, 255.0]))
    assert grey == pytest.approx([0.0, 0.5 * 255.0, 255.0], abs=1.0)


def test_discs_are_paired_by_their_number_where_both_show_them():
    own, whole = renderer.whole_in_both(
        truth([1, 4, 7, 9], [VISIBLE, VISIBLE, HIDDEN, VISIBLE]),
        truth([0, 4, 7, 9], [VISIBLE, VISIBLE, VISIBLE, HIDDEN]),
    )
    assert own.disc.tolist() == whole.disc.tolist() == [4]
    small = truth([4], [VISIBLE], area=5.0)
    assert len(renderer.whole_in_both(truth([4], [VISIBLE]), small)[1]) == 0


def test_large_discs_of_the_reference_recording_agree(far26):
    found = renderer.compared(str(far26), 0, 150)
    rows = np.array([r for r in found["rows"] if None not in r])
    large = rows[rows[:, 0] >= 60.0]
    assert len(large) >= 3
    assert np.sqrt(np.mean((large[:, 3:5] - large[:, 6:8]) ** 2)) < 0.05
    assert max(found["geometry"][:2]) < 0.01
