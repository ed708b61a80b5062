"""Particles drawn by motion alone, as published."""

from dataclasses import replace

import numpy as np

from spheremouse.tracker import Status
from spheremouse.wand.colour import Fields
from spheremouse.wand.edge import distances, on_edges
from spheremouse.wand.likelihood import log_likelihood, published
from spheremouse.wand.particles import (
    Motions,
    Particles,
    effective,
    estimate,
    low_variance,
    moved,
    normalised,
)
from spheremouse.wand.peaks import SearchContext, whole_region
from spheremouse.wand.state import Track, WandPose

REDRAW = 0.5  # of the particles that count, below which they are resampled


def some(particles: Particles, n: int, rng: np.random.Generator) -> Particles:
    """n particles drawn by weight, of equal weight."""
    i = low_variance(particles.weight, n, rng.random())
    return Particles(particles.position[i], particles.rotation[i], np.full(n, 1.0 / n))


def by_motion(
    track: Track, stamp: float, motions: Motions, seen: Fields, sought: SearchContext, rng: np.random.Generator
) -> tuple[Track, WandPose]:
    """The thesis' step (Grzonka 2005, table 3), for comparison: move at random, weigh one way or another, resample."""
    assert track.particles is not None
    ahead = moved(track.particles, motions, rng)
    m, likelihood = sought.model, sought.tracker.settings.likelihood
    if likelihood == "edges":
        away, place = distances(sought.scene.image, whole_region(seen), seen.factor)
        value, match = on_edges(ahead.position, ahead.rotation, m, away, place)
    else:
        weigh = published if likelihood == "product" else log_likelihood
        value, match = weigh(ahead.position, ahead.rotation, m, seen)
    weight, _ = normalised(np.log(np.maximum(ahead.weight, 1e-300)) + value)
    count = effective(weight)
    particles = Particles(ahead.position, ahead.rotation, weight)
    pose = estimate(particles)
    if count < REDRAW * len(weight):
        particles = some(particles, len(weight), rng)
    after = replace(track, particles=particles, pose=pose, stamp=stamp, seen=stamp)
    return after, WandPose(sought.ball.name, *pose, Status.TRACKING, None, float(weight @ match), count, True)
