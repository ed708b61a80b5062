"""Pictures, from noise to thousands of spots, and detections, through the detectors and the tracker."""

from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.discs import DiscSettings, disc_detector
from spheremouse.ball.detect.rings import RingSettings, detect_targets
from spheremouse.ball.pose import gather, resect
from spheremouse.ball.published.blobs import BlobDetector
from spheremouse.ball.settings import BlobSettings, Settings
from spheremouse.ball.track import advance
from tests.fuzz.fuzzing import fuzz, refused
from tests.fuzz.scene import DT, known, pictures, small_rig, use


@fuzz(lambda: st.tuples(pictures(), st.integers(0, 3)))
def test_any_picture(drawn: tuple[NDArray[np.uint8], int]) -> None:
    image, shift = drawn
    _sound(BlobDetector(BlobSettings()).detect(image), image)
    if image.ndim == 3:
        radii = np.array([0.012, 0.024, 0.036]) * (1.0, 0.5, 2.0, 10.0)[shift]
        found = detect_targets(image, radii, RingSettings())
        assert np.all(np.isfinite(found.centre))
        assert np.all(found.radius > 0)
        refused(lambda: resect(gather([found] * 2), small_rig(), image))


@fuzz(lambda: st.lists(pictures(160, 120), min_size=1, max_size=4))
def test_pictures(drawn: list[NDArray[np.uint8]]) -> None:
    images = [np.require(image, requirements=("C", "W")) for image in drawn]  # as frames come
    rig = small_rig()
    assert rig.pose is not None
    for polarity in ("auto", "dark", "light"):
        detector = disc_detector(DiscSettings(polarity=polarity, min_area=3.0), rig, rig.pose)
        for image in images:
            _sound(detector.detect(image), image)
    refused(lambda: use(replace(rig, pose=None), Settings(), images))
    use(rig, replace(Settings(), discs=DiscSettings(min_area=3.0)), images)


def _sound(found: Detections, image: NDArray[np.uint8]) -> None:
    n = len(found)
    assert found.centre.shape == (n, 2)
    assert found.covariance.shape == (n, 2, 2)
    assert np.all(np.isfinite(found.centre))
    assert np.all(np.isfinite(found.covariance))
    assert np.all(np.linalg.eigvalsh(found.covariance) > 0)
    assert np.all(found.area > 0)
    assert np.all(found.centre >= -1)
    assert np.all(found.centre <= (image.shape[1], image.shape[0]))


@st.composite
def _sights(draw: st.DrawFn) -> tuple[str, list[tuple[float, Any]]]:
    """A tracker, and stamps with detections: at random, still, or moved along by a few pixels; on the ball and off."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    stamp, uv = draw(st.floats(-1e6, 1e6)), rng.uniform((150, 70), (490, 410), (12, 2))
    sights: list[tuple[float, Any]] = []
    for _ in range(draw(st.integers(1, 40))):
        match draw(st.integers(0, 6)):
            case 0:
                uv = rng.uniform(-2000, 2000, (draw(st.integers(0, 30)), 2))
            case 1:
                uv = rng.uniform((150, 70), (490, 410), (draw(st.integers(0, 40)), 2))
            case 2:
                uv = np.repeat(uv[:3], 3, axis=0)
            case _:
                uv = uv + rng.normal(0, 3, 2)
        stamp += draw(st.sampled_from([DT, DT, DT, DT, 0.0, -DT, 5.0, -5.0, 1e-9, 1e5, -1e5]))
        sights.append((stamp, uv))
    return draw(st.sampled_from(["so3", "so3", "ekf1", "ekf2"])), sights


@fuzz(_sights)
def test_detections(drawn: tuple[str, list[tuple[float, Any]]]) -> None:
    name, sights = drawn
    rig = known()
    assert rig.pose is not None
    tracker = build(rig, rig.pose, Settings(tracker=name))  # pyright: ignore[reportArgumentType]
    state = begin(tracker, sights[0][0])
    for stamp, uv in sights:
        seen = Detections(uv, np.tile(0.01 * np.eye(2), (len(uv), 1, 1)), np.full(len(uv), 50.0))
        state, estimate, _ = advance(state, stamp, seen, tracker)
        for values in (estimate.increment[:3], estimate.rate, state.filter.attitude, state.filter.covariance):
            assert np.all(np.isfinite(values)), "a number that is not finite"
        assert np.abs(state.filter.attitude @ state.filter.attitude.T - np.eye(3)).max() < 1e-6, "no rotation"
