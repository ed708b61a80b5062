"""Peaks of the likelihood: poses that a picture supports, looked for, climbed and weighed."""

from dataclasses import dataclass, replace

import numpy as np

from spheremouse.geometry.rotation import Array
from spheremouse.wand import limb
from spheremouse.wand.ball import WandBall
from spheremouse.wand.colour import Fields, Region, Tone, fields, reduction
from spheremouse.wand.likelihood import log_likelihood
from spheremouse.wand.model import Model
from spheremouse.wand.particles import (
    Peaks,
)
from spheremouse.wand.refine import Peak, refine
from spheremouse.wand.rims import Image
from spheremouse.wand.settings import WandSettings
from spheremouse.wand.spots import spots
from spheremouse.wand.start import convincing, distinct, hypotheses, same
from spheremouse.wand.state import WandTracker

_MOST_PEAKS = 3  # of the likelihood followed at a time: a pose, its mirror, a second ball
_WORSE = 15.0  # log-likelihood below the best at which a peak is none
_WIDER = 1.5  # covariance of a proposal over that of its peak: the likelihood has thicker tails than a Gaussian
SURE = 0.8  # match of a pose that is believed at first sight: less is looked at twice, or is the mirror of the truth
_STRONG, _LENIENT = 2.0, 0.15  # times the evidence asked for: a pose that has it may match so much less
_COARSE = 36.0  # px across: in a picture so far reduced, a hypothesis is within reach of its peak
HIDDEN_LEVEL = 0.4  # of that level: below, and with a poor match, more than half is hidden or it is another thing
ELSEWHERE = 0.5  # of that level: what has less, elsewhere in the picture, is not the ball but a thing of its colours
_FLANK = 0.15  # of the field's range: poses half a pixel from a peak are told from others yet
_ROUNDS, _ROUNDS_NEAR = 8, 3  # of the refinement, from a hypothesis and from the flank of a peak
_STEEP = 0.5  # `Peak.slope` above which a pose is still on its way: half a standard deviation off
_DISCS = 3  # that show of a pose nothing led to: any two spots are explained by some pose


class Scene:
    """One picture and what has been made of it so far: the whole picture's fields are made at most once."""

    def __init__(self, image: Image, tracker: WandTracker, known: Tone) -> None:
        self.image = image
        self.tracker = tracker
        self.tone = known
        self.whole: Fields | None = None
        self.searched = False

    def all(self) -> Fields:
        """Fields of the whole picture."""
        if self.whole is None:
            self.whole = self.part(None, 1)
        return self.whole

    def part(self, region: Region | None, factor: int) -> Fields:
        """Fields of a region."""
        return fields(self.image, self.tracker.colours, self.tracker.names, region, factor, self.tone)


@dataclass(frozen=True, slots=True)
class SearchContext:
    """One ball that is looked for in one picture."""

    scene: Scene
    index: int  # of the ball
    others: list[Array]  # (3,) m, cam: where other balls are

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
class Found:
    """Peaks of one ball in one picture, the best first."""

    peaks: tuple[Peak, ...]
    log_likelihood: Array  # (k,)
    match: Array  # (k,)
    fields: Fields | None
    turn: int = 0  # spot with which the next search begins

    @property
    def position(self) -> Array:
        """(k, 3) m, cam."""
        return np.array([k.position for k in self.peaks]).reshape(-1, 3)

    @property
    def rotation(self) -> Array:
        """(k, 3, 3) R_cam_ball."""
        return np.array([k.rotation for k in self.peaks]).reshape(-1, 3, 3)


def some_peaks(found: Found, kept: list[int]) -> Found:
    """Some of its peaks."""
    return replace(
        found,
        peaks=tuple(found.peaks[i] for i in kept),
        log_likelihood=found.log_likelihood[kept],
        match=found.match[kept],
    )


def passes_without_prior(found: Found, sought: SearchContext) -> Found:
    """Those of its peaks that would be a ball if nothing led to them."""
    tracker, kept = sought.tracker, []
    if found.fields is None:
        return found
    for i, k in enumerate(found.peaks):
        discs, bare = convincing(
            sought.scene.image, k.position, k.rotation, sought.ball, sought.model, tracker.camera, found.fields
        )
        if discs >= _DISCS and bare >= tracker.settings.match:
            kept.append(i)
    return some_peaks(found, kept)


def _weighed(peaks: list[Peak], m: Model, seen: Fields) -> tuple[Array, Array]:
    """Log-likelihood ratio and match of peaks."""
    position = np.array([k.position for k in peaks])
    out, match = log_likelihood(position, np.array([k.rotation for k in peaks]), m, seen)
    limb.weigh(position, np.arange(len(peaks)), np.array([k.edges for k in peaks]), m.radius, m.lens, seen.factor, out)
    return out, match


def refine_modes(
    position: Array,
    rotation: Array,
    most: int,
    sought: SearchContext,
    seen: Fields,
    outline: bool = True,
    sure: float = 0.0,
) -> Found:
    """Peaks near the best of some poses; of the best alone where its log-likelihood is above `sure`."""
    m, radius = sought.model, sought.ball.radius
    empty = Found((), np.zeros(0), np.zeros(0), seen)
    if len(position) == 0:
        return empty
    first, _ = log_likelihood(position, rotation, m, seen, _FLANK)
    rounds = _ROUNDS
    if sure and first.max() > sure:
        most, rounds = 1, _ROUNDS_NEAR
    order = np.argsort(-first, kind="stable")
    starts = order[distinct(position[order], rotation[order], 0.5 * radius, most)]
    none = np.zeros((limb.DIRECTIONS, 5))
    peaks = [refine(position[i], rotation[i], m, seen, none, rounds) for i in starts]
    if len(peaks) > _MOST_PEAKS:  # only those that come to something are climbed to the end
        value, _ = _weighed(peaks, m, seen)
        peaks = [peaks[i] for i in np.argsort(-value, kind="stable")[: 2 * _MOST_PEAKS] if value[i] > 0.0]
    peaks = [_converged(k, m, seen) for k in peaks]
    peaks = [k for k in peaks if _in_view(k, sought)]
    if not peaks:
        return empty
    value, match = _weighed(peaks, m, seen)
    least = min(value.max() - 2.0 * _WORSE, 0.5 * value.max())  # a second ball is worth a word, if not a particle
    best = [peaks[i] for i in np.argsort(-value) if value[i] > least][: 4 * _MOST_PEAKS]
    position, rotation = np.array([k.position for k in best]), np.array([k.rotation for k in best])
    chosen = [best[i] for i in distinct(position, rotation, radius, _MOST_PEAKS)]
    if outline and sought.tracker.settings.outline:
        chosen = [_outlined(k, sought, seen) for k in chosen]
    value, match = _weighed(chosen, m, seen)
    order = np.argsort(-value)
    return Found(tuple(chosen[i] for i in order), value[order], match[order], seen)


def _in_view(peak: Peak, sought: SearchContext) -> bool:
    """Is it in reach of the camera, and neither before nor behind another ball?"""
    s, p, radius = sought.tracker.settings, peak.position, sought.ball.radius
    return s.nearest < p[2] < 1.2 * s.farthest and all(
        np.linalg.norm(p[:2] / p[2] - o[:2] / o[2]) > radius / p[2] for o in sought.others
    )


def _outlined(peak: Peak, sought: SearchContext, seen: Fields) -> Peak:
    """The peak, climbed on with the ball's outline as it is measured there."""
    m, discs = sought.model, sought.tracker.discs[sought.index]
    p, R = peak.position, peak.rotation
    edges = limb.measure(sought.scene.image, p, R, discs, sought.ball.radius, m.lens, seen.factor)
    return _converged(refine(p, R, m, seen, edges, _ROUNDS_NEAR), m, seen)


def _converged(peak: Peak, m: Model, seen: Fields) -> Peak:
    """The peak, climbed to the end where a few rounds did not reach it."""
    for _ in range(2):
        if peak.slope >= _STEEP:
            peak = refine(peak.position, peak.rotation, m, seen, peak.edges, _ROUNDS)
    return peak


def _one(a: Peak, b: Peak, radius: float) -> bool:
    return same(a.position, a.rotation, b.position, b.rotation, radius)


def accepted(found: Found, settings: WandSettings, level: float = 0.0) -> bool:
    """Is the best peak the ball? `level`: what its log-likelihood has been of late; 0 where it is not followed yet.

    A highlight or a hand takes points away, but what is left of a ball says more than anything that happens to match.
    """
    if not found.peaks:
        return False
    value, match = float(found.log_likelihood[0]), float(found.match[0])
    strong = value >= max(_STRONG * settings.evidence, ELSEWHERE * level)
    if value < settings.evidence or match < settings.match - (_LENIENT if strong else 0.0):
        return False
    return bool(strong or match >= SURE or (level > 0.0 and value >= HIDDEN_LEVEL * level))


def search(sought: SearchContext, turn: int) -> Found:
    """Peaks in the whole picture, from spot `turn` on."""
    sought.scene.searched = True
    return from_spots(sought, sought.scene.all(), 12, turn)


def from_spots(sought: SearchContext, seen: Fields, most: int, turn: int = 0) -> Found:
    """Peaks from the spots of a region.

    A hypothesis is as exact as the ball is near round and far away, some hundredths of its diameter. So near balls are
    looked for in reduced pictures first.
    """
    tracker, ball = sought.tracker, sought.ball
    guess = hypotheses(spots(seen), ball, tracker.camera, tracker.names, tracker.settings, first=turn)
    across = 2.0 * tracker.camera.fx * ball.radius / np.maximum(guess.position[:, 2], ball.radius)
    coarse = np.maximum(np.rint(across / _COARSE), seen.factor).astype(int)
    position, rotation = [], []
    for factor in np.unique(coarse):
        group = coarse == factor
        if factor == seen.factor:
            position.append(guess.position[group])
            rotation.append(guess.rotation[group])
            continue
        reduced = sought.scene.part(whole_region(seen), int(factor))
        part = int(np.ceil(most * np.mean(group)))
        found = refine_modes(guess.position[group], guess.rotation[group], part, sought, reduced, outline=False)
        position.append(found.position)
        rotation.append(found.rotation)
    if not position:
        return Found((), np.zeros(0), np.zeros(0), seen, guess.following)
    found = refine_modes(np.concatenate(position), np.concatenate(rotation), most, sought, seen)
    if found.peaks:
        factor = reduction(2.0 * tracker.camera.fx * ball.radius / found.peaks[0].position[2])
        if factor > seen.factor:
            larger = sought.scene.part(whole_region(seen), factor)
            found = refine_modes(found.position, found.rotation, _MOST_PEAKS, sought, larger)
    return replace(found, turn=guess.following)


def whole_region(seen: Fields) -> Region:
    """The part of the picture that fields cover."""
    h, w = seen.binary.shape[1:]
    return seen.left, seen.top, seen.left + w * seen.factor, seen.top + h * seen.factor


def as_peaks(found: Found) -> Peaks:
    covariance = np.array([_WIDER * k.covariance for k in found.peaks])
    _, log_det = np.linalg.slogdet(covariance)
    mass = found.log_likelihood + 0.5 * log_det + 3.0 * np.log(2.0 * np.pi)
    return Peaks(found.position, found.rotation, covariance, mass)


def joined(a: Found, b: Found, radius: float) -> Found:
    """Peaks of two searches. Both are judged by the fields of the better: they may lie in different parts."""
    if not b.peaks:
        return a
    if not a.peaks:
        return b
    best, rest = (a, b) if a.log_likelihood[0] >= b.log_likelihood[0] - 1.0 else (b, a)
    if best.fields is rest.fields:
        peaks, value, match = list(best.peaks), list(best.log_likelihood), list(best.match)
        for k, v, m in zip(rest.peaks, rest.log_likelihood, rest.match, strict=True):
            if len(peaks) < _MOST_PEAKS and not any(_one(k, c, radius) for c in peaks):
                peaks.append(k)
                value.append(v)
                match.append(m)
        return Found(tuple(peaks), np.array(value), np.array(match), best.fields)
    return best
