"""Projection of discs on the ball: directions to ellipses in pixels.

A disc of radius s along the surface is a spherical cap of half angle alpha = s / R; its rim is a circle in space, so
its image is an ellipse (camera.project_circle) as long as the whole rim is on the near side.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.rig import Rig, view_of
from spheremouse.geometry.camera import Pose, project, sphere_outline
from spheremouse.geometry.rotation import Array
from spheremouse.native import kernels


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
    return Appearance(*kernels.appearance(np.ascontiguousarray(directions, dtype=np.float64), view_of(rig, pose)))


def seen_at(directions: Array, rig: Rig, pose: Pose) -> Array:
    """Return the pixels, (n, 2), of points of the ball at `directions`, (n, 3) unit vectors in `obj`.

    Points of the far side have pixels too. Points at or behind the projection centre give nan.
    """
    return kernels.seen_at(np.ascontiguousarray(directions), view_of(rig, pose))


def ball_outline(rig: Rig, pose: Pose, points: int = 180) -> Array:
    """The ball's outline in the image, (points, 2) px."""
    return sphere_outline(pose.to_cam(rig.ball.centre), rig.ball.radius, rig.camera, points)


def ball_mask(rig: Rig, pose: Pose) -> Image:
    """255 on the ball's image, 0 elsewhere, (h, w)."""
    mask = np.zeros((rig.camera.height, rig.camera.width), np.uint8)
    outline = np.clip(ball_outline(rig, pose), -1e4, 1e4)
    cv2.fillPoly(mask, [np.rint(outline * 16).astype(np.int32)], 255, shift=4)
    return mask


def clear_mask(rig: Rig, pose: Pose) -> Image:
    """255 on the ball's image, a pixel within its outline and beside the ring targets in front of it, (h, w)."""
    mask = cv2.erode(ball_mask(rig, pose), np.ones((3, 3), np.uint8))  # pixels on the outline mix with the room
    angle = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    ring = rig.targets.radii[-1] * np.stack([np.cos(angle), np.sin(angle), np.zeros(32)], axis=1)
    distance = np.linalg.norm(pose.position - rig.targets.position, axis=1)
    for position in rig.targets.position[distance < np.linalg.norm(pose.position - rig.ball.centre)]:
        corners = project(pose.to_cam(position + ring), rig.camera)[0]
        if np.isfinite(corners).all():
            cv2.fillPoly(mask, [np.rint(np.clip(corners, -1e4, 1e4)).astype(np.int32)], 0)
    return mask


def largest_disc(rig: Rig, pose: Pose) -> float:
    """Diameter in px of a disc where the ball is nearest to the camera."""
    towards = pose.position - rig.ball.centre
    nearest = appearance((towards / np.linalg.norm(towards))[None], rig, pose)
    return 2.0 * float(np.sqrt(np.linalg.eigvalsh(nearest.shape[0])[-1]))
