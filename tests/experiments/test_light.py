"""Noise and brightness: laws of a tiny film."""

from experiments.light import simulated


def test_noise_makes_centres_and_rates_worse():
    cells = simulated(50, [1, 15], 40)["cells"]
    quiet, loud = cells["1"]["rows"]["so3"], cells["15"]["rows"]["so3"]
    assert loud["detection"]["centre_rms_px"] > 1.5 * quiet["detection"]["centre_rms_px"]
    assert loud["rate_rmse_deg_s"]["combined"] > quiet["rate_rmse_deg_s"]["combined"]
    assert cells["15"]["bound"]["rate_deg_s"]["combined"] > cells["1"]["bound"]["rate_deg_s"]["combined"]
