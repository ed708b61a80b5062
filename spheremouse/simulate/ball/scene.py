"""A simulated scene: camera, ball with its discs, targets, everything around, and the light.

`default_scene` has the geometry of the reference recordings (the frame of `far26`) and the cameras of
Wittich 2017, table 2.
"""

from dataclasses import dataclass

import numpy as np

from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import Array, from_euler
from spheremouse.simulate.ball.furniture import BLACK, LAMPS, STRIPS, WHITE_BALL, frame, room
from spheremouse.simulate.ball.options import View
from spheremouse.simulate.light import Lighting
from spheremouse.simulate.shapes import Colour, Shape

# Wittich 2017, table 2: focal length (px), position (m), and omega, phi, kappa (deg) of R_obj_cam with the z axis
# of `cam` forward; the table's angles mean the same rotation.
_VIEWS: dict[str, tuple[float, tuple[float, float, float], tuple[float, float, float]]] = {
    "far": (640.0, (0.0, 0.0, 2.35), (180.0, 0.0, 90.0)),
    "near": (320.0, (0.0, -0.45, 1.27), (-170.0, 0.0, 0.0)),
}
_TARGET_RADII = np.array([0.012, 0.024, 0.036])
_TARGET_POSITIONS = np.array(
    [[-0.3244, 0.1546, 0.5629], [-0.3244, -0.5954, 0.5629], [0.3256, -0.5954, 0.5629], [0.3256, 0.1546, 0.5629]]
)


@dataclass(frozen=True, slots=True)
class Scene:
    """All that does not change during a recording but the ball's attitude."""

    camera: InteriorOrientation
    pose: Pose
    ball_radius: float  # m
    disc_directions: Array  # (n, 3) unit vectors, ball
    disc_radius: float  # m, along the ball's surface
    targets: Targets
    surroundings: tuple[Shape, ...]  # frame, bolts, cards, targets, room
    lighting: Lighting
    exposure_s: float = 0.0  # s
    readout_s: float = 0.0  # s, row v of h is exposed around stamp + readout_s * ((v + 1/2) / h - 1/2)
    ball_colour: Colour = WHITE_BALL
    disc_colour: Colour = BLACK
    fallen: tuple[int, ...] = ()  # discs that are no longer on the ball

    @property
    def disc_angle(self) -> float:
        """rad, between the centre of a disc and its edge, seen from the ball's centre."""
        return self.disc_radius / self.ball_radius

    def rig(self) -> Rig:
        """The device as it is known beforehand, without the camera's pose."""
        return Rig(
            self.camera,
            Ball(self.ball_radius),
            self.targets,
            self.disc_radius,
            readout_s=self.readout_s,
            exposure_s=self.exposure_s,
        )


def default_scene(
    discs: int = 26,
    view: View = "far",
    seed: int = 0,
    *,
    width: int = 640,
    height: int = 480,
    distortion: Array | None = None,
) -> Scene:
    """The reference geometry; `seed` places the discs. Other sizes than 640 x 480 keep the whole view."""
    focal, position, angles = _VIEWS[view]
    scale = min(width / 640.0, height / 480.0)
    camera = InteriorOrientation(
        width,
        height,
        focal * scale,
        focal * scale,
        width / 2.0,
        height / 2.0,
        np.zeros(5) if distortion is None else np.asarray(distortion, dtype=float),
    )
    targets = Targets((1, 2, 3, 4), ("MCY", "CYM", "YMC", "CMY"), _TARGET_POSITIONS, np.zeros((12, 12)), _TARGET_RADII)
    ball_radius, disc_radius = 0.6, 0.02
    bolt_radius = 0.0105  # as far26: the size of a disc that lies a little aslant
    return Scene(
        camera=camera,
        pose=Pose(from_euler(np.radians(angles)), np.array(position)),
        ball_radius=ball_radius,
        disc_directions=spread_directions(discs, 3.0 * disc_radius / ball_radius, np.random.default_rng(seed)),
        disc_radius=disc_radius,
        targets=targets,
        surroundings=(*frame(targets, bolt_radius), *room()),
        lighting=Lighting(LAMPS, STRIPS, ball_radius),
    )


def spread_directions(n: int, apart: float, rng: np.random.Generator) -> Array:
    """Unit vectors, (n, 3), spread over the sphere but irregularly, no two nearer than `apart` rad.

    Random points that push each other away for a while, like electrons on a sphere, and stop before they settle: a
    regular pattern would look alike from several sides. ValueError where `n` do not fit.
    """
    if n < 1:
        raise ValueError("a ball needs at least one disc")
    if n * 0.5 * (1.0 - np.cos(0.5 * apart)) > 0.5:  # caps in the densest packing fill 0.9 of a plane
        raise ValueError(f"{n} discs do not fit on the ball")
    u = rng.standard_normal((n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    spacing = np.sqrt(4.0 * np.pi / n)
    for step in range(400):
        offset = u[:, None] - u[None]
        distance = np.linalg.norm(offset, axis=2) + np.eye(n)
        nearest = np.min(distance + 10.0 * np.eye(n)) if n > 1 else np.inf
        if step >= 12 and nearest > 2.0 * np.sin(0.5 * max(apart, 0.55 * spacing)):
            break
        push = np.sum(offset / distance[..., None] ** 3, axis=1)
        push -= np.sum(push * u, axis=1, keepdims=True) * u
        length = np.linalg.norm(push, axis=1, keepdims=True)
        u += push * np.minimum(0.02 * spacing**3, 0.1 * spacing / np.maximum(length, 1e-12))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
    cosine = u @ u.T - 2.0 * np.eye(n)
    if n > 1 and np.max(cosine) > np.cos(apart):
        raise ValueError(f"{n} discs do not fit on the ball")
    return u
