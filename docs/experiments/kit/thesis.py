"""Figures that the theses print, and the device as they had it."""

from dataclasses import replace
from typing import Any

import numpy as np

from experiments.kit.observations import calibrated, simulated_calibration
from spheremouse.ball.rig import Rig
from spheremouse.geometry.camera import InteriorOrientation

# Correlations row by row below the diagonal, standard deviations and errors (mm, deg), as printed.
THESIS_TABLES: dict[str, dict[str, Any]] = {
    "12": {
        "correlation": (
            (0.060,),
            (-0.093, -0.806),
            (-0.083, -0.972, 0.899),
            (-0.994, -0.060, 0.090, 0.083),
            (-0.300, -0.002, 0.012, 0.032, 0.339),
        ),
        "sigma": (1.9, 1.3, 1.1, 0.07, 0.09, 0.02),
    },
    "21": {
        "correlation": (
            (0.000,),
            (0.002, -0.751),
            (0.000, -0.998, 0.770),
            (-0.998, 0.000, -0.001, 0.000),
            (0.451, 0.001, 0.000, 0.000, -0.428),
        ),
        "sigma": (2.81, 2.72, 0.75, 0.081, 0.081, 0.016),
        "error": (0.61, 2.93, 0.03, 0.049, 0.018, 0.021),
    },
    "22": {
        "correlation": (
            (0.000,),
            (-0.005, 0.453),
            (0.001, -0.968, -0.457),
            (-0.976, 0.001, 0.006, -0.001),
            (0.281, -0.002, -0.003, 0.002, -0.272),
        ),
        "sigma": (0.35, 0.30, 0.11, 0.017, 0.019, 0.007),
        "error": (1.11, 0.72, 0.76, 0.019, 0.008, 0.001),
    },
}


def calibrated_rig(seed: int, camera: InteriorOrientation) -> Rig:
    """The simulated device as a calibration knows it: six photos, a tape; off by what its covariance says."""
    found = calibrated(simulated_calibration(np.random.default_rng([seed, 4])))
    return replace(found.rig(), camera=camera)
