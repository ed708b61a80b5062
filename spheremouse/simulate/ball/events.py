"""Events of a recording and their times: changes of device, ball and light, hands before the ball, and worse film.

Hands are drawn once, then placed at their positions for each time.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.geometry.camera import InteriorOrientation, Pose, project
from spheremouse.geometry.rotation import Array, exp, tangent_basis
from spheremouse.simulate.ball.scene import Scene
from spheremouse.simulate.light import smoothstep
from spheremouse.tracker import Frame

_CANDIDATE_PLACES = 48  # candidate places of a moved disc


@dataclass(frozen=True, slots=True)
class Dimming:
    """The picture gets darker for a while, without a step."""

    start: float  # s
    end: float  # s
    factor: float  # on the grey values, as on the light: the camera is linear

    def at(self, t: Array) -> Array:
        """Return the factor at times `t` (s, any shape). A change takes 0.2 s."""
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
    """A ball that moves to and fro in worn bearings, from its place on."""

    shift: tuple[float, float, float]  # m, obj, the farthest
    hz: float = 2.0

    def at(self, t: float) -> Array:
        """Offset of the ball's centre at time `t`, (3,) m from its place."""
        return np.array(self.shift) * np.sin(2.0 * np.pi * self.hz * t)


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
    eye = scene.pose.position / np.linalg.norm(scene.pose.position)
    cosine = scene.disc_directions @ (attitude.T @ eye)
    cosine[list(scene.fallen)] = -2.0
    return int(np.argmax(cosine))


def move_disc(scene: Scene, disc: int, angle: float = 0.2) -> Scene:
    """Return the scene with the disc of an index moved by `angle` rad, to the side where the nearest disc is farthest.

    Raises ValueError if the centres of the two would be less than 2.5 radii of a disc apart. Fallen discs do not count.
    """
    old = scene.disc_directions[disc]
    phase = np.linspace(0.0, 2.0 * np.pi, _CANDIDATE_PLACES, endpoint=False)
    around = np.stack([np.cos(phase), np.sin(phase)], axis=1) @ tangent_basis(old[None])[0].T
    places = np.cos(angle) * old + np.sin(angle) * around
    others = [k for k in range(len(scene.disc_directions)) if k != disc and k not in scene.fallen]
    nearest_cosine = np.max(places @ scene.disc_directions[others].T, axis=1, initial=-1.0)
    best = int(np.argmin(nearest_cosine))
    if nearest_cosine[best] > np.cos(2.5 * scene.disc_angle):
        raise ValueError("no room on the ball to move a disc to")
    directions = scene.disc_directions.copy()
    directions[disc] = places[best]
    return replace(scene, disc_directions=directions)


# ---- hands ----

_PER_METRE = 500  # pixels of the drawing
_HAND_SCALE = 1.3  # a big hand: two of them hide about a third of the ball
_HALF_WIDTH, _ABOVE, _BELOW = 0.12, 0.18, 0.75  # m, extent of the drawing around the palm
_SKIN = np.array([112.0, 148.0, 205.0])  # grey values blue, green, red
_SLEEVE = np.array([112.0, 70.0, 48.0])
_PLANE_Z = 0.66  # m, obj: just in front of the ball


@dataclass(frozen=True, slots=True)
class HandVisit:
    """A hand that enters from below, plays on the ball and leaves."""

    start: float  # s
    end: float  # s
    right: bool  # the right hand, on the right of the ball
    size: float = 1.0  # factor on the size of the hand


def draw_hand() -> NDArray[np.float32]:
    """A right hand with its forearm, seen from behind it, fingers up: (h, w, 4) blue, green, red, cover 0..1.

    Colours are multiplied by the cover already.
    """
    y, x = np.mgrid[_ABOVE : -_BELOW : -1.0 / _PER_METRE, -_HALF_WIDTH : _HALF_WIDTH : 1.0 / _PER_METRE]
    parts = [  # from, to, radius at both, m; the origin is the middle of the palm
        (-0.016, -0.030, -0.016, 0.035, 0.031, 0.030), (0.016, -0.030, 0.016, 0.035, 0.031, 0.030),
        (-0.036, 0.055, -0.046, 0.118, 0.0105, 0.009), (-0.012, 0.060, -0.015, 0.140, 0.011, 0.0095),
        (0.012, 0.060, 0.015, 0.134, 0.011, 0.0095), (0.034, 0.050, 0.044, 0.105, 0.010, 0.008),
        (-0.036, -0.025, -0.082, 0.030, 0.016, 0.011), (0.0, -0.05, 0.0, -0.30, 0.030, 0.040),
        (0.0, -0.24, 0.0, -0.80, 0.050, 0.062),
    ]  # fmt: skip
    depth = np.full(x.shape, -np.inf)
    for x0, y0, x1, y1, r0, r1 in parts:
        dx, dy = x1 - x0, y1 - y0
        s = np.clip(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
        radius = r0 + s * (r1 - r0)
        depth = np.maximum(depth, radius - np.hypot(x - x0 - s * dx, y - y0 - s * dy))
    cover = np.clip(0.5 + depth * _PER_METRE, 0.0, 1.0)
    round_edge = 0.62 + 0.38 * np.sqrt(np.clip(depth / 0.02, 0.0, 1.0))
    sleeve = np.clip(0.5 + (-0.24 - y) * _PER_METRE, 0.0, 1.0)[..., None]
    colour = (_SKIN * (1.0 - sleeve) + _SLEEVE * sleeve) * round_edge[..., None]
    return np.concatenate([colour * cover[..., None], cover[..., None]], axis=2).astype(np.float32)


class PlacedHand(NamedTuple):
    """A hand in an image: the part of it that it may touch, and its paint there."""

    place: tuple[slice, slice]  # rows, columns
    paint: NDArray[np.float32]  # (rows, columns, 4) as draw_hand


def place_hand(hand: NDArray[np.float32], visit: HandVisit, scene: Scene, t: float) -> PlacedHand | None:
    """Return a hand of `draw_hand` in the image at time `t` (s), or None while it is away or out of sight.

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
    return hand_in_picture(hand, palm, axes @ scene.pose.rotation, scene.camera)


def hand_in_picture(
    hand: NDArray[np.float32], palm: Array, axes: Array, camera: InteriorOrientation
) -> PlacedHand | None:
    """Place a drawn hand in the picture, with its palm at (3,) m in `cam`; `axes` (2, 3) point right and up of it.

    Return None if it is out of sight, or if a part of it is nearer than 10 cm.
    """
    h, w = hand.shape[:2]
    corners = np.array([[0, 0], [w, 0], [0, h], [w, h]], dtype=np.float32)
    points = palm + (corners / _PER_METRE * (1.0, -1.0) + (-_HALF_WIDTH, _ABOVE)) @ axes
    uv = project(points, camera)[0]
    if np.any(points[:, 2] < 0.1) or not np.all(np.isfinite(uv)):
        return None
    limit = (camera.width, camera.height)
    low = np.clip(np.floor(uv.min(axis=0)).astype(int) - 1, 0, limit)
    high = np.clip(np.ceil(uv.max(axis=0)).astype(int) + 2, 0, limit)
    if np.any(high <= low):
        return None
    M = cv2.getAffineTransform(corners[:3], (uv[:3] - low).astype(np.float32))
    paint = cv2.warpAffine(hand, M, (int(high[0] - low[0]), int(high[1] - low[1])))
    place = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
    return PlacedHand(place, np.asarray(paint, dtype=np.float32))


# ---- a film made worse ----

_SEED = 0  # of the noise added: the same frame gets the same noise in every run


def degrade(frames: Iterator[Frame], noise: float, brightness: float) -> Iterator[Frame]:
    """Frames with normal noise on every channel and a constant added (Wittich 2017, section 4.9), 8 bits again."""
    for frame in frames:
        if noise == 0.0 and brightness == 0.0:
            yield frame
            continue
        rng = np.random.default_rng([_SEED, frame.sequence])
        values = frame.image + np.float32(brightness)
        if noise:
            values += np.float32(noise) * rng.standard_normal(values.shape, dtype=np.float32)
        yield replace(frame, image=np.clip(np.rint(values), 0, 255).astype(np.uint8))
