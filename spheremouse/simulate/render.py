"""Frames of a simulated scene, each with its exact truth.

What stands still is rendered once (`backdrop`); a frame mixes in the discs (`caps`), averaged over the exposure, row
by row where the shutter rolls, then hands, brightness and noise. Mixing is done in grey values, as a camera with a
linear response would.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.frame import Frame
from spheremouse.rotation import Array
from spheremouse.simulate.backdrop import Backdrop, render_backdrop
from spheremouse.simulate.caps import BallView, Caps, Coverage
from spheremouse.simulate.hands import HandVisit, PlacedHand, draw_hand, place_hand
from spheremouse.simulate.profile import Profile
from spheremouse.simulate.scene import Scene
from spheremouse.simulate.truth import DiscTruth


@dataclass(frozen=True, slots=True)
class Dimming:
    """The picture gets darker for a while, without a step."""

    start: float  # s
    end: float  # s
    factor: float  # on the grey values

    def at(self, t: float) -> float:
        """Factor at time `t`; it takes 0.2 s to change."""
        x = min(max(min(t - self.start, self.end - t) / 0.2, 0.0), 1.0)
        return 1.0 + (self.factor - 1.0) * x * x * (3.0 - 2.0 * x)


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """What happens to the picture."""

    noise: float = 0.0  # grey values, standard deviation, normal, independent in every channel
    brightness: float = 0.0  # grey values, added to all (Wittich 2017, table 24)
    dimming: tuple[Dimming, ...] = ()
    hands: tuple[HandVisit, ...] = ()


@dataclass(frozen=True, slots=True)
class SimulatedFrame:
    """A frame with what really happened."""

    frame: Frame
    attitude: Array  # (3, 3) R_obj_ball at the stamp
    rate: Array  # (3,) rad/s, w_obj at the stamp
    discs: DiscTruth  # of this frame


class Renderer:
    """Renders frames of one scene; making it takes a few seconds, a frame takes milliseconds."""

    def __init__(self, scene: Scene, options: RenderOptions | None = None, backdrop: Backdrop | None = None) -> None:
        """`backdrop`: that of another renderer whose scene looks the same without discs; it saves the seconds."""
        self.scene = scene
        self.options = RenderOptions() if options is None else options
        self.backdrop = render_backdrop(scene) if backdrop is None else backdrop
        self._caps = Caps(scene)
        self._change = (self.backdrop.black - self.backdrop.white).reshape(-1, 3)
        self._bytes = _to_bytes(self.backdrop.white)
        self._hand = draw_hand() if self.options.hands else None

    def frame(self, profile: Profile, t: float, sequence: int, rng: np.random.Generator) -> SimulatedFrame:
        """The picture at time `t` (s, mid-exposure of the middle row), with its truth."""
        moments = [self._caps.coverage(profile.attitude, moment) for moment in self._moments(profile, t)]
        hands = self._hands(t)
        image = self._picture(moments, hands, t, rng)
        shows_ball = self.backdrop.ball.copy() if hands else self.backdrop.ball
        for hand in hands:
            shows_ball[hand.place] *= 1.0 - hand.paint[..., 3]
        view = BallView(shows_ball, self.backdrop.outline)
        discs = self._caps.truth(profile.attitude, t, sequence, moments[len(moments) // 2], view)
        now = np.array([t])
        return SimulatedFrame(Frame(image, t, sequence), profile.attitude(now)[0], profile.rate(now)[0], discs)

    def _picture(
        self, moments: list[Coverage], hands: list[PlacedHand], t: float, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        pixel, share = _mean_coverage(moments)
        options = self.options
        factor = float(np.prod([d.at(t) for d in options.dimming]))
        touched = self.backdrop.white.reshape(-1, 3)[pixel] + share[:, None] * self._change[pixel]
        if not hands and factor == 1.0 and options.brightness == 0.0 and options.noise == 0.0:
            image = self._bytes.copy()
            image.reshape(-1, 3)[pixel] = _to_bytes(touched)
            return image
        picture = self.backdrop.white.copy()
        picture.reshape(-1, 3)[pixel] = touched
        for hand in hands:
            part = picture[hand.place]
            part *= 1.0 - hand.paint[..., 3:]
            part += hand.paint[..., :3]
        if options.noise > 0.0:
            noise = rng.standard_normal(picture.shape, dtype=np.float32)
            return _to_bytes(cv2.addWeighted(picture, factor, noise, options.noise, options.brightness))
        return _to_bytes(factor * picture + np.float32(options.brightness))

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


def _to_bytes(picture: cv2.typing.MatLike) -> NDArray[np.uint8]:
    """Rounded and clipped to 0..255."""
    return np.asarray(cv2.add(picture, np.zeros_like(picture), dtype=cv2.CV_8U), dtype=np.uint8).reshape(picture.shape)
