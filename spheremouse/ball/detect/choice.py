"""Which projection of colours shows the discs best in a picture.

What counts is the information that the fits of all discs give of their centres: many fits of good contrast. A fit of a
stain or a highlight gives little.
"""

import numpy as np

from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.detect.projection import CANDIDATES, GREY, NEGATIVE, Projection

_BETTER = 1.5  # times the information: standard deviations a fifth smaller; less is not worth a change
_FINEST = 0.25  # of the settings' sigma: at half the contrast a centre is twice as uncertain, in little noise, too
_LEAST = 0.02  # discs: less information is that of stains


def chosen(image: Image, detector: DiscDetector, present: Projection) -> tuple[Projection, float]:
    """The projection that shows the discs in a picture best, and its information, in discs; grey where nearly as good.

    The `present` one stays unless another one is clearly better.
    """
    tried = (GREY, NEGATIVE) if image.ndim == 2 else dict.fromkeys((present, *CANDIDATES))
    told = {p: information_of(detector.seeing(p).detect(image), detector.settings.sigma) for p in tried}
    now, most = told.get(present, 0.0), max(told.values())
    if most < _BETTER * now + _LEAST:
        return present, now
    best = next((p for p in (GREY, NEGATIVE) if told[p] * _BETTER > most), max(told, key=lambda p: told[p]))
    return best, told[best]


def information_of(found: Detections, sigma: float) -> float:
    """Information about the centres, in that of discs without noise; `sigma` px is what their covariances contain."""
    noise = np.maximum(0.5 * np.trace(found.covariance, axis1=1, axis2=2) - sigma**2, 0.0)
    finest = (_FINEST * sigma) ** 2
    return float(np.sum(finest / (finest + noise)))
