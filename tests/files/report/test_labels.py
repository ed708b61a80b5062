"""Words in a figure that is drawn: none touches another, a mark or a line where there is room, none leaves the axes."""

from itertools import combinations

import numpy as np
import pytest

from spheremouse.files.report.labels import label_ends, label_level, label_points
from spheremouse.files.report.places import End

pytest.importorskip("matplotlib")


@pytest.fixture
def figure():
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.0, 3.0), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def painted(figure, colour):
    """Where a figure has pixels of this colour, (n, 2) x and y upwards."""
    figure.canvas.draw()
    seen = np.asarray(figure.canvas.buffer_rgba()).astype(int)[::-1, :, :3]
    y, x = np.nonzero(np.abs(seen - colour).sum(axis=2) < 120)
    return np.stack([x, y], axis=1)


RED, GREEN, BLUE = (255, 0, 0), (0, 128, 0), (0, 0, 255)
NAMES = {RED: "red", GREEN: "green", BLUE: "blue"}


def boxes(figure):
    found = [painted(figure, colour) for colour in NAMES]
    return [(*pixels.min(axis=0), *pixels.max(axis=0)) for pixels in found if len(pixels)]


def apart(a, b):
    return a[2] < b[0] or b[2] < a[0] or a[3] < b[1] or b[3] < a[1]


@pytest.mark.parametrize("values", [(1.0, 1.0, 1.0), (1.0, 1.01, 9.0), (0.9, 9.9, 10.0)])
def test_names_at_the_ends_of_lines_are_apart_and_right_of_the_axes_within_the_figure(figure, values):
    ax = figure.subplots()
    ax.set(ylim=(0.9, 10.0), yscale="log", xlim=(0.0, 1.0))
    label_ends(ax, [End("name", y, colour) for y, colour in zip(values, NAMES.values(), strict=True)])
    found = []
    for colour in NAMES:
        pixels = painted(figure, colour)
        words = pixels[pixels[:, 0] > ax.bbox.x1 + 11.0 * figure.dpi / 72.0]  # leaders are left of them
        found.append((*words.min(axis=0), *words.max(axis=0)))
    assert len(found) == 3
    assert all(apart(a, b) for a, b in combinations(found, 2))
    for (x0, y0, x1, y1), y in zip(found, values, strict=True):
        assert x0 > ax.bbox.x1
        assert x1 < figure.bbox.width - 1
        assert ax.bbox.y0 - 1 <= y0 < y1 <= ax.bbox.y1 + 1
        assert abs(0.5 * (y0 + y1) - ax.transData.transform((0.0, y))[1]) < 28  # two lines of letters


def test_words_beside_points_find_room(figure):
    ax = figure.subplots()
    ax.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    ax.plot([0.0, 1.0], [0.56, 0.56], color="black")  # where each would stand first
    for x, colour in zip((0.4, 0.5, 0.98), NAMES.values(), strict=True):
        label_points(ax, [("words", x, 0.5)], color=colour)
    found, line = boxes(figure), painted(figure, (0, 0, 0))
    assert len(found) == 3
    assert all(apart(a, b) for a, b in combinations(found, 2))
    at = ax.transData.transform((0.0, 0.56))[1]
    for x0, y0, x1, y1 in found:
        assert not y0 <= at <= y1
        assert ax.bbox.x0 <= x0 < x1 <= ax.bbox.x1 + 1
    assert len(line)


def test_a_word_on_a_level_avoids_a_curve(figure):
    ax = figure.subplots()
    ax.set(xlim=(1.0, 10.0), ylim=(0.0, 1.0), xscale="log")
    ax.axhline(0.5, color="0.5")
    ax.plot([1.0, 1.3], [0.3, 0.7], color="black")
    label_level(ax, 0.5, "words", color="red")
    (x0, y0, _, y1), at = boxes(figure)[0], ax.transData.transform([(1.3, 0.5), (1.2, 0.55)])
    assert x0 > at[1, 0]
    assert not y0 <= at[0, 1] <= y1
    assert min(abs(y0 - at[0, 1]), abs(y1 - at[0, 1])) < 8
