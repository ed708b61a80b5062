"""The grid of sigma_w and sigma_b: a tiny film."""

from experiments.parameters import compared


def test_a_filter_that_weighs_right_beats_one_that_hardly_listens():
    result = compared(None, 60)
    assert len(result["cells"]) == 15
    rate = {key: cell["rate_rmse_deg_s"]["combined"] for key, cell in result["cells"].items()}
    assert rate["0.001/10"] > 3.0 * rate["1/0.1"]
    assert result["so3"]["rate_rmse_deg_s"]["combined"] < rate["1/0.1"]
