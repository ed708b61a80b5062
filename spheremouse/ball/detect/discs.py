"""The default disc detector: local contrast detects discs, and a fit of the expected image measures them.

A projection of the colours (detect.projection) makes discs darker than the ball. A candidate is a place darker than its
surroundings (grey closing wider than a disc) by a part of the lighter of the two. This criterion is a ratio, so neither
the level of the light nor its slope matters. The model of the image around each candidate is a sloped background minus
a blurred ellipse, whose shape follows from the geometry. The fit gives centre, size and contrast with a covariance
(`fit.cpp`). A fit without enough of the rim is rejected. During tracking the map predicts the discs. Then the detector
measures each disc in its own window and does not process the whole image.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.appearance import appearance, ball_mask, clear_mask, largest_disc
from spheremouse.ball.detect.blur import blur_of
from spheremouse.ball.detect.detections import Detections, Image
from spheremouse.ball.detect.projection import (
    GREY,
    NEGATIVE,
    Projection,
    normalise,
    offset_of,
    projected,
    sample_weights_of,
    weights_of,
)
from spheremouse.ball.detect.search import Lattice, SearchState, lattice
from spheremouse.ball.detect.windows import ANYWHERE, AT_REST, DiscModel, FitSettings, Motion
from spheremouse.ball.points import directions_at
from spheremouse.ball.rig import Rig, view_of
from spheremouse.errors import ConfigurationError
from spheremouse.geometry.camera import MAX_SIDE, Pose
from spheremouse.geometry.matching import suppress
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels
from spheremouse.settings import param

LENS_BLUR = 0.4  # px, standard deviation of an ordinary lens in focus; the fitted size takes up what differs
_MAX_LENS_BLUR = 3.0  # px: `blur_of` saturates beyond
# px of the coarse picture, across a disc that its samples meet: they are 2 px apart, and print is blurred
_MIN_COARSE_DISC_PX = 4.0
_NOISE_EVERY = 16  # frames: the light changes slowly
_MAX_ROUNDS = 3  # of the search for slivers in one picture: struts that cross the limb offer places, too
# px, diameter of a disc that is found as well no finer: larger pictures are searched more coarsely
_MAX_SEARCHED_DISC_PX = 14.0

_MIN_SIGMA_FRACTION = 0.25  # of the settings' sigma: so the contrast still counts when the picture has little noise
_NOTHING_LEARNT = SearchState()
_NO_DISCS = np.zeros((0, 3))

Polarity = Literal["auto", "dark", "light"]
PROJECTIONS: dict[Polarity, Projection] = {"dark": GREY, "light": NEGATIVE}  # in which discs of a polarity are dark


@dataclass(frozen=True, slots=True)
class DiscSettings:
    """Appearance of discs, beyond their geometry."""

    polarity: Polarity = param(
        "auto", "-", "discs are darker or lighter than the ball; auto finds this, and the colours that separate them"
    )
    weights: tuple[float, ...] = param(
        (),
        "-",
        "[blue, green, red]: weights of a sum of colours in which discs are darker than the ball; [] uses polarity",
        ge=-1,
        le=1,
        most=3,
    )
    contrast: float = param(
        0.25,
        "-",
        "least contrast, a part of the lighter of disc and ball; print has 0.8, haze and gloss halve it; an edge has "
        "half of that",
        ge=1e-3,
        le=1,
    )
    masks: tuple[tuple[float, ...], ...] = param(
        (),
        "px",
        "rectangles [left, top, right, bottom] or polygons [x, y, x, y, ...] in which no disc is looked for: buttons, "
        "a screen's reflection",
        ge=-MAX_SIDE,
        le=2 * MAX_SIDE,  # somewhat beyond a picture's edge means: up to it
        most=64,  # a ball has fewer things before it, and they have fewer corners
    )
    # Not settings, since they follow from pixels and print.
    smoothing: float = 0.8  # px, standard deviation of the Gaussian before all else; the fit's 7 px hold at most 1.5
    size_tolerance: float = 0.25  # of the expected size; hand-cut discs and glare on a rim change the fitted size
    min_area: float = 10.0  # px²; a smaller disc is 3.6 px across, the size of noise
    # px, floor of a centre's standard deviation. Errors by sampling, light and print have 0.008 to 0.02 px, but they
    # last for several frames. By the sum of their autocorrelation they equal white noise of 0.014 to 0.038 px.
    sigma: float = 0.03
    rim: float = 0.7  # least part of a disc's rim that must fit; with a fifth hidden, a cut still passes for a rim

    def __post_init__(self) -> None:
        if self.weights and (len(self.weights) != 3 or not any(self.weights)):
            raise ValueError("weights: give [blue, green, red], one of them not 0, or [] to use polarity")
        if self.weights and self.polarity != "auto":
            raise ValueError("weights: they decide which discs are darker: set polarity to auto, or weights to []")
        for mask in self.masks:
            if len(mask) == 4 and (mask[0] > mask[2] or mask[1] > mask[3]):
                raise ValueError("masks: give [left, top, right, bottom], left not above right, top not above bottom")
            if len(mask) < 4 or len(mask) % 2:
                raise ValueError("masks: give 4 edges of a rectangle, or x and y of each corner of a polygon")

    @property
    def projection(self) -> Projection | None:
        """The configured projection of colours; None: the tracker determines it."""
        if self.weights:
            return normalise(np.array(self.weights))
        return PROJECTIONS.get(self.polarity)


class DiscDetector(NamedTuple):
    """The default detector with all data that is constant for one camera pose."""

    settings: DiscSettings
    rig: Rig
    pose: Pose
    window: tuple[slice, slice]  # rows and columns of the ball's bounding box, whole pixels of the coarse picture
    coarse: Image  # 255 on the ball, of the window of the coarse picture
    lattice: Lattice
    slivers: Lattice  # its part near the limb, where discs are too thin for the coarse picture
    model: DiscModel

    def with_projection(self, projection: Projection) -> "DiscDetector":
        """Return the detector with another projection of colours."""
        if projection == self.model.fit.projection:
            return self
        return self._replace(model=self.model._replace(fit=self.model.fit._replace(projection=projection)))

    def with_lens_blur(self, sigma: float | None) -> "DiscDetector":
        """Return the detector for a lens that blurs with a standard deviation, px; None: a lens in focus."""
        blur = _rim_blur(self.settings, LENS_BLUR if sigma is None else sigma)
        if blur == self.model.fit.blur:
            return self
        return self._replace(model=self.model._replace(fit=self.model.fit._replace(blur=blur)))

    def lens_blur(self, image: Image) -> float | None:
        """Return the standard deviation, px, 0.4 to 3, of the lens's blur in an image, by its edges near the ball.

        Returns None if there are no edges.
        """
        blur = blur_of(image[self.window])
        return None if np.isnan(blur) else float(np.clip(blur, LENS_BLUR, _MAX_LENS_BLUR))

    def detect(self, image: Image, learnt: SearchState = _NOTHING_LEARNT) -> Detections:
        """Disc candidates in an image (h, w, 3) BGR or (h, w), look-alikes included.

        `learnt` has the contrast and the size of the discs, if they are known. A spot with less than half of that
        contrast is no disc. With a known size the detector finds discs that a cover hides by half.
        """
        noise = self.noise(image)
        offset = offset_of(self.model.fit.projection, 1 if image.ndim == 2 else 3)
        places, size = self._dark_places(self._grey(image), noise, offset)
        directions, index = directions_at(places, self.rig, self.pose)
        seen = appearance(directions, self.rig, self.pose)
        share = size[index] / seen.area
        # half a disc to one with its shadow; of several regions in one place that which covers a disc best
        plausible = np.flatnonzero((share > 0.3) & (share < 2.5))
        best = plausible[np.argsort(np.abs(np.log(share[plausible])), kind="stable")]
        best = best[suppress(places[index[best]], np.full(len(best), 0.3 * self.model.diameter))]
        found = Detections(
            *kernels.measure_places(
                _with_channels(image), places[index[best]], self.model, noise, learnt.contrast, learnt.size
            )
        )
        return self._with_slivers(found, image, learnt) if self.lattice.reduction > 1 else found

    def _with_slivers(self, found: Detections, image: Image, learnt: SearchState) -> Detections:
        """Return `found` and the discs near the limb, which are too thin for the coarse image.

        The search tries each place at most once. It ends when a round of all shifts finds no new place.
        """
        near_limb, idle = self._replace(lattice=self.slivers), 0
        state = SearchState(contrast=learnt.contrast)
        shifts = len(self.slivers.samples)
        while idle < shifts and state.turn < _MAX_ROUNDS * shifts:
            more, after = near_limb.follow(image, state, known=found.centre)
            idle = idle + 1 if len(more) == 0 and len(after.rejected) == len(state.rejected) else 0
            found, state = found.joined(more), after
        return found

    def follow(
        self,
        image: Image,
        state: SearchState,
        directions: Array = _NO_DISCS,
        motion: Motion = AT_REST,
        known: Array = ANYWHERE,
        least: int = 0,
    ) -> tuple[Detections, SearchState]:
        """Measure the discs that are expected at `directions`, (n, 3) unit vectors in obj, and search for others.

        The ball's `motion` carries the discs on to when their row is exposed, and smears them while it is. The search
        covers a part of the ball that `state` selects. It leaves out the discs and the places `known`, (m, 2) px. If
        fewer than `least` discs are seen, there is no search. `state` remembers noise, size and contrast of the discs.
        """
        colours = _with_channels(image)
        if state.turn % _NOISE_EVERY == 0 or state.noise == 0.0:
            samples = self._noise(colours, sample_weights_of(self.model.fit.projection, colours.shape[2]))
            state = state._replace(noise=self.noise(colours), sample_noise=samples)
        centre, covariance, area, after = kernels.follow_discs(
            colours, directions, self.model, self.lattice.of_turn(state.turn), state, motion, known, least
        )
        return Detections(centre, covariance, area), SearchState(*after)

    def information(self, image: Image) -> float:
        """Return the information about the centres of the discs in an image, in noise-free discs."""
        sigma = self.settings.sigma  # of each covariance, a constant part
        noise = np.maximum(0.5 * np.trace(self.detect(image).covariance, axis1=1, axis2=2) - sigma**2, 0.0)
        finest = (_MIN_SIGMA_FRACTION * sigma) ** 2
        return float(np.sum(finest / (finest + noise)))

    def noise(self, image: Image) -> float:
        """Standard deviation of one pixel of the projection, grey values."""
        colours = _with_channels(image)
        return self._noise(colours, weights_of(self.model.fit.projection, colours.shape[2]))

    def _noise(self, colours: Image, weights: NDArray[np.float32]) -> float:
        """Return the standard deviation of one pixel in the sum of colours, (h, w, c), with `weights`, (c,)."""
        rows, columns = self.window
        return kernels.noise_of(colours, weights, rows.start, rows.stop, columns.start, columns.stop)

    def _grey(self, image: Image) -> Image:
        """Smoothed projection of the window, coarse, dark discs."""
        grey = projected(image[self.window], self.model.fit.projection)
        f = self.lattice.reduction
        if f > 1:
            grey = cv2.resize(grey, (grey.shape[1] // f, grey.shape[0] // f), interpolation=cv2.INTER_AREA)
        return cv2.GaussianBlur(grey, (0, 0), self.settings.smoothing) if self.settings.smoothing > 0 else grey

    def _dark_places(self, grey: Image, noise: float, offset: float) -> tuple[Array, Array]:
        """Return compact regions darker than their surroundings: centroids (n, 2) px and areas, px², in the full image.

        The search uses three levels. The low one detects slivers at the limb. The high one separates a disc from a
        shadow.
        """
        f = self.lattice.reduction
        diameter, least = self.model.diameter / f, 0.3 * self.settings.min_area / f**2
        width = 2 * int(np.ceil(0.75 * diameter)) + 1
        background = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8))
        deep = cv2.inRange(cv2.subtract(background, grey), np.array(4.0 * noise / f + 1.0), np.array(255.0))
        deep = cv2.bitwise_and(deep, self.coarse)
        places, sizes = [], []
        for share in (0.6, 1.2, 2.4):
            level = cv2.LUT(background, _levels(min(share * self.settings.contrast, 0.95), offset))
            dark = cv2.bitwise_and(cv2.compare(grey, level, cv2.CMP_LT), deep)
            contours, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            for contour in contours:
                if len(contour) < 4:
                    continue
                _, _, w, h = cv2.boundingRect(contour)
                if max(w, h) > 1.2 * diameter + 3:
                    continue
                # the outline runs through pixel centres: Pick's theorem gives the pixels it holds
                area = cv2.contourArea(contour) + 0.5 * len(contour) + 1.0
                if area < least:
                    continue
                places.append(_centroid(contour))
                sizes.append(area)
        origin = (self.window[1].start, self.window[0].start)
        return np.array(places).reshape(-1, 2) * f + 0.5 * (f - 1) + origin, np.array(sizes) * f**2


def unmasked(mask: Image, masks: Iterable[tuple[float, ...]]) -> Image:
    """Return a mask, (h, w), with 0 in rectangles and polygons, the outlines included."""
    for place in masks:
        corners = np.array(place)[[0, 1, 2, 1, 2, 3, 0, 3] if len(place) == 4 else slice(None)].reshape(-1, 2)
        cv2.fillPoly(mask, [np.rint(corners).astype(np.int32)], 0)
    return mask


def disc_detector(settings: DiscSettings, rig: Rig, pose: Pose, before: object = None) -> DiscDetector:
    """Prepare the detector for one camera pose.

    Raises ConfigurationError if the masks hide the whole ball, or if a disc is too large for the picture.

    The choice of the pixels to sample takes 20 ms. If `before` is a detector with equal masks and the same rig and pose
    objects, only its settings are replaced.
    """
    fit = FitSettings(
        settings.projection or GREY,
        settings.smoothing,
        _rim_blur(settings, LENS_BLUR),
        settings.contrast,
        settings.size_tolerance,
        settings.rim,
        settings.sigma,
    )
    if (
        isinstance(before, DiscDetector)
        and before.rig is rig
        and before.pose is pose
        and before.settings.masks == settings.masks
    ):
        return before._replace(settings=settings, model=before.model._replace(fit=fit, min_area=settings.min_area))
    diameter = largest_disc(rig, pose)
    f = max(int(np.rint(diameter / _MAX_SEARCHED_DISC_PX)), 1)
    mask = unmasked(clear_mask(rig, pose), settings.masks)
    if not mask.any():
        raise ConfigurationError("discs.masks: they leave nothing of the ball: give smaller ones")
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    height, width = mask.shape
    window = (
        slice(int(rows[0]) // f * f, min((int(rows[-1]) // f + 1) * f, height // f * f)),
        slice(int(columns[0]) // f * f, min((int(columns[-1]) // f + 1) * f, width // f * f)),
    )
    if any(part.start >= part.stop for part in window):
        raise ConfigurationError(
            f"rig: disc_radius: a disc is {diameter:.0f} px wide, too large for the part of the ball in the picture",
            "check disc_radius, the camera's focal lengths, and the positions",
        )
    model = DiscModel(view_of(rig, pose), mask, float(rig.exposure_s), fit, settings.min_area, diameter)
    coarse = cv2.erode(mask, np.ones((2 * f - 1, 2 * f - 1), np.uint8))[window][f // 2 :: f, f // 2 :: f]
    thin = _thin(rig, pose, diameter, f)
    samples = lattice(mask, thin, diameter, f)
    return DiscDetector(settings, rig, pose, window, coarse, samples, samples.at(thin), model)


def _rim_blur(settings: DiscSettings, lens: float) -> float:
    """Return the standard deviation, px, of a rim's blur by pixels, lens and our own smoothing."""
    return math.sqrt(settings.smoothing**2 + 1.0 / 12.0 + lens**2)


def _thin(rig: Rig, pose: Pose, diameter: float, reduction: int) -> NDArray[np.bool_]:
    """Pixels, (h, w), at which a disc is so aslant that a coarse picture does not show it."""
    mask = ball_mask(rig, pose)
    if reduction == 1:
        return np.zeros(mask.shape, dtype=np.bool_)
    radius = 0.5 * diameter / np.sin(rig.disc_angle)  # px, of the ball
    cosine = min(_MIN_COARSE_DISC_PX * reduction / diameter, 1.0)
    depth = radius * (1.0 - np.sqrt(1.0 - cosine**2))  # px from the limb
    return cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_5) < depth


def _levels(part: float, offset: float) -> NDArray[np.uint8]:
    """Return the highest grey value of a disc, (256,), for each value of the ball; `offset` is the value of black.

    They differ by a `part` of the light of the lighter of the two: of the ball's, and of the disc's.
    """
    ball = np.arange(256.0) - offset
    return np.clip(np.rint(np.minimum(ball * (1.0 - part), ball / (1.0 - part)) + offset), 0, 255).astype(np.uint8)


def _with_channels(image: Image) -> Image:
    return np.ascontiguousarray(image if image.ndim == 3 else image[:, :, None])


def _centroid(contour: Image) -> tuple[float, float]:
    m = cv2.moments(contour)
    if m["m00"] > 0:
        return m["m10"] / m["m00"], m["m01"] / m["m00"]
    x, y = contour[:, 0].mean(axis=0)
    return float(x), float(y)
