"""Tracker of hand-held balls, with the filter that its settings choose."""

import numpy as np

from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.wand import track
from spheremouse.wand.ball import WandBall
from spheremouse.wand.colour import DEFAULT_COLOURS
from spheremouse.wand.model import ball_model
from spheremouse.wand.published import track as published
from spheremouse.wand.settings import ColourSettings, WandSettings
from spheremouse.wand.state import WandTracker


def build(
    camera: InteriorOrientation,
    balls: tuple[WandBall, ...],
    settings: WandSettings | None = None,
    colours: dict[str, ColourSettings] | None = None,
) -> WandTracker:
    """Return a tracker of `balls` before a camera. `colours` override the default bounds by name."""
    settings = settings or WandSettings()
    discs = tuple(np.array([[*d.direction, d.angle] for d in ball.discs]) for ball in balls)
    names = tuple(sorted({c for ball in balls for c in ball.colours}))
    models = tuple(ball_model(ball, camera, names) for ball in balls)
    bounds = DEFAULT_COLOURS | (colours or {})
    follow = track.follow if settings.method == "peaks" else published.follow
    return WandTracker(settings, camera, balls, models, discs, bounds, names, follow)
