"""Frames of a simulated scene, each with its exact truth.

The renderer draws the still parts of the scene once (`backdrop`). Each frame mixes in what is painted on the ball
(`surface`), averaged over the exposure and row by row with a rolling shutter, then hands, light and noise. It mixes
grey values, like a camera with a linear response. While nothing moves, only light and noise are new.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from spheremouse.ball.truth import DiscTruth
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.backdrop import Backdrop, render_backdrop, render_layers
from spheremouse.simulate.ball.events import Dimming, Flicker, HandVisit, Lift, Sway, place_hand
from spheremouse.simulate.ball.profile import Profile
from spheremouse.simulate.ball.scene import Scene
from spheremouse.simulate.ball.surface import Points, Surface
from spheremouse.simulate.layers import Layer, lay
from spheremouse.tracker import Frame

# Normal noise by its quantiles: five times as fast as NumPy's, true to 4.3 standard deviations, where it ends.
_NORMAL = ndtri((np.arange(65536) + 0.5) / 65536.0).astype(np.float32)
_MAX_MOMENTS = 201  # of an exposure
_LIMITED = np.rint(16.0 + 219.0 / 255.0 * np.arange(256)).astype(np.uint8)  # ITU-R BT.601, shown as full range


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Disturbances of ball and picture. Lengths are times the scene's scale."""

    noise: float = 0.0  # grey values, standard deviation, normal, independent in every channel
    brightness: float = 0.0  # grey values, added to all (Wittich 2017, table 24)
    dimming: tuple[Dimming, ...] = ()
    hands: tuple[HandVisit, ...] = ()
    flicker: Flicker | None = None
    limited: bool = False  # grey values 16..235 in place of 0..255
    lifts: tuple[Lift | Sway, ...] = ()
    eccentric: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, ball: its centre from the point it turns about

    @property
    def reach(self) -> float:
        """m, how far the ball's centre may be from its place."""
        return sum((float(np.linalg.norm(lift.shift)) for lift in self.lifts), float(np.linalg.norm(self.eccentric)))


@dataclass(frozen=True, slots=True)
class SimulatedFrame:
    """A frame with its ground truth."""

    frame: Frame
    attitude: Array  # (3, 3) R_obj_ball at the stamp
    rate: Array  # (3,) rad/s, w_obj at the stamp
    discs: DiscTruth  # of this frame
    centre: Array  # (3,) m, obj, of the ball at the stamp
    pose: Pose  # of the camera


class _Place(NamedTuple):
    """The ball in its place, or in another."""

    backdrop: Backdrop
    surface: Surface
    points: Points | None  # None without a pattern


class _Seen(NamedTuple):
    """Discs and pattern in a frame, used again while the ball does not move."""

    attitude: Array  # (3, 3) R_obj_ball
    place: _Place
    pixel: NDArray[np.intp]  # (k,) that show discs or a pattern at some moment
    dark: NDArray[np.float32]  # (k,) mean share of black in them
    discs: DiscTruth


class Renderer:
    """Renders frames of one scene. The constructor takes a few seconds, a frame takes milliseconds."""

    def __init__(self, scene: Scene, options: RenderOptions | None = None, backdrop: Backdrop | None = None) -> None:
        """`backdrop` may come from another renderer if both scenes look the same without discs. This saves seconds."""
        self.scene = scene
        self.options = RenderOptions() if options is None else options
        self._unit = scene = scene.scaled(1.0 / scene.scale)  # in the unit of length of its surroundings
        self.backdrop = render_backdrop(scene) if backdrop is None else backdrop
        reach = self.options.reach
        surface = Surface(scene, reach)
        self._home = self._away = _Place(self.backdrop, surface, surface.points(self.backdrop.ball))
        self._layers = render_layers(scene, self.backdrop) if reach > 0.0 else None
        self._bytes = _to_bytes(self.backdrop.white)
        self._last: _Seen | None = None

    def frame(self, profile: Profile, t: float, sequence: int, rng: np.random.Generator) -> SimulatedFrame:
        """The picture at time `t` (s, mid-exposure of the middle row), with its truth."""
        scene, now = self.scene, np.array([t])
        attitude = profile.attitude(now)[0]
        place = self._at(sum((x.at(t) for x in self.options.lifts), attitude @ np.array(self.options.eccentric)))
        placed = [place_hand(visit, self._unit, t) for visit in self.options.hands]
        hands = [hand for hand in placed if hand is not None]
        half = 0.5 * (scene.exposure_s + scene.readout_s)
        rests = not hands and np.all(profile.attitude(t + half * np.linspace(-1.0, 1.0, 5)) == attitude)
        seen = self._last
        if not rests or seen is None or seen.place is not place or np.any(seen.attitude != attitude):
            seen = self._look(profile, t, attitude, place, hands)
        self._last = seen if rests else None
        image = self._picture(seen, hands, t, rng)
        discs = replace(seen.discs, frame=np.full(len(seen.discs), sequence, dtype=np.intp))
        centre = scene.scale * place.surface.centre
        return SimulatedFrame(Frame(image, t, sequence), attitude, profile.rate(now)[0], discs, centre, scene.pose)

    def _at(self, centre: Array) -> _Place:
        """All that goes with the ball's centre, (3,) m; rows and exposure share it."""
        if self._layers is None or not np.any(centre):
            return self._home
        if np.any(centre != self._away.surface.centre):
            backdrop, surface = self._layers.backdrop(centre), self._home.surface.moved(centre)
            self._away = _Place(backdrop, surface, surface.points(backdrop.ball))
        return self._away

    def _look(self, profile: Profile, t: float, attitude: Array, place: _Place, hands: Sequence[Layer]) -> _Seen:
        """Average what is painted on the ball over the exposure."""
        surface, times = place.surface, self._moments(profile, t)
        covered = [surface.coverage(profile.attitude, moment) for moment in times]
        pixels, shares = [c.pixel for c in covered], [c.share for c in covered]
        if self.scene.pattern is not None and place.points is not None:
            points, light = place.points, np.ones(place.backdrop.ball.size, dtype=np.float32)
            black = np.zeros(len(points.pixel), dtype=np.float32)
            for k, moment in enumerate(times):
                R = profile.attitude(surface.row_times(moment)).astype(np.float32)
                if len(R) > 1:
                    turned = (points.normal @ R[points.pixel // self.scene.camera.width]).reshape(-1, 3)
                else:
                    turned = points.normal.reshape(-1, 3) @ R[0]
                albedo = self.scene.pattern.albedo(turned).reshape(points.weight.shape)
                light[points.pixel] = np.einsum("km,km->k", albedo, points.weight)
                black += np.float32(1.0) - light[points.pixel]
                shares[k] = shares[k] * light[pixels[k]]  # a disc hides the pattern
            pixels, shares = [*pixels, points.pixel], [*shares, black]
        pixel, dark = np.concatenate(pixels), np.concatenate(shares)
        if place.points is None:  # few pixels
            pixel, group = np.unique(pixel, return_inverse=True)
            dark = np.bincount(group, dark, len(pixel))
        else:
            every = np.bincount(pixel, dark, place.backdrop.ball.size)
            pixel = np.flatnonzero(every > 0.0)
            dark = every[pixel]
        shown = place.backdrop.ball.copy() if hands else place.backdrop.ball
        for hand in hands:
            shown[hand.window.slices] *= 1.0 - hand.paint[..., 3]
        discs = surface.truth(profile.attitude, t, covered[len(times) // 2], shown, place.backdrop.outline)
        return _Seen(attitude, place, pixel, (dark / len(times)).astype(np.float32), discs)

    def _picture(self, seen: _Seen, hands: Sequence[Layer], t: float, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Return the picture of a moment, (h, w, 3): light, ball, hands and noise over the prepared background."""
        options, pixel = self.options, seen.pixel
        white, black = seen.place.backdrop.white, seen.place.backdrop.black
        plain = white.reshape(-1, 3)[pixel]
        touched = plain + seen.dark[:, None] * (black.reshape(-1, 3)[pixel] - plain)
        factor = self._light(t)
        if seen.place is self._home and not hands and factor is None and options.brightness == 0.0 == options.noise:
            image = self._bytes.copy()
            image.reshape(-1, 3)[pixel] = _to_bytes(touched)
        else:
            picture = white.copy()
            picture.reshape(-1, 3)[pixel] = touched
            for hand in hands:
                lay(picture, hand)
            if factor is not None:
                picture *= factor[:, None, None]
            image = _expose(picture, options.noise, options.brightness, rng)
        return np.asarray(cv2.LUT(image, _LIMITED), dtype=np.uint8) if options.limited else image

    def _light(self, t: float) -> NDArray[np.float32] | None:
        """Return the factor on the grey values of every row at its own time, (h or 1,), or None if it is 1."""
        options = self.options
        if not options.dimming and options.flicker is None:
            return None
        times = self._home.surface.row_times(t)
        factor = np.prod([d.at(times) for d in options.dimming], axis=0)
        if options.flicker is not None:
            factor = factor * options.flicker.at(times, self.scene.exposure_s)
        return None if np.all(factor == 1.0) else factor.astype(np.float32)

    def _moments(self, profile: Profile, t: float) -> Array:
        """Times in the exposure, s; from one to the next no disc moves by more than a pixel.

        A pattern needs fewer: a pixel has several points of it. The middle of an odd number is t itself.
        """
        scene = self.scene
        if scene.exposure_s == 0.0:
            return np.array([t])
        ends = t + scene.exposure_s * np.array([-0.5, 0.0, 0.5])
        fastest = float(np.max(np.linalg.norm(profile.rate(ends), axis=1)))
        gap = np.linalg.norm(scene.pose.position) - scene.ball_radius
        pixels = fastest * scene.ball_radius * max(scene.camera.fx, scene.camera.fy) / gap * scene.exposure_s
        n = min(1 + int(np.ceil(pixels / 2.0)) * (2 if len(scene.disc_directions) else 1), _MAX_MOMENTS)
        return t + scene.exposure_s * ((np.arange(n) + 0.5) / n - 0.5)


def _expose(
    picture: NDArray[np.float32], noise: float, brightness: float, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """With noise and brightness, in bytes."""
    if noise > 0.0:
        raw = rng.integers(0, 65536, picture.size, dtype=np.uint16)
        normal = np.empty(picture.shape, dtype=np.float32)
        np.take(_NORMAL, raw.reshape(picture.shape), out=normal, mode="clip")
        return _to_bytes(cv2.addWeighted(picture, 1.0, normal, noise, brightness))
    return _to_bytes(picture + np.float32(brightness))


def _to_bytes(picture: cv2.typing.MatLike) -> NDArray[np.uint8]:
    """Rounded and clipped to 0..255."""
    if picture.size == 0:
        return np.zeros(picture.shape, dtype=np.uint8)
    return np.asarray(cv2.add(picture, np.zeros_like(picture), dtype=cv2.CV_8U), dtype=np.uint8).reshape(picture.shape)
