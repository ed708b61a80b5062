"""How a disc on the ball looks from the camera: directions in, ellipses in pixels out.

A disc of radius s along the surface is a spherical cap of half angle alpha = s / R; its rim is a circle in space, so
its image is an ellipse (camera.project_circle) as long as the whole rim is on the near side.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.camera import (
    Pose,
    ellipse_to_pixel,
    project,
    project_circle,
    project_sphere,
    reduced_to_pixel,
)
from spheremouse.detect.detections import Image
from spheremouse.rig import Rig
from spheremouse.rotation import Array


@dataclass(frozen=True, slots=True)
class Appearance:
    """Images of n discs. What the ball itself or the picture's edge cuts is not `whole`."""

    centre: Array  # (n, 2) px, projection of the disc's centre
    centroid: Array  # (n, 2) px, centroid of its image; minus `centre`: the eccentricity
    shape: Array  # (n, 2, 2) px², (x - centroid)^T shape^-1 (x - centroid) = 1 on the rim
    area: Array  # (n,) px²
    whole: NDArray[np.bool_]  # (n,) the whole rim faces the camera

    def take(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> "Appearance":
        """Those of a mask or of indices."""
        return Appearance(self.centre[keep], self.centroid[keep], self.shape[keep], self.area[keep], self.whole[keep])


def appearance(directions: Array, rig: Rig, pose: Pose) -> Appearance:
    """Images of the discs at `directions`, (n, 3) unit vectors in `obj`. Values are nan where not `whole`."""
    alpha = rig.disc_radius / rig.ball.radius
    towards = pose.position - rig.ball.centre
    distance = np.linalg.norm(towards)
    # the horizon lies where the cosine to the camera's direction is R / distance; the rim is alpha further out
    horizon = np.arccos(rig.ball.radius / distance)
    whole = np.arccos(np.clip(directions @ (towards / distance), -1.0, 1.0)) < horizon - alpha
    u = directions[whole]
    n = len(directions)
    centre, centroid = np.full((n, 2), np.nan), np.full((n, 2), np.nan)
    shape, area = np.full((n, 2, 2), np.nan), np.full(n, np.nan)
    if len(u):
        R = rig.ball.radius
        rim = pose.to_cam(rig.ball.centre + R * np.cos(alpha) * u)
        c, S = project_circle(rim, u @ pose.rotation, R * np.sin(alpha))
        centroid[whole], shape[whole] = ellipse_to_pixel(c, S, rig.camera)
        centre[whole] = project(pose.to_cam(rig.ball.centre + R * u), rig.camera)[0]
        S = shape[whole]
        area[whole] = np.pi * np.sqrt(S[:, 0, 0] * S[:, 1, 1] - S[:, 0, 1] ** 2)
    return Appearance(centre, centroid, shape, area, whole)


def ball_outline(rig: Rig, pose: Pose, points: int = 180) -> Array:
    """The ball's outline in the image, (points, 2) px."""
    centre, shape = project_sphere(pose.to_cam(rig.ball.centre), rig.ball.radius)
    angle = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    rim = centre + np.stack([np.cos(angle), np.sin(angle)], axis=1) @ np.linalg.cholesky(shape).T
    return reduced_to_pixel(rim, rig.camera)[0]


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
