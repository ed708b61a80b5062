"""Events of device, ball and light in a recording, each with its time."""

from dataclasses import dataclass, replace

import numpy as np

from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, exp, tangent_basis
from spheremouse.simulate.ball.scene import Scene

_CANDIDATES = 48  # places looked at for a disc that is moved


@dataclass(frozen=True, slots=True)
class Dimming:
    """The picture gets darker for a while, without a step."""

    start: float  # s
    end: float  # s
    factor: float  # on the grey values, as on the light: the camera is linear

    def at(self, t: Array) -> Array:
        """Factor at times `t`; it takes 0.2 s to change."""
        x = np.clip(np.minimum(t - self.start, self.end - t) / 0.2, 0.0, 1.0)
        return 1.0 + (self.factor - 1.0) * x * x * (3.0 - 2.0 * x)


@dataclass(frozen=True, slots=True)
class Flicker:
    """Lamps on the mains: the light goes up and down twice in every period."""

    depth: float  # 0..1, share of the mean that comes and goes
    mains: float = 50.0  # Hz

    def at(self, t: Array, exposure: float) -> Array:
        """Factor on what is exposed around times `t` for `exposure` s: the mean over that time."""
        f = 2.0 * self.mains
        return 1.0 + self.depth * np.sinc(f * exposure) * np.cos(2.0 * np.pi * f * t)


@dataclass(frozen=True, slots=True)
class Lift:
    """The ball is lifted off its bearings and comes back; up and down take 0.3 s each, or a third of the time."""

    start: float  # s
    end: float  # s
    shift: tuple[float, float, float]  # m, obj

    def at(self, t: float) -> Array:
        """Offset of the ball's centre at time `t`, (3,) m from its place."""
        ramp = min(0.3, (self.end - self.start) / 3.0)
        x = min(max(min(t - self.start, self.end - t) / ramp, 0.0), 1.0)
        return np.array(self.shift) * (x * x * (3.0 - 2.0 * x))


@dataclass(frozen=True, slots=True)
class Change:
    """From a time on the scene is another: the camera was bumped, a disc fell off or was moved."""

    time: float  # s; frames with a stamp from here on
    scene: Scene
    what: str  # "bump", "disc off" or "disc moved"
    disc: int | None = None


def bumped(scene: Scene, by: tuple[float, float, float, float, float, float]) -> Scene:
    """The camera pushed by `by`[:3] mm and then turned by `by`[3:] degrees, both along its own axes x, y, z."""
    pose = scene.pose
    shift, turn = 1e-3 * np.array(by[:3]), np.radians(by[3:])
    return replace(scene, pose=Pose(pose.rotation @ exp(turn), pose.position + pose.rotation @ shift))


def facing(scene: Scene, attitude: Array) -> int:
    """The disc on the ball that is nearest to the middle of the camera's view at R_obj_ball (3, 3)."""
    eye = scene.pose.position / np.linalg.norm(scene.pose.position)
    cosine = scene.disc_directions @ (attitude.T @ eye)
    cosine[list(scene.fallen)] = -2.0
    return int(np.argmax(cosine))


def displaced(scene: Scene, disc: int, angle: float = 0.2) -> Scene:
    """A disc put `angle` rad beside its place, where most room is; ValueError where there is none."""
    old = scene.disc_directions[disc]
    phase = np.linspace(0.0, 2.0 * np.pi, _CANDIDATES, endpoint=False)
    around = np.stack([np.cos(phase), np.sin(phase)], axis=1) @ tangent_basis(old[None])[0].T
    places = np.cos(angle) * old + np.sin(angle) * around
    others = [k for k in range(len(scene.disc_directions)) if k != disc and k not in scene.fallen]
    nearest = np.max(places @ scene.disc_directions[others].T, axis=1, initial=-1.0)
    best = int(np.argmin(nearest))
    if nearest[best] > np.cos(2.5 * scene.disc_angle):
        raise ValueError("no room on the ball to move a disc to")
    directions = scene.disc_directions.copy()
    directions[disc] = places[best]
    return replace(scene, disc_directions=directions)
