"""Frames of a simulated scene, each with its exact truth.

The renderer draws the still parts of the scene once (`backdrop`). Each frame mixes in the discs (`caps`) and what is
painted on the ball (`pattern`), averaged over the exposure and row by row with a rolling shutter, then hands, light and
noise. It mixes grey values, like a camera with a linear response. While nothing moves, only light and noise are new.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from spheremouse.ball.truth import DiscTruth
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.backdrop import Backdrop, render_backdrop, render_layers
from spheremouse.simulate.ball.caps import BallView, Caps, Coverage, Surface
from spheremouse.simulate.ball.events import Dimming, Flicker, HandVisit, Lift, PlacedHand, draw_hand, place_hand
from spheremouse.simulate.ball.pattern import Pattern
from spheremouse.simulate.ball.profile import Profile
from spheremouse.simulate.ball.scene import Scene
from spheremouse.tracker import Frame

# Normal noise by its quantiles: five times as fast as NumPy's, true to 4.3 standard deviations, where it ends.
_NORMAL = ndtri((np.arange(65536) + 0.5) / 65536.0).astype(np.float32)
_LIMITED = np.rint(16.0 + 219.0 / 255.0 * np.arange(256)).astype(np.uint8)  # ITU-R BT.601, shown as full range


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Disturbances of ball and picture."""

    noise: float = 0.0  # grey values, standard deviation, normal, independent in every channel
    brightness: float = 0.0  # grey values, added to all (Wittich 2017, table 24)
    dimming: tuple[Dimming, ...] = ()
    hands: tuple[HandVisit, ...] = ()
    flicker: Flicker | None = None
    limited: bool = False  # grey values 16..235 in place of 0..255
    lifts: tuple[Lift, ...] = ()
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


class _Set(NamedTuple):
    """The ball in its place, or in another."""

    centre: Array  # (3,) m, obj
    backdrop: Backdrop
    caps: Caps
    surface: Surface | None  # None without a pattern


class _Seen(NamedTuple):
    """The last frame's discs and ball, reused while the ball does not move."""

    attitude: Array  # (3, 3) R_obj_ball
    centre: Array  # (3,) m
    moments: list[Coverage]
    pixel: NDArray[np.intp]  # (k,) that show discs at some moment, or a pattern
    share: NDArray[np.float32]  # (k,) mean share of black in them
    discs: DiscTruth | None  # None where hands were in the way


class Renderer:
    """Renders frames of one scene. The constructor takes a few seconds, a frame takes milliseconds."""

    def __init__(self, scene: Scene, options: RenderOptions | None = None, backdrop: Backdrop | None = None) -> None:
        """`backdrop` may come from another renderer if both scenes look the same without discs. This saves seconds."""
        self.scene = scene
        self.options = RenderOptions() if options is None else options
        self.backdrop = render_backdrop(scene) if backdrop is None else backdrop
        reach = self.options.reach
        self._home = _set(np.zeros(3), self.backdrop, Caps(scene, reach))
        self._away = self._home
        self._layers = render_layers(scene, self.backdrop) if reach > 0.0 else None
        self._bytes = _to_bytes(self.backdrop.white)
        self._hand = draw_hand() if self.options.hands else None
        self._last: _Seen | None = None

    def frame(self, profile: Profile, t: float, sequence: int, rng: np.random.Generator) -> SimulatedFrame:
        """The picture at time `t` (s, mid-exposure of the middle row), with its truth."""
        now = np.array([t])
        attitude = profile.attitude(now)[0]
        scenery = self._at(sum((x.at(t) for x in self.options.lifts), attitude @ np.array(self.options.eccentric)))
        hands = self._hands(t)
        seen = self._look(profile, t, attitude, scenery)
        image = self._picture(seen, scenery, hands, t, rng)
        if hands or seen.discs is None:
            shows_ball = scenery.backdrop.ball.copy() if hands else scenery.backdrop.ball
            for hand in hands:
                shows_ball[hand.place] *= 1.0 - hand.paint[..., 3]
            view = BallView(shows_ball, scenery.backdrop.outline)
            middle = seen.moments[len(seen.moments) // 2]
            discs = scenery.caps.truth(profile.attitude, t, sequence, middle, view)
            if self._last is not None and not hands:
                self._last = seen._replace(discs=discs)
        else:
            discs = replace(seen.discs, frame=np.full(len(seen.discs), sequence, dtype=np.intp))
        return SimulatedFrame(
            Frame(image, t, sequence), attitude, profile.rate(now)[0], discs, scenery.centre, self.scene.pose
        )

    def _at(self, centre: Array) -> _Set:
        """All that goes with the ball's centre, (3,) m; rows and exposure share it."""
        if self._layers is None or not np.any(centre):
            return self._home
        if np.any(centre != self._away.centre):
            self._away = _set(centre, self._layers.backdrop(centre), self._home.caps.moved(centre))
        return self._away

    def _look(self, profile: Profile, t: float, attitude: Array, scenery: _Set) -> _Seen:
        """Return the discs in the picture. Reuse the last ones if ball and centre do not move during the frame."""
        half = 0.5 * (self.scene.exposure_s + self.scene.readout_s)
        throughout = profile.attitude(t + half * np.linspace(-1.0, 1.0, 5))
        last = self._last
        if (
            last is not None
            and np.array_equal(last.centre, scenery.centre)
            and np.all(throughout == attitude)
            and np.array_equal(last.attitude, attitude)
        ):
            return last
        times = self._moments(profile, t)
        moments = [scenery.caps.coverage(profile.attitude, moment) for moment in times]
        if self.scene.pattern is None or scenery.surface is None:
            pixel, share = _mean_coverage(moments)
        else:
            attitudes = (scenery.caps.attitude_by_row(profile.attitude, moment) for moment in times)
            pixel = scenery.surface.pixel
            share = _mean_black(self.scene.pattern, scenery.surface, attitudes, moments, self.scene.camera.width)
        seen = _Seen(attitude, scenery.centre, moments, pixel, share, None)
        self._last = seen if np.all(throughout == attitude) else None
        return seen

    def _picture(
        self, seen: _Seen, scenery: _Set, hands: Sequence[PlacedHand], t: float, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        options, pixel = self.options, seen.pixel
        white, black = scenery.backdrop.white, scenery.backdrop.black
        plain = white.reshape(-1, 3)[pixel]
        touched = plain + seen.share[:, None] * (black.reshape(-1, 3)[pixel] - plain)
        factor = self._light(t)
        if scenery is self._home and not hands and factor is None and options.brightness == 0.0 == options.noise:
            image = self._bytes.copy()
            image.reshape(-1, 3)[pixel] = _to_bytes(touched)
        else:
            picture = white.copy()
            picture.reshape(-1, 3)[pixel] = touched
            for hand in hands:
                part = picture[hand.place]
                part *= 1.0 - hand.paint[..., 3:]
                part += hand.paint[..., :3]
            if factor is not None:
                picture *= factor[:, None, None]
            image = _developed(picture, options.noise, options.brightness, rng)
        return np.asarray(cv2.LUT(image, _LIMITED), dtype=np.uint8) if options.limited else image

    def _light(self, t: float) -> NDArray[np.float32] | None:
        """Return the factor on the grey values of every row at its own time, (h or 1,), or None if it is 1."""
        options, scene = self.options, self.scene
        if not options.dimming and options.flicker is None:
            return None
        rows = np.arange(float(scene.camera.height)) if scene.readout_s > 0.0 else None
        times = np.array([t]) if rows is None else t + self._home.caps.row_offset(rows)
        factor = np.prod([d.at(times) for d in options.dimming], axis=0)
        if options.flicker is not None:
            factor = factor * options.flicker.at(times, scene.exposure_s)
        return None if np.all(factor == 1.0) else np.atleast_1d(factor).astype(np.float32)

    def _moments(self, profile: Profile, t: float) -> Array:
        """Times in the exposure, s, so close that no disc moves by more than a pixel from one to the next."""
        scene = self.scene
        if scene.exposure_s == 0.0:
            return np.array([t])
        ends = t + scene.exposure_s * np.array([-0.5, 0.0, 0.5])
        fastest = float(np.max(np.linalg.norm(profile.rate(ends), axis=1)))
        gap = np.linalg.norm(scene.pose.position) - scene.ball_radius
        pixels = fastest * scene.ball_radius * max(scene.camera.fx, scene.camera.fy) / gap * scene.exposure_s
        n = 2 * int(np.clip(np.ceil(pixels / 2.0), 0, 100)) + 1  # odd: one of them is t itself
        return t + scene.exposure_s * ((np.arange(n) + 0.5) / n - 0.5)

    def _hands(self, t: float) -> list[PlacedHand]:
        if self._hand is None:
            return []
        placed = [place_hand(self._hand, visit, self.scene, t) for visit in self.options.hands]
        return [p for p in placed if p is not None]


def _mean_coverage(moments: list[Coverage]) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Pixels that show discs at some moment, (k,), each once, and the mean share of them, (k,)."""
    pixel, group = np.unique(np.concatenate([m.pixel for m in moments]), return_inverse=True)
    share = np.bincount(group.ravel(), np.concatenate([m.share for m in moments]), len(pixel)) / len(moments)
    return pixel, share.astype(np.float32)


def _set(centre: Array, backdrop: Backdrop, caps: Caps) -> _Set:
    return _Set(centre, backdrop, caps, None if caps.scene.pattern is None else caps.surface(backdrop.ball))


def _mean_black(
    pattern: Pattern, surface: Surface, attitudes: Iterable[Array], moments: list[Coverage], width: int
) -> NDArray[np.float32]:
    """Return 1 less the mean albedo of the pixels of `surface`, (k,). Discs on the pattern are black.

    `attitudes`: R_obj_ball by rows, (1 or h, 3, 3), for each of the `moments`. If there are several, each has two
    opposite parts of a pixel and the next moment the other two: motion smooths, and the middle of a pixel stays.
    """
    light = np.zeros(len(surface.pixel), dtype=np.float32)
    halves = [surface] if len(moments) == 1 else [surface.parts(0, 3), surface.parts(1, 2)]
    for part, R, covered in zip(cycle(halves), attitudes, moments, strict=False):
        turn = R.astype(np.float32)[surface.pixel // width if len(R) > 1 else 0]
        albedo = pattern.albedo((part.normal @ turn).reshape(-1, 3)).reshape(part.weight.shape)
        discs = np.bincount(covered.pixel, covered.share, surface.pixel.max(initial=0) + 1)[surface.pixel]
        light += np.einsum("km,km->k", albedo, part.weight) * (1.0 - discs).astype(np.float32)
    return np.float32(1.0) - light / np.float32(len(moments))


def _developed(
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
