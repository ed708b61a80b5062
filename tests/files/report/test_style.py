"""The style of figures: one for all, with the colours that figures name, and nothing of a user's own."""

import pytest

from spheremouse.files.report.style import GRID, INK, MUTED, round_number, styled

mpl = pytest.importorskip("matplotlib")


def as_hex(names):
    from matplotlib.colors import to_hex

    return {to_hex(mpl.rcParams[name]) for name in names}


def test_its_colours_are_those_that_figures_name():
    with styled():
        assert as_hex(("text.color", "axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor")) == {INK}
        assert as_hex(("axes.edgecolor", "xtick.color", "ytick.color")) == {MUTED}
        assert as_hex(("grid.color",)) == {GRID}


def test_a_user_s_own_settings_are_out_within_and_back_after():
    with mpl.rc_context({"font.size": 30.0, "axes.spines.top": True}):
        with styled({"axes.grid": True}):
            assert (mpl.rcParams["font.size"], mpl.rcParams["axes.spines.top"]) == (9.0, False)
            assert mpl.rcParams["axes.grid"]
        assert mpl.rcParams["font.size"] == 30.0


@pytest.mark.parametrize(("most", "found"), [(1.0, 1.0), (1.99, 1.0), (2.0, 2.0), (730.0, 500.0), (0.049, 0.02)])
def test_round_numbers(most, found):
    assert round_number(most) == pytest.approx(found)
