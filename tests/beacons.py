"""A detector that sees nothing of a picture: its first pixels hold the attitude, and points follow from it."""

from dataclasses import dataclass, replace

import numpy as np
from conftest import directions

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.detect.appearance import seen_at
from spheremouse.ball.detect.detections import Detections, no_detections
from spheremouse.ball.detect.diagnosis import Absence, Cause
from spheremouse.ball.detector import Words
from spheremouse.ball.disc_map import DiscMap

PLACES = directions(20, 0, 0.5)  # (20, 3) in ball
SIGMA = 0.1  # px, of a point
MAGIC = np.frombuffer(b"attitude", np.uint8)
BYTES = len(MAGIC) + 9 * 8
WORDS = Words("beacon", "beacons", "beacons", "{n} lamp{s} masked", "its beacons were moved", "no beacon seen")


def with_attitude(frame, attitude):
    """The frame with an attitude in the first pixels of its picture."""
    image = np.ascontiguousarray(frame.image)
    image.reshape(-1)[:BYTES] = np.concatenate([MAGIC, np.frombuffer(attitude.tobytes(), np.uint8)])
    return replace(frame, image=image)


@dataclass(frozen=True, slots=True)
class Beacons:
    """The places that face the camera, with white noise."""

    words: Words = WORDS
    map_type: type[BallMap] = DiscMap
    sees_discs: bool = False
    is_exact: bool = True
    uses_colours: bool = False
    keeps_state: bool = False

    def landmark_angle(self, rig):
        return 0.03

    def mark_radius(self, rig):
        return 0.03 * rig.ball.radius

    def shared_errors(self, rig, pose):
        return np.zeros((10, 10))

    def prepare(self, rig, pose, settings, before=None):
        return rig, pose

    def detect(self, state, frame, tracker, predicted):
        data = frame.image.reshape(-1)[:BYTES]
        if not np.array_equal(data[: len(MAGIC)], MAGIC):
            return no_detections(), state.search
        attitude = np.frombuffer(data[len(MAGIC) :].tobytes(), np.float64).reshape(3, 3)
        rig, pose = tracker.detector_data
        towards = pose.position - rig.ball.centre
        seen = PLACES @ attitude.T
        seen = seen[seen @ towards > 1.2 * rig.ball.radius]
        noise = np.random.default_rng(frame.sequence).normal(0.0, SIGMA, (len(seen), 2))
        covariance = np.tile(SIGMA**2 * np.eye(2), (len(seen), 1, 1))
        return Detections(seen_at(seen, rig, pose) + noise, covariance, np.full(len(seen), 30.0)), state.search

    def clear_points(self, points):
        return points

    def why_absent(self, image, rig, pose, settings, known):
        return Absence(Cause.DARK, 0.0)

    def support_mask(self, rig, pose, settings):
        mask = np.zeros((rig.camera.height, rig.camera.width), np.uint8)
        mask.reshape(-1)[: -(-BYTES // 3)] = 255
        return mask
