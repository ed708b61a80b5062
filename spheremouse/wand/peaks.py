"""Peaks of the likelihood: search for them, refine them, verify them."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.rotation import Array
from spheremouse.wand.ball import WandBall
from spheremouse.wand.colour import Fields, PictureColours, Region, colour_fields, reduction_factor
from spheremouse.wand.likelihood import (
    DIRECTIONS,
    Peak,
    log_likelihood,
    measure_edges,
    outline_log_likelihood,
    refine_pose,
    support,
)
from spheremouse.wand.model import Model
from spheremouse.wand.motions import search_region
from spheremouse.wand.particles import MotionMixture, PeakMixture
from spheremouse.wand.rims import Image
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.start import distinct_poses, evidence_without_prior, find_spots, pose_hypotheses
from spheremouse.wand.state import Track, WandTracker

_MAX_PEAKS = 3  # of the likelihood: a pose, its mirror, a second ball
_MAX_LOG_LIKELIHOOD_LOSS = 15.0  # against the best peak
# covariance of a proposal over that of its peak: the likelihood has thicker tails than a Gaussian
_PROPOSAL_WIDTH = 1.5
CERTAIN_MATCH = 0.8  # match of a pose that is accepted at first sight: less may be the mirror of the true pose
_STRONG_EVIDENCE = 2.0  # times the required evidence: a pose with that much passes with half of its discs
_COARSE_DIAMETER = 36.0  # px: in a picture reduced so far, a hypothesis converges to its peak
_MIN_SUPPORT = 0.5  # below, as of the match, the picture is more like that of a hidden ball than like a clear view
_SUFFICIENT_SUPPORT = 0.65  # a predicted pose with as much is near the right peak
_COARSE_SIGMA = 0.15  # of the field's range: ranks poses half a pixel from a peak
_MAX_ROUNDS, _MAX_ROUNDS_NEAR = 8, 3  # of the refinement, from a hypothesis and from near a peak
_MAX_SLOPE = 0.5  # `Peak.slope` of a converged pose: half a standard deviation off
_MIN_DISCS = 3  # some pose explains any two spots: six unknowns need three discs, or two and the outline


class Scene:
    """One picture and its weight fields. The fields of the whole picture are computed once at most."""

    def __init__(self, image: Image, tracker: WandTracker, colours: PictureColours) -> None:
        """`image` is (h, w, 3) BGR."""
        self.image = image
        self.tracker = tracker
        self.colours = colours
        self.whole: Fields | None = None
        self.searched = False

    def all(self) -> Fields:
        """Return the fields of the whole picture."""
        if self.whole is None:
            self.whole = self.part(region=None, factor=1)
        return self.whole

    def part(self, region: Region | None, factor: int) -> Fields:
        """Return the fields of a region, reduced `factor` times; None is the whole picture."""
        return colour_fields(self.image, self.tracker.colours, self.tracker.names, region, factor, self.colours)


@dataclass(frozen=True, slots=True)
class SearchContext:
    """Search for one ball in one picture."""

    scene: Scene
    index: int  # of the ball
    others: list[Array]  # (3,) m, cam: positions of the other balls
    lens_blur: Array  # (c,) or () px, `Fields.with_lens_blur`

    def part(self, region: Region | None, factor: int) -> Fields:
        """Return the fields of a region, reduced `factor` times, with the ball's blur; None is the whole picture."""
        return self.scene.part(region, factor).with_lens_blur(self.lens_blur)

    @property
    def tracker(self) -> WandTracker:
        return self.scene.tracker

    @property
    def ball(self) -> WandBall:
        return self.scene.tracker.balls[self.index]

    @property
    def model(self) -> Model:
        return self.scene.tracker.models[self.index]


@dataclass(frozen=True, slots=True)
class Modes:
    """Peaks of one ball in one picture, the best first."""

    peaks: tuple[Peak, ...]
    log_likelihood: Array  # (k,) ratio against a picture without the ball
    match: Array  # (k,) fraction of the coloured points that show their colour
    support: Array  # (k,) of the discs: 0 if none shows, 1 in a clear view, `likelihood.support`
    fields: Fields | None
    next_spot: int = 0  # spot with which the next search begins

    @property
    def position(self) -> Array:
        """(k, 3) m, cam."""
        return np.array([k.position for k in self.peaks]).reshape(-1, 3)

    @property
    def rotation(self) -> Array:
        """(k, 3, 3) R_cam_ball."""
        return np.array([k.rotation for k in self.peaks]).reshape(-1, 3, 3)

    def select(self, kept: list[int] | NDArray[np.int64]) -> "Modes":
        """Return the peaks of these indices, (k,), in their order."""
        peaks = tuple(self.peaks[i] for i in kept)
        return replace(
            self,
            peaks=peaks,
            log_likelihood=self.log_likelihood[kept],
            match=self.match[kept],
            support=self.support[kept],
        )


def fields_near(track: Track, motions: MotionMixture, context: SearchContext) -> Fields:
    """Return the fields of the part of the picture that a tracked ball can reach, with its motion in the exposure.

    If the setting `region` is off, return those of the whole picture, which also show a problem with the colours.
    """
    scene, s = context.scene, context.tracker.settings
    region, factor = search_region(track, motions, context.tracker, context.ball.radius)
    fields = context.part(region if s.region else None, factor)
    if not s.region and factor == 1:
        scene.whole = fields
    return replace(fields, exposure_motion=track.exposure_motion)


def modes_without_prior(modes: Modes, context: SearchContext) -> Modes:
    """Return the peaks with evidence for a pose that no motion leads to.

    They show three discs and a bare ball between them, and the edges of the picture do not contradict the outline.
    """
    least = context.tracker.settings.match
    shows = [_visible_parts(k, modes, context) for k in modes.peaks]
    return modes.select(
        [
            i
            for i, (discs, bare, outline) in enumerate(shows)
            if discs >= _MIN_DISCS and bare >= least and outline >= 0.0
        ]
    )


def determines_pose(peak: Peak, modes: Modes, context: SearchContext) -> bool:
    """Return true if a peak shows as many measurements as unknowns.

    They are three discs; or two and the outline; or one, the outline, and a bare body where no disc is.
    """
    discs, bare, outline = _visible_parts(peak, modes, context)
    body = bare >= context.tracker.settings.match
    return discs >= _MIN_DISCS or (outline > 0.0 and discs + body >= _MIN_DISCS - 1)


def _visible_parts(peak: Peak, modes: Modes, context: SearchContext) -> tuple[int, float, float]:
    """Return the number of discs, the bare fraction of the body, and the log-likelihood ratio of the outline."""
    assert modes.fields is not None
    discs, bare = evidence_without_prior(
        context.scene.image, peak.position, peak.rotation, context.ball, context.model, context.tracker.camera,
        modes.fields,
    )  # fmt: skip
    first, factor = np.zeros(1, dtype=np.int64), modes.fields.factor
    outline = outline_log_likelihood(peak.position[None], first, peak.edges[None], context.model, factor)
    return discs, bare, float(outline[0])


def _weigh(peaks: list[Peak], m: Model, fields: Fields) -> Modes:
    """Return peaks with log-likelihood ratio and match, in the same order."""
    position = np.array([k.position for k in peaks])
    edges = np.array([k.edges for k in peaks])
    rotation = np.array([k.rotation for k in peaks])
    value, match = log_likelihood(position, rotation, m, fields)
    supports = support(value, position, rotation, m, fields)
    outline = outline_log_likelihood(position, np.arange(len(peaks)), edges, m, fields.factor)
    return Modes(tuple(peaks), value + outline, match, supports, fields)


def refine_modes(
    position: Array,
    rotation: Array,
    count: int,
    context: SearchContext,
    fields: Fields,
    outline: bool = True,
    near: bool = False,
) -> Modes:
    """Refine the `count` best of n poses, (n, 3) m in cam and R_cam_ball (n, 3, 3), to peaks of the likelihood.

    If they are `near` a peak and the best one has 0.65 of the evidence of a clear view, refine that one alone.
    """
    m, radius = context.model, context.ball.radius
    empty = Modes((), np.zeros(0), np.zeros(0), np.zeros(0), fields)
    if len(position) == 0:
        return empty
    first, _ = log_likelihood(position, rotation, m, fields, _COARSE_SIGMA)
    rounds = _MAX_ROUNDS
    order = np.argsort(-first, kind="stable")
    best = order[:1]
    if near and support(first[best], position[best], rotation[best], m, fields) > _SUFFICIENT_SUPPORT:
        count, rounds = 1, _MAX_ROUNDS_NEAR
    starts = order[distinct_poses(position[order], rotation[order], 0.5 * radius, count)]
    none = np.zeros((DIRECTIONS, 5))
    peaks = [refine_pose(position[i], rotation[i], m, fields, none, rounds) for i in starts]
    if len(peaks) > _MAX_PEAKS:  # further rounds for the promising ones only
        value = _weigh(peaks, m, fields).log_likelihood
        peaks = [peaks[i] for i in np.argsort(-value, kind="stable")[: 2 * _MAX_PEAKS] if value[i] > 0.0]
    peaks = [_converge(k, m, fields) for k in peaks]
    peaks = [k for k in peaks if _in_view(k, context)]
    if not peaks:
        return empty
    modes = _weigh(peaks, m, fields)
    value = modes.log_likelihood
    # a second ball is reported although it gets no particles
    least = min(value.max() - 2.0 * _MAX_LOG_LIKELIHOOD_LOSS, 0.5 * value.max())
    modes = modes.select([i for i in np.argsort(-value) if value[i] > least][: 4 * _MAX_PEAKS])
    chosen = [modes.peaks[i] for i in distinct_poses(modes.position, modes.rotation, radius, _MAX_PEAKS)]
    if outline and context.tracker.settings.outline:
        chosen = [_refine_with_outline(k, context, fields) for k in chosen]
    modes = _weigh(chosen, m, fields)
    return modes.select(np.argsort(-modes.log_likelihood))


def _in_view(peak: Peak, context: SearchContext) -> bool:
    """Return true within the range of distances, unless another ball is in front of or behind this one."""
    s, p, radius = context.tracker.settings, peak.position, context.ball.radius
    return s.nearest < p[2] < 1.2 * s.farthest and all(
        np.linalg.norm(p[:2] / p[2] - o[:2] / o[2]) > radius / p[2] for o in context.others
    )


def _refine_with_outline(peak: Peak, context: SearchContext, fields: Fields) -> Peak:
    m, discs = context.model, context.tracker.discs[context.index]
    p, R = peak.position, peak.rotation
    edges = measure_edges(context.scene.image, p, R, discs, m, fields.factor)
    return _converge(refine_pose(p, R, m, fields, edges, _MAX_ROUNDS_NEAR), m, fields)


def _converge(peak: Peak, m: Model, fields: Fields) -> Peak:
    """Refine a peak further, up to twice, if its slope shows that it has not converged."""
    for _ in range(2):
        if peak.slope >= _MAX_SLOPE:
            peak = refine_pose(peak.position, peak.rotation, m, fields, peak.edges, _MAX_ROUNDS)
    return peak


def is_ball(modes: Modes, settings: WandSettings) -> bool:
    """Return true if the best peak is the ball.

    A highlight or a hand hides points, but the rest of a ball has more evidence than an accidental match. The bounds
    depend on pose and picture alone: a recent level of evidence would fall with a track that goes wrong.
    """
    if not modes.peaks:
        return False
    value, match, shows = (float(one[0]) for one in (modes.log_likelihood, modes.match, modes.support))
    least = _MIN_SUPPORT if value >= _STRONG_EVIDENCE * settings.evidence else settings.match
    return value >= settings.evidence and match >= _MIN_SUPPORT and shows >= least


def search_picture(context: SearchContext, first_spot: int) -> Modes:
    """Return the peaks in the whole picture, from spot `first_spot` on."""
    context.scene.searched = True
    fields = context.scene.all().with_lens_blur(context.lens_blur)
    return modes_from_spots(context, fields, 12, first_spot)


def modes_from_spots(context: SearchContext, fields: Fields, count: int, first_spot: int = 0) -> Modes:
    """Return peaks from the `count` best hypotheses that the spots of a region give, from spot `first_spot` on.

    A hypothesis is wrong by some hundredths of the ball's diameter. Hypotheses of a large ball are therefore refined in
    a reduced picture first, in groups of one reduction. At last the peaks are refined in the picture in which a tracked
    ball of the best peak's size would be measured.
    """
    tracker, ball = context.tracker, context.ball
    guess = pose_hypotheses(find_spots(fields), ball, tracker.camera, tracker.names, tracker.settings, first_spot)
    across = 2.0 * tracker.camera.fx * ball.radius / np.maximum(guess.position[:, 2], ball.radius)
    coarse = np.maximum(np.rint(across / _COARSE_DIAMETER), fields.factor).astype(int)
    position, rotation = [np.zeros((0, 3))], [np.zeros((0, 3, 3))]
    for factor in np.unique(coarse):
        group = coarse == factor
        if factor == fields.factor:
            position.append(guess.position[group])
            rotation.append(guess.rotation[group])
            continue
        reduced = context.part(covered_region(fields), int(factor))
        group_count = int(np.ceil(count * np.mean(group)))
        modes = refine_modes(guess.position[group], guess.rotation[group], group_count, context, reduced, outline=False)
        position.append(modes.position)
        rotation.append(modes.rotation)
    modes = refine_modes(np.concatenate(position), np.concatenate(rotation), count, context, fields)
    if modes.peaks:
        factor = reduction_factor(2.0 * tracker.camera.fx * ball.radius / modes.peaks[0].position[2])
        if factor > fields.factor:
            reduced = context.part(covered_region(fields), factor)
            modes = refine_modes(modes.position, modes.rotation, _MAX_PEAKS, context, reduced)
    return replace(modes, next_spot=guess.next_spot)


def covered_region(fields: Fields) -> Region:
    """Return the part of the picture that fields cover, px."""
    h, w = fields.binary.shape[1:]
    return fields.left, fields.top, fields.left + w * fields.factor, fields.top + h * fields.factor


def proposals(modes: Modes) -> PeakMixture:
    """Return Gaussians from which to draw particles, wider than their peaks."""
    covariance = np.array([_PROPOSAL_WIDTH * k.covariance for k in modes.peaks])
    _, log_det = np.linalg.slogdet(covariance)
    mass = modes.log_likelihood + 0.5 * log_det + 3.0 * np.log(2.0 * np.pi)
    return PeakMixture(modes.position, modes.rotation, covariance, mass)


def merge_modes(a: Modes, b: Modes, radius: float) -> Modes:
    """Return the distinct peaks of two searches in the same fields, or the better search if the fields differ."""
    if not b.peaks:
        return a
    if not a.peaks:
        return b
    best, rest = (a, b) if a.log_likelihood[0] >= b.log_likelihood[0] - 1.0 else (b, a)
    if best.fields is not rest.fields:
        return best
    value, match, support = (
        np.concatenate([getattr(k, name) for k in (best, rest)]) for name in ("log_likelihood", "match", "support")
    )
    both = Modes((*best.peaks, *rest.peaks), value, match, support, best.fields)
    return both.select(distinct_poses(both.position, both.rotation, radius, _MAX_PEAKS, kept=len(best.peaks)))
