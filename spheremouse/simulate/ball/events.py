"""Events of a recording and their times: changes of device, ball and light, hands before the ball, and worse film."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array, exp, tangent_basis
from spheremouse.simulate.ball.scene import Scene
from spheremouse.simulate.layers import Layer, drawn_hand, hand_layer
from spheremouse.simulate.light import expose, smoothstep
from spheremouse.simulate.shapes import circle
from spheremouse.tracker import Frame

_CANDIDATE_PLACES = 48  # candidate places of a moved disc


@dataclass(frozen=True, slots=True)
class Dimming:
    """The picture gets darker for a while, without a step."""

    start: float  # s
    end: float  # s
    factor: float  # on the grey values, as on the light: the camera is linear

    def at(self, t: Array, _: float) -> Array:
        """Return the factor at times `t` (s, any shape), for any exposure. A change takes 0.2 s."""
        return 1.0 + (self.factor - 1.0) * smoothstep(np.minimum(t - self.start, self.end - t) / 0.2)


@dataclass(frozen=True, slots=True)
class Flicker:
    """Flicker of lamps on the mains: the brightness has two cycles in each mains period."""

    depth: float  # 0..1, amplitude as a fraction of the mean
    mains: float = 50.0  # Hz

    def at(self, t: Array, exposure: float) -> Array:
        """Return the mean brightness factor of exposures of `exposure` s centred on times `t` (s, any shape)."""
        f = 2.0 * self.mains
        return 1.0 + self.depth * np.sinc(f * exposure) * np.cos(2.0 * np.pi * f * t)


@dataclass(frozen=True, slots=True)
class Lift:
    """A ball that leaves its place, stays and comes back. Each way takes 0.2 s, or a third of the time."""

    start: float  # s
    end: float  # s
    shift: tuple[float, float, float]  # m, obj

    def at(self, t: float) -> Array:
        """Offset of the ball's centre at time `t`, (3,) m from its place."""
        ramp = min(0.2, (self.end - self.start) / 3.0)
        return np.array(self.shift) * smoothstep(np.array(min(t - self.start, self.end - t) / ramp))


@dataclass(frozen=True, slots=True)
class Sway:
    """A ball that moves to and fro in worn bearings, from its place on, at 2 Hz."""

    shift: tuple[float, float, float]  # m, obj, the farthest

    def at(self, t: float) -> Array:
        """Offset of the ball's centre at time `t`, (3,) m from its place."""
        return np.array(self.shift) * np.sin(4.0 * np.pi * t)


@dataclass(frozen=True, slots=True)
class Change:
    """From a time on the scene is another: the camera was bumped, a disc fell off or was moved."""

    time: float  # s; frames with a stamp from here on
    scene: Scene
    what: str  # "bump", "disc off" or "disc moved"
    disc: int | None = None


def bump(scene: Scene, by: tuple[float, float, float, float, float, float]) -> Scene:
    """The camera pushed by `by`[:3] mm, times the scale, then turned by `by`[3:] degrees, along its own x, y, z."""
    pose = scene.pose
    shift, turn = 1e-3 * scene.scale * np.array(by[:3]), np.radians(by[3:])
    return replace(scene, pose=Pose(pose.rotation @ exp(turn), pose.position + pose.rotation @ shift))


def facing(scene: Scene, attitude: Array) -> int:
    """The disc on the ball that is nearest to the middle of the camera's view at R_obj_ball (3, 3)."""
    towards = scene.disc_directions @ (attitude.T @ scene.pose.position)
    towards[list(scene.fallen)] = -np.inf
    return int(np.argmax(towards))


def move_disc(scene: Scene, disc: int, angle: float = 0.2) -> Scene:
    """Return the scene with the disc of an index moved by `angle` rad, to the side where the nearest disc is farthest.

    Raises ValueError if the centres of the two would be less than 2.5 radii of a disc apart. Fallen discs do not count.
    """
    old = scene.disc_directions[disc]
    places = np.cos(angle) * old + np.sin(angle) * (circle(_CANDIDATE_PLACES) @ tangent_basis(old[None])[0].T)
    others = [k for k in range(len(scene.disc_directions)) if k != disc and k not in scene.fallen]
    nearest_cosine = np.max(places @ scene.disc_directions[others].T, axis=1, initial=-1.0)
    best = int(np.argmin(nearest_cosine))
    if nearest_cosine[best] > np.cos(2.5 * scene.disc_angle):
        raise ValueError("no room on the ball to move a disc to")
    directions = scene.disc_directions.copy()
    directions[disc] = places[best]
    return replace(scene, disc_directions=directions)


# ---- hands ----

_HAND_SCALE = 1.3  # a big hand: two of them hide about a third of the ball
_PLANE_Z = 0.66  # m, obj: just in front of the ball


@dataclass(frozen=True, slots=True)
class HandVisit:
    """A hand that enters from below, plays on the ball and leaves."""

    start: float  # s
    end: float  # s
    right: bool  # the right hand, on the right of the ball
    size: float = 1.0  # factor on the size of the hand


def place_hand(visit: HandVisit, scene: Scene, t: float) -> Layer | None:
    """Return the hand in the image at time `t` (s), or None while it is away or out of sight.

    The palm sways about 13 cm beside the ball's centre, goes up and down by 11 cm, and tilts. It comes up from 1.2 m
    below and goes back there, each in 0.5 s.
    """
    if not visit.start < t < visit.end:
        return None
    side = 1.0 if visit.right else -1.0
    since = t - visit.start
    arrival, departure = smoothstep(np.array([since, visit.end - t]) / 0.5)
    x = side * (0.13 + 0.03 * np.sin(2.1 * since))  # m, obj, as y
    y = 0.02 + 0.11 * np.sin(1.7 * since + side) - 1.2 * (1.0 - arrival * departure)
    tilt = side * (0.10 + 0.12 * np.sin(1.3 * since))  # rad
    axes = _HAND_SCALE * visit.size * np.array([[np.cos(tilt), np.sin(tilt), 0.0], [-np.sin(tilt), np.cos(tilt), 0.0]])
    axes[0] *= side
    palm = scene.pose.to_cam(np.array([x, y, _PLANE_Z]))
    return hand_layer(drawn_hand(), palm, axes @ scene.pose.rotation, scene.camera)


# ---- a film made worse ----


def degrade(frames: Iterator[Frame], noise: float, brightness: float) -> Iterator[Frame]:
    """Frames with normal noise on every channel and a constant added (Wittich 2017, section 4.9), 8 bits again."""
    for frame in frames:
        rng = np.random.default_rng([0, frame.sequence])  # the same in every run
        yield replace(frame, image=expose(frame.image.astype(np.float32), noise, rng, brightness))
