"""Selection of the colour projection that shows the discs best in a picture.

The criterion is the total information about the discs' centres from all fits. Many fits of good contrast give much
information; a fit of a stain or a highlight gives little.
"""

import numpy as np

from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.detect.projection import CANDIDATES, GREY, NEGATIVE, Projection

_BETTER = 1.5  # least gain in information for a change: standard deviations a fifth smaller
_FINEST = 0.25  # of the settings' sigma: so the contrast still counts when the picture has little noise
_LEAST = 0.02  # discs: stains give less information


def chosen(image: Image, detector: DiscDetector, present: Projection) -> tuple[Projection, float]:
    """Return the projection that shows the discs best, and its information in noise-free discs.

    `image` is (h, w, 3) BGR or (h, w). The `present` projection stays unless another one is clearly better. Grey or its
    negative takes precedence over colours if it is nearly as good.
    """
    tried = (GREY, NEGATIVE) if image.ndim == 2 else dict.fromkeys((present, *CANDIDATES))
    told = {p: information_of(detector.seeing(p).detect(image), detector.settings.sigma) for p in tried}
    now, most = told.get(present, 0.0), max(told.values())
    if most < _BETTER * now + _LEAST:
        return present, now
    best = next((p for p in (GREY, NEGATIVE) if told[p] * _BETTER > most), max(told, key=lambda p: told[p]))
    return best, told[best]


def information_of(found: Detections, sigma: float) -> float:
    """Return the information about the discs' centres, in noise-free discs.

    `sigma` px is the constant standard deviation per axis that the covariances of `found` include.
    """
    noise = np.maximum(0.5 * np.trace(found.covariance, axis1=1, axis2=2) - sigma**2, 0.0)
    finest = (_FINEST * sigma) ** 2
    return float(np.sum(finest / (finest + noise)))
