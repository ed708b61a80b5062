"""Choice of the colour projection that shows the discs best, by the information of their fits."""

from collections.abc import Mapping

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.discs import DiscDetector
from spheremouse.ball.detect.projection import CANDIDATES, GREY, NEGATIVE, Projection, colour_contrast

_MIN_GAIN = 1.5  # least gain in information for a change: standard deviations a fifth smaller
_MIN_INFORMATION = 0.02  # discs: stains give less information
_MIN_GAIN_OVER_GREY = 1.4  # of signal over noise, squared, for Fisher's weights; they have 1.34 times grey's on white


def projections_to_try(image: Image, present: Projection) -> tuple[Projection, ...]:
    """Return the candidates for an image, (h, w, 3) BGR or (h, w): the `present` projection first, if it may stay."""
    return (GREY, NEGATIVE) if image.ndim == 2 else tuple(dict.fromkeys((present, *CANDIDATES)))


def best_projection(
    image: Image, detector: DiscDetector, present: Projection, known: Mapping[Projection, float] | None = None
) -> tuple[Projection, float]:
    """Return the projection that shows the discs best, and its information in noise-free discs.

    The information is that of all fits about the discs' centres. Many fits of good contrast give much information, and
    a fit of a stain or a highlight gives little. `image` is (h, w, 3) BGR or (h, w). The `present` projection stays
    unless another one is clearly better. Grey or its negative takes precedence over colours if it is nearly as good.
    Candidates whose information in an image just before is `known` are not tried again.
    """
    information = dict(known or {})
    for p in projections_to_try(image, present):
        if p not in information:
            information[p] = detector.with_projection(p).information(image)
    best, most = max(information, key=information.__getitem__), max(information.values())
    if most < _MIN_GAIN * information.get(present, 0.0) + _MIN_INFORMATION:
        best = present
    else:
        best = next((p for p in (GREY, NEGATIVE) if information[p] * _MIN_GAIN > most), best)
    if image.ndim == 2 or best.needs_colour:
        return best, information.get(best, 0.0)
    fisher = _better_than_grey(image, detector.with_projection(best))
    more = 0.0 if fisher is None else detector.with_projection(fisher).information(image)
    if fisher is None or more < information[best]:  # such as spots on a hand, which are as dark in grey
        return best, information[best]
    return fisher, more


def _better_than_grey(image: Image, detector: DiscDetector) -> Projection | None:
    """Return Fisher's projection, or None if that of the `detector`, grey or its negative, is nearly as good.

    White, black and grey differ alike in all channels, so grey shows nearly all of their contrast. White on red differ
    in two channels, and the noise of the third one only disturbs.
    """
    contrast = colour_contrast(image, detector.model.mask, detector.detect(image), detector.model.diameter)
    if contrast is None:
        return None
    fisher = contrast.fisher
    gain = (contrast.signal_to_noise(fisher) / contrast.signal_to_noise(detector.model.fit.projection)) ** 2
    return fisher if gain > _MIN_GAIN_OVER_GREY else None
