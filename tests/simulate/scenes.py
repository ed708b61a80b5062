"""A small scene, other scenes made from it, and their pictures."""

from dataclasses import replace

import numpy as np

from spheremouse.simulate.ball.pattern import Pattern
from spheremouse.simulate.ball.render import Renderer

LENS = np.array([-0.2, 0.06, 0.001, -0.0015, -0.01])


def rng(seed=0):
    return np.random.default_rng(seed)


def rms(a):
    return float(np.sqrt(np.mean(np.square(a))))


class Fixed:
    seconds = 1.0

    def __init__(self, attitude):
        self.at_rest = attitude

    def attitude(self, t):
        return np.broadcast_to(self.at_rest, (len(t), 3, 3))

    def rate(self, t):
        return np.zeros((len(t), 3))


def altered(renderer, options=None, **changes):
    """Return a renderer of the changed scene, which must look the same without what is painted on the ball."""
    return Renderer(replace(renderer.scene, **changes), options, renderer.backdrop)


def painted(renderer, name, options=None, **changes):
    """Return a renderer of the scene with a pattern in place of discs; None: with its discs."""
    pattern = {} if name is None else {"pattern": Pattern(name, 1), "disc_directions": np.zeros((0, 3))}
    return altered(renderer, options, **pattern | changes)


def image(renderer, profile, t=0.0):
    return renderer.frame(profile, t, 0, rng()).frame.image.astype(float)


def fastest_time(profile):
    t = np.linspace(0.0, profile.seconds, 2001)
    speed = np.linalg.norm(profile.rate(t), axis=1)
    assert speed.max() > 2.0  # rad/s
    return float(t[np.argmax(speed)])
