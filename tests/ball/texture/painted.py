"""Balls with a known texture: a function of directions, its whole picture, and what a frame shows of it."""

from functools import cache

import numpy as np

from spheremouse.ball.settings import Settings
from spheremouse.ball.texture.picture import Picture, empty_picture, first_seen
from spheremouse.ball.texture.search import Level, TextureState, texture_detector
from spheremouse.simulate.ball.scene import default_scene

NOISE = 0.01  # of a contrast
HALF = 1.1  # half the width of a face, as `picture.h` has it
SCENE = default_scene(1, width=320, height=240)
RIG, POSE = SCENE.rig(), SCENE.pose
DETECTOR = texture_detector(RIG, POSE, Settings().discs.masks)


@cache
def waves(seed, count=60):
    """Return the contrast of a speckled ball: its details have the size of `view`'s pixels, as those of a film."""
    rng = np.random.default_rng(seed)
    k, phase = rng.normal(size=(3, count)).astype(np.float32), rng.uniform(0.0, 2.0 * np.pi, count).astype(np.float32)

    def texture(view, x):
        return np.sin(x.astype(np.float32) @ k * np.float32(0.65 / view.pixel) + phase).sum(axis=1) * 0.05 / count**0.5

    return texture


def rings(view, x):
    """Return a contrast that a rotation about z does not change."""
    return 0.05 * np.sin(x[:, 2] / view.pixel)


def plain(_, x):
    """Return the contrast of a ball without a texture."""
    return np.zeros(len(x))


def contrast_at(view, texture, R, rng=None):
    """Return the contrast of the samples, (n,), of a ball at R_obj_ball, with noise from `rng`."""
    value = texture(view, view.direction.T.astype(float) @ R)
    if rng is not None:
        value = value + NOISE * rng.normal(size=len(value))
    return value.astype(np.float32)


def cell_directions(n):
    """Return the unit vectors, (6, n, n, 3), of the cells of a picture."""
    at = (2.0 * (np.arange(n) + 0.5) / n - 1.0) * HALF
    a, b = np.meshgrid(at, at, indexing="ij")
    x = np.empty((6, n, n, 3))
    for face in range(6):
        axis = face // 2
        x[face, ..., axis] = -1.0 if face % 2 else 1.0
        x[face, ..., (axis + 1) % 3], x[face, ..., (axis + 2) % 3] = a, b
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def picture_of(view, texture, weight=20.0):
    """Return the picture of a texture of which each cell was seen `weight` times."""
    picture = empty_picture(view)
    return Picture(_values(texture, view is DETECTOR.fine), picture.weight + weight, picture.known + weight)


@cache
def _values(texture, fine):
    view = DETECTOR.fine if fine else DETECTOR.coarse
    values = texture(view, cell_directions(view.cells).reshape(-1, 3)).astype(np.float32)
    return values.reshape(6, view.cells, view.cells)


def state_at(texture, R, rng=None, learnt=None, turn=0):
    """Return the detector's state in a frame at R; `learnt` is the texture of the picture, by default the same."""
    levels = [
        Level(
            first_seen(view, contrast_at(view, texture, R, rng)),
            picture_of(view, learnt or texture),
        )
        for view in (DETECTOR.fine, DETECTOR.coarse)
    ]
    start = np.eye(3)
    return TextureState(
        DETECTOR.fine, levels[0], levels[1], 1.0, NOISE, start, start, proven=True, turned=True, frame_index=turn
    )
