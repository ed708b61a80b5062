"""Projection of discs on the ball: directions to ellipses in pixels.

A disc of radius s along the surface is a spherical cap of half angle alpha = s / R; its rim is a circle in space, so
its image is an ellipse (camera.project_circle) as long as the whole rim is on the near side.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.rig import Rig, view_of
from spheremouse.geometry.camera import Pose, distorted, sphere_outline
from spheremouse.geometry.rotation import Array

_CORNERS = 24  # of the polygon that approximates a distorted outline


class Appearance(NamedTuple):
    """Images of n discs. A disc that the horizon of the ball cuts is not `whole`."""

    centre: Array  # (n, 2) px, projection of the disc's centre
    centroid: Array  # (n, 2) px, centroid of its image; minus `centre`: the eccentricity
    shape: Array  # (n, 2, 2) px², (x - centroid)^T shape^-1 (x - centroid) = 1 on the rim
    area: Array  # (n,) px²
    whole: NDArray[np.bool_]  # (n,) the whole rim faces the camera


def appearance(directions: Array, rig: Rig, pose: Pose) -> Appearance:
    """Return the images of the discs at `directions`, (n, 3) unit vectors in `obj`; nan for those that are not whole.

    The lens distorts the ellipse. The centroid is that of the distorted outline. The shape follows from the Jacobian at
    the centre.
    """
    return appearance_of(np.ascontiguousarray(directions, dtype=np.float64), view_of(rig, pose))


@njit(cache=True, error_model="numpy")
def appearance_of(directions, view):
    """Return the `appearance` for a BallView."""
    count = len(directions)
    centre, centroid, shape = np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 2, 2))
    area, whole = np.empty(count), np.empty(count, dtype=np.bool_)
    K, R, alpha, P, k = view.centre, view.radius, view.disc_angle, view.position, view.distortion
    rotation = view.rotation
    fx, fy, cx, cy = view.intrinsic
    bent = np.any(k != 0.0)
    tx, ty, tz = P[0] - K[0], P[1] - K[1], P[2] - K[2]
    distance = np.sqrt(tx * tx + ty * ty + tz * tz)
    # the horizon lies where the cosine to the camera's direction is R / distance; the rim is alpha further out
    least = np.cos(np.arccos(R / distance) - alpha)
    depth, r = R * np.cos(alpha), R * np.sin(alpha)
    n, c, w = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(directions)):
        u = directions[i]
        whole[i] = u[0] * tx + u[1] * ty + u[2] * tz > least * distance
        if not whole[i]:
            centre[i], centroid[i], shape[i], area[i] = np.nan, np.nan, np.nan, np.nan
            continue
        for j in range(3):
            n[j], c[j], w[j] = 0.0, 0.0, 0.0
            for m in range(3):
                a = rotation[m, j]
                n[j] += a * u[m]
                c[j] += a * (K[m] + depth * u[m] - P[m])
                w[j] += a * (K[m] + R * u[m] - P[m])
        a, b, _, _, _ = distorted(w[0] / w[2], w[1] / w[2], k)
        centre[i, 0], centre[i, 1] = fx * a + cx, fy * b + cy
        # dual conic C C' - r² (I - n n'): its middle and shape
        zz = c[2] * c[2] - r * r * (1.0 - n[2] * n[2])
        x, y = (c[0] * c[2] + r * r * n[0] * n[2]) / zz, (c[1] * c[2] + r * r * n[1] * n[2]) / zz
        sxx = x * x - (c[0] * c[0] - r * r * (1.0 - n[0] * n[0])) / zz
        sxy = x * y - (c[0] * c[1] + r * r * n[0] * n[1]) / zz
        syy = y * y - (c[1] * c[1] - r * r * (1.0 - n[1] * n[1])) / zz
        a, b, jxx, jxy, jyy = distorted(x, y, k)
        # fx, fy and the lens' Jacobian on both sides of the shape
        pxx, pxy = jxx * sxx + jxy * sxy, jxx * sxy + jxy * syy
        pyx, pyy = jxy * sxx + jyy * sxy, jxy * sxy + jyy * syy
        shape[i, 0, 0] = fx * fx * (pxx * jxx + pxy * jxy)
        shape[i, 0, 1] = fx * fy * (pxx * jxy + pxy * jyy)
        shape[i, 1, 0] = shape[i, 0, 1]
        shape[i, 1, 1] = fy * fy * (pyx * jxy + pyy * jyy)
        area[i] = np.pi * np.sqrt(shape[i, 0, 0] * shape[i, 1, 1] - shape[i, 0, 1] ** 2)
        da, db = 0.0, 0.0
        if bent:
            da, db = _bent_centroid(x, y, sxx, sxy, syy, a, b, k)
        centroid[i, 0], centroid[i, 1] = fx * (a + da) + cx, fy * (b + db) + cy
    return Appearance(centre, centroid, shape, area, whole)


@njit(cache=True, error_model="numpy")
def _bent_centroid(x, y, sxx, sxy, syy, a, b, k):
    """Return the centroid of an ellipse's distorted outline relative to a, b, the distorted place of its centre."""
    l11 = np.sqrt(sxx)
    l21 = sxy / l11
    l22 = np.sqrt(max(syy - l21 * l21, 0.0))
    total, da, db = 0.0, 0.0, 0.0
    first_p, first_q, p, q = 0.0, 0.0, 0.0, 0.0
    for i in range(_CORNERS + 1):
        if i < _CORNERS:
            cos, sin = np.cos(2.0 * np.pi * i / _CORNERS), np.sin(2.0 * np.pi * i / _CORNERS)
            u, v, _, _, _ = distorted(x + l11 * cos, y + l21 * cos + l22 * sin, k)
            u, v = u - a, v - b
        else:
            u, v = first_p, first_q
        if i == 0:
            first_p, first_q = u, v
        else:
            cross = p * v - u * q
            total += cross
            da += (p + u) * cross
            db += (q + v) * cross
        p, q = u, v
    return da / (3.0 * total), db / (3.0 * total)


def seen_at(directions: Array, rig: Rig, pose: Pose) -> Array:
    """Return the pixels, (n, 2), of points of the ball at `directions`, (n, 3) unit vectors in `obj`.

    Points of the far side have pixels too. Points at or behind the projection centre give nan.
    """
    return pixels_of(np.ascontiguousarray(directions), view_of(rig, pose))


@njit(cache=True, error_model="numpy")
def pixels_of(directions, view):
    """Return the result of `seen_at` for a BallView."""
    uv = np.empty((len(directions), 2))
    fx, fy, cx, cy = view.intrinsic
    rotation, to_centre, R, k = view.rotation, view.centre - view.position, view.radius, view.distortion
    for i in range(len(directions)):
        c = rotation.T @ (to_centre + R * directions[i])
        if c[2] > 0.0:
            u, v, _, _, _ = distorted(c[0] / c[2], c[1] / c[2], k)
            uv[i, 0], uv[i, 1] = fx * u + cx, fy * v + cy
        else:
            uv[i, 0], uv[i, 1] = np.nan, np.nan
    return uv


def ball_outline(rig: Rig, pose: Pose, points: int = 180) -> Array:
    """The ball's outline in the image, (points, 2) px."""
    return sphere_outline(pose.to_cam(rig.ball.centre), rig.ball.radius, rig.camera, points)


def ball_mask(rig: Rig, pose: Pose) -> Image:
    """255 on the ball's image, 0 elsewhere, (h, w)."""
    mask = np.zeros((rig.camera.height, rig.camera.width), np.uint8)
    outline = np.clip(ball_outline(rig, pose), -1e4, 1e4)
    cv2.fillPoly(mask, [np.rint(outline * 16).astype(np.int32)], 255, shift=4)
    return mask


def largest_disc(rig: Rig, pose: Pose) -> float:
    """Diameter in px of a disc where the ball is nearest to the camera."""
    towards = pose.position - rig.ball.centre
    nearest = appearance((towards / np.linalg.norm(towards))[None], rig, pose)
    return 2.0 * float(np.sqrt(np.linalg.eigvalsh(nearest.shape[0])[-1]))
