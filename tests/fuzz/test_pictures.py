"""Pictures, from noise to thousands of spots, and detections, through the detectors and the tracker."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.detections import Detections
from spheremouse.ball.detect.discs import DiscSettings, disc_detector
from spheremouse.ball.detect.rings import MOST, RingSettings, detect_targets
from spheremouse.ball.pose import find_pose, gather, resect
from spheremouse.ball.published.blobs import BlobDetector
from spheremouse.ball.rig import CODES
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
    images = [
        np.require(image, requirements=("C", "W")) for image in drawn
    ]  # as frames come: no other are compiled for
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


_RADII = np.array([0.012, 0.024, 0.036])
_INKS = np.array([(205, 190, 30), (170, 40, 190), (40, 205, 215), (200, 200, 200)], dtype=np.uint8)


@dataclass(frozen=True)
class Clutter:
    """A picture with thousands of spots in the targets' colours. Its repr is short."""

    kind: str
    size: tuple[int, int]
    pitch: int  # px, of one spot or stripe
    seed: int

    def picture(self) -> NDArray[np.uint8]:
        """(h, w, 3) BGR."""
        (w, h), pitch, rng = self.size, self.pitch, np.random.default_rng(self.seed)
        image = np.full((h, w, 3), 200, np.uint8)
        across, down = -(-w // pitch), -(-h // pitch)
        match self.kind:
            case "dots":
                for _ in range(min(across * down, 10_000)):
                    _dot(image, (int(rng.integers(w)), int(rng.integers(h))), int(rng.integers(1, pitch + 1)), rng)
            case "targets":
                for k in range(across * down):
                    centre = (k % across * pitch + pitch // 2, k // across * pitch + pitch // 2)
                    for ink, share in zip(rng.permutation(3), (0.48, 0.32, 0.16), strict=True):
                        cv2.circle(image, centre, round(share * pitch), _INKS[ink].tolist(), -1, cv2.LINE_AA)
            case "within one another":
                for k, radius in enumerate(range(max(w, h), 1, -pitch)):
                    cv2.circle(image, (w // 2, h // 2), radius, _INKS[k % 3].tolist(), -1)
            case "noise":
                image = (
                    rng.integers(0, 256, (down, across, 3), dtype=np.uint8).repeat(pitch, 0).repeat(pitch, 1)[:h, :w]
                )
            case "cells":
                image = _INKS[rng.integers(0, 4, (down, across))].repeat(pitch, 0).repeat(pitch, 1)[:h, :w]
            case "stripes":
                image = np.broadcast_to(_INKS[np.arange(w) // pitch % 3], (h, w, 3))
            case _:
                soft = cv2.GaussianBlur(rng.normal(size=(h, w, 3)), (0, 0), 0.4 * pitch)
                image = np.clip(128.0 + 90.0 * soft / soft.std(), 0, 255).astype(np.uint8)
        return np.ascontiguousarray(image)


_KINDS = ("dots", "targets", "within one another", "noise", "cells", "stripes", "photo")


def _dot(image: NDArray[np.uint8], centre: tuple[int, int], radius: int, rng: np.random.Generator) -> None:
    cv2.circle(image, centre, radius, _INKS[rng.integers(0, 3)].tolist(), -1, cv2.LINE_AA)


@fuzz(
    lambda: st.builds(
        Clutter,
        st.sampled_from(_KINDS),
        st.sampled_from([(160, 120), (640, 480), (1920, 1080)]),
        st.integers(2, 40),
        st.integers(0, 2**32 - 1),
    ),
)
def test_clutter(clutter: Clutter) -> None:
    image = clutter.picture()
    found = detect_targets(image, _RADII, RingSettings())
    assert len(found) == len(found.radius) == len(found.contours) <= MOST * len(CODES)
    assert np.all(np.isfinite(found.centre))
    assert np.all(found.radius > 0)
    refused(lambda: find_pose([found] * 2, small_rig(), image))
