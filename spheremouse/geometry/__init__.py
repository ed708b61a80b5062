"""Geometry without a noun of this project."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
