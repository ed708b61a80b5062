"""The renderer's rays: shares of the surfaces in a pixel with an edge."""

import numpy as np

from spheremouse.simulate.cast import _LATTICE


def test_an_edge_of_any_direction_has_the_right_shares():
    """Against 160,000 rays, for edges just before and behind each ray."""
    even = (np.arange(400) + 0.5) / 400 - 0.5
    many = np.stack(np.meshgrid(even, even), axis=-1).reshape(-1, 2)
    n, worst = len(_LATTICE), 0.0
    for angle in np.radians(np.arange(0.0, 180.0, 3.0)):
        across = np.cos(angle), np.sin(angle)
        true = np.searchsorted(np.sort(many @ across), np.sort(_LATTICE @ across)) / len(many)
        worst = max(worst, *(np.abs(true - (np.arange(n) + k) / n).max() for k in (0, 1)))
    assert worst < 0.1
