"""Pictures of any kind, and the small simulated device that they are shown to."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from spheremouse.ball.build import begin, build
from spheremouse.ball.rig import Rig
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import step
from spheremouse.session.offline import initialise
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.tracker import Frame

DT = 1.0 / 30.0


@st.composite
def pictures(draw: st.DrawFn, width: int | None = None, height: int | None = None) -> NDArray[np.uint8]:
    """Any picture a frame may hold: noise, flats, shapes, real ones cut up; grey or colour, in any layout of memory."""
    w = draw(st.integers(1, 200)) if width is None else width
    h = draw(st.integers(1, 200)) if height is None else height
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    match draw(st.integers(0, 4)):
        case 0:
            image = np.full((h, w, 3), draw(st.tuples(*[st.integers(0, 255)] * 3)), np.uint8)
        case 1:
            image = rng.integers(0, draw(st.integers(1, 256)), (h, w, 3), dtype=np.uint8)
        case 2:
            image = np.full((h, w, 3), draw(st.integers(0, 255)), np.uint8)
            for _ in range(draw(st.integers(1, 60))):
                centre = [int(v) for v in rng.integers(-20, 220, 2)]
                axes = [int(v) for v in rng.integers(0, draw(st.integers(2, 60)), 2)]
                colour = [int(v) for v in rng.choice([0, 40, 128, 220, 255], 3)]
                cv2.ellipse(image, centre, axes, float(rng.uniform(0, 180)), 0, 360, colour, -1, cv2.LINE_AA)
        case 3:
            image = np.kron(rng.integers(0, 256, (h // 8 + 1, w // 8 + 1, 3)), np.ones((8, 8, 1)))[:h, :w]
            image = image.astype(np.uint8)
        case _:
            image = cv2.resize(film()[0].image, (w, h), interpolation=cv2.INTER_AREA)
            image = np.roll(image, [int(v) for v in rng.integers(-30, 30, 2)], axis=(0, 1))
            image = cv2.convertScaleAbs(image, alpha=draw(st.floats(0, 4)), beta=draw(st.floats(-100, 100)))
    image = np.asarray(image, dtype=np.uint8).reshape(h, w, 3)
    match draw(st.integers(0, 4)):
        case 0:
            return np.ascontiguousarray(image[..., 0])
        case 1:
            return image[..., ::-1]  # not contiguous
        case 2:
            image.flags.writeable = False
    return image


@cache
def film() -> list[Frame]:
    return [made.frame for made in simulate(prepare(SimulationOptions(seconds=0.2)))]


@cache
def known() -> Rig:
    scene = prepare(SimulationOptions()).scene
    return replace(scene.rig(), pose=scene.pose)


@cache
def small_rig() -> Rig:
    """The device filmed at 160x120."""
    scene = prepare(SimulationOptions(size=(160, 120))).scene
    return replace(scene.rig(), pose=scene.pose)


def use(rig: Rig, chosen: Settings, images: list[NDArray[np.uint8]]) -> None:
    """Find the pose and track, as a run with this rig and these settings would."""
    frames = iter([Frame(image, k * DT, k) for k, image in enumerate(images)])
    start = initialise(frames, rig, chosen)
    tracker = build(rig, start.pose, chosen)
    state = begin(tracker, 0.0)
    for frame in start.frames:
        state, estimate, _ = step(state, frame, tracker)
        assert np.all(np.isfinite(estimate.increment[:3]))
