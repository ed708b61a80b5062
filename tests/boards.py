"""A calibration board before a camera: places for it, what its corners project to, and its picture."""

from functools import cache, lru_cache

import cv2
import numpy as np

from spheremouse.calibrate.board import Pattern
from spheremouse.calibrate.camera.bundle import View
from spheremouse.geometry.camera import InteriorOrientation, project, unproject
from spheremouse.geometry.rotation import exp

PATTERN = Pattern(9, 6, 0.03)
CAMERA = InteriorOrientation(640, 480, 610.0, 605.0, 326.0, 236.0, np.array([-0.28, 0.12, 4e-4, -3e-4, -0.02]))


def places(n, rng, pattern=PATTERN, camera=CAMERA, tilt=(15.0, 45.0), margin=12.0):
    """R_cam_board (n, 3, 3) and translations (n, 3) m with the whole board in the picture."""
    middle = pattern.corners().mean(axis=0)
    size = np.array([camera.width, camera.height])
    found = []
    while len(found) < n:
        angle, azimuth = np.radians(rng.uniform(*tilt)), rng.uniform(0.0, 2.0 * np.pi)
        R = exp(angle * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])) @ exp(
            np.array([0.0, 0.0, np.radians(rng.choice([0.0, 90.0, 180.0, 10.0]))])
        )
        distance = rng.uniform(0.35, 0.7)
        aim, _ = unproject(rng.uniform(0.15, 0.85, 2)[None] * size, camera)
        t = distance * np.array([*aim[0], 1.0]) - R @ middle
        border = np.array([[x, y, 0.0] for x in (-1.3, pattern.columns + 0.3) for y in (-1.3, pattern.rows + 0.3)])
        uv, _ = project(border * pattern.square @ R.T + t, camera)
        if np.all((uv > margin) & (uv < size - 1.0 - margin)):
            found.append((R, t))
    return np.array([R for R, _ in found]), np.array([t for _, t in found])


def views(R, t, rng, sigma, true=None):
    """Views of a board whose corners are where it was printed, or at their `true` places, (n, 3) m."""
    corners, result = PATTERN.corners(), []
    for rotation, translation in zip(R, t, strict=True):
        uv, _ = project((corners if true is None else true) @ rotation.T + translation, CAMERA)
        result.append(View(corners, uv + rng.normal(0.0, sigma, uv.shape)))
    return result


FINE = 3  # samples a pixel, each way


def picture(R, t, pattern=PATTERN, camera=CAMERA, rng=None, noise=0.0, blur=0.6):
    grey = np.full((FINE * camera.height, FINE * camera.width), 120.0, np.float32)
    if R is not None:
        part = _about(R, t, pattern, camera)
        xy = _rays(camera.width, camera.height, *camera.intrinsic, *camera.distortion)[part].reshape(-1, 2)
        ray = np.column_stack([xy, np.ones(len(xy))])
        s = (R[:, 2] @ t) / (ray @ R[:, 2])
        x, y = (((ray * s[:, None] - t) @ R[:, :2]) / pattern.square + 1.0).T  # in squares from the outer corner
        x, y = np.nan_to_num(x, nan=-9.0), np.nan_to_num(y, nan=-9.0)
        w, h = pattern.columns + 1, pattern.rows + 1
        card = (x > -0.4) & (y > -0.4) & (x < w + 0.4) & (y < h + 0.4)
        inside = (x > 0.0) & (y > 0.0) & (x < w) & (y < h)
        paint = np.where(card, 230.0, 120.0)
        paint[inside] = _ink(pattern, x[inside], y[inside])
        grey[part] = paint.reshape(grey[part].shape)
    image = cv2.resize(grey, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), blur)
    if rng is not None and noise > 0.0:
        image = image + rng.normal(0.0, noise, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@lru_cache(maxsize=2)
def _rays(width, height, *lens):
    """(FINE * height, FINE * width, 2): where each sample of a picture looks, x/z and y/z."""
    camera = InteriorOrientation(width, height, *lens[:4], np.array(lens[4:]))
    offset = (np.arange(FINE) + 0.5) / FINE - 0.5
    u = (np.arange(width)[:, None] + offset).ravel()
    v = (np.arange(height)[:, None] + offset).ravel()
    at = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    at += np.random.default_rng(0).uniform(-0.5, 0.5, at.shape) / FINE  # or edges along the rows would be stairs
    return unproject(at, camera)[0].reshape(len(v), len(u), 2)


def _about(R, t, pattern, camera):
    """The samples among which the whole card is: rows and columns."""
    along = np.linspace(0.0, 1.0, 20)
    x, y = pattern.columns + 1.8, pattern.rows + 1.8
    edge = [(x * a, 0.0) for a in along] + [(x * a, y) for a in along]
    edge += [(0.0, y * a) for a in along] + [(x, y * a) for a in along]
    points = (np.array([(*at, 0.0) for at in edge]) - [1.4, 1.4, 0.0]) * pattern.square
    uv, _ = project(points @ R.T + t, camera)
    if not np.isfinite(uv).all():
        return slice(None), slice(None)
    (left, top), (right, bottom) = uv.min(axis=0) - 4.0, uv.max(axis=0) + 4.0
    return slice(max(int(FINE * top), 0), max(int(FINE * bottom), 0)), slice(
        max(int(FINE * left), 0), max(int(FINE * right), 0)
    )


def _ink(pattern, x, y):
    if pattern.marker is None:
        return np.where((np.floor(x) + np.floor(y)) % 2 == 0, 25.0, 230.0)
    drawn = _charuco(pattern)
    cell = 64
    return np.where(drawn[(y * cell).astype(int), (x * cell).astype(int)] < 128, 25.0, 230.0)


@cache
def _charuco(pattern):
    """The board as OpenCV draws it, 64 px a square."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, pattern.dictionary))
    size = pattern.columns + 1, pattern.rows + 1
    board = cv2.aruco.CharucoBoard(size, 64.0, 64.0 * pattern.marker / pattern.square, dictionary)
    return board.generateImage((64 * size[0], 64 * size[1]), marginSize=0, borderBits=1)
