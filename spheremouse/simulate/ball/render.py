"""Frames of a simulated scene, each with its exact truth.

The renderer draws the still parts of the scene once (`backdrop`). Each frame mixes in what is painted on the ball
(`surface`), averaged over the exposure and row by row with a rolling shutter, then hands, light and noise. It mixes
grey values, like a camera with a linear response.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.truth import DiscTruth
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import Array
from spheremouse.simulate.ball.backdrop import Backdrop, render_backdrop, render_layers
from spheremouse.simulate.ball.events import Dimming, Flicker, HandVisit, Lift, Sway, place_hand
from spheremouse.simulate.ball.profile import Profile
from spheremouse.simulate.ball.scene import Scene
from spheremouse.simulate.ball.surface import Surface
from spheremouse.simulate.layers import lay
from spheremouse.simulate.light import expose
from spheremouse.tracker import Frame

_MAX_MOMENTS = 201  # of an exposure
_LIMITED = np.rint(16.0 + 219.0 / 255.0 * np.arange(256)).astype(np.uint8)  # ITU-R BT.601, shown as full range


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """Disturbances of ball and picture. Lengths are times the scene's scale."""

    noise: float = 0.0  # grey values, standard deviation, normal, independent in every channel
    brightness: float = 0.0  # grey values, added to all (Wittich 2017, table 24)
    light: tuple[Dimming | Flicker, ...] = ()
    hands: tuple[HandVisit, ...] = ()
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


class Renderer:
    """Renders frames of one scene. The constructor takes a few seconds, a frame takes milliseconds."""

    def __init__(self, scene: Scene, options: RenderOptions | None = None, backdrop: Backdrop | None = None) -> None:
        """`backdrop` may come from another renderer if both scenes look the same without discs. This saves seconds."""
        self.scene, self.options = scene, RenderOptions() if options is None else options
        self._unit = scene = scene.scaled(1.0 / scene.scale)  # in the unit of length of its surroundings
        self.backdrop = render_backdrop(scene) if backdrop is None else backdrop
        reach = self.options.reach
        self._surface = Surface(scene, reach)
        self._points = self._surface.points(self.backdrop.ball)
        self._layers = render_layers(scene) if reach > 0.0 else None

    def frame(self, profile: Profile, t: float, sequence: int, rng: np.random.Generator) -> SimulatedFrame:
        """The picture at time `t` (s, mid-exposure of the middle row), with its truth."""
        scene, options, now = self.scene, self.options, np.array([t])
        attitude = profile.attitude(now)[0]
        centre = sum((x.at(t) for x in options.lifts), attitude @ np.array(options.eccentric))
        picture, discs = self.picture(profile, t, centre)
        for change in options.light:
            factor = change.at(self._surface.row_times(t), scene.exposure_s)
            picture *= np.reshape(factor, (-1, 1, 1)).astype(np.float32)
        image = expose(picture, options.noise, rng, options.brightness)
        if options.limited:
            image = np.asarray(cv2.LUT(image, _LIMITED), dtype=np.uint8)
        discs = replace(discs, frame=np.full(len(discs), sequence, dtype=np.intp))
        return SimulatedFrame(
            Frame(image, t, sequence), attitude, profile.rate(now)[0], discs, scene.scale * centre, scene.pose
        )

    def picture(self, profile: Profile, t: float, centre: Array) -> tuple[NDArray[np.float32], DiscTruth]:
        """Return ball, room and hands as the lens maps them, (h, w, 3) grey values, and the discs, of frame 0.

        `centre`, (3,) in the unit of length of the surroundings, is that of the ball in all rows and all the exposure.
        """
        backdrop, surface, points = self.backdrop, self._surface, self._points
        if self._layers is not None and np.any(centre):
            backdrop, surface = self._layers.backdrop(centre), surface.moved(centre)
            points = surface.points(backdrop.ball)
        times = self._moments(profile, t)
        covered = [surface.coverage(profile.attitude, moment) for moment in times]
        dark = np.zeros(backdrop.ball.size)
        for cover, moment in zip(covered, times, strict=True):
            share = cover.share
            if points is not None:
                light = surface.albedo(points, profile.attitude, moment)
                dark += 1.0 - light
                share = share * light[cover.pixel]  # a disc hides the pattern
            dark += np.bincount(cover.pixel, share, dark.size)
        pixel = np.flatnonzero(dark)
        share = (dark[pixel] / len(times)).astype(np.float32)[:, None]
        picture, shown = backdrop.white.copy(), backdrop.ball.copy()
        white, black = picture.reshape(-1, 3), backdrop.black.reshape(-1, 3)
        white[pixel] += share * (black[pixel] - white[pixel])
        for visit in self.options.hands:
            if (hand := place_hand(visit, self._unit, t)) is not None:
                lay(picture, hand)
                shown[hand.window.slices] *= 1.0 - hand.paint[..., 3]
        return picture, surface.truth(profile.attitude, t, covered[len(times) // 2], shown, backdrop.outline)

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
