"""The first 50 frames of the reference recording far26, from pictures to figures: what a checkout alone can prove.

The recording was made by other code than ours (a path tracer), and the truth with it. The ball starts from rest and
reaches 24 deg/s; bolts, struts and a room of false candidates are in view.
"""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from spheremouse.cli import app
from spheremouse.recording import open_dataset, read_frames

CLIP = Path(__file__).parent / "data" / "far26_clip"
PIXELS = "496a5706d0b4a9948d538f8f1765bc9bfb67333c238568031b6c19b4358850d8"  # SHA-256 of the frames as OpenCV gave them for the recording itself


@pytest.fixture(scope="module", params=["so3", "ekf1", "ekf2"])
def figures(request, tmp_path_factory):
    """What `evaluate --json` writes of the clip, camera pose found from its images."""
    path = tmp_path_factory.mktemp("clip") / "figures.json"
    app(["evaluate", str(CLIP), "--tracker", request.param, "--json", str(path)], standalone_mode=False)
    return json.loads(path.read_text())


def pixels(folder, count):
    digest = hashlib.sha256()
    for frame, _ in zip(read_frames(open_dataset(folder)), range(count), strict=False):
        digest.update(np.ascontiguousarray(frame.image).tobytes())
    return digest.hexdigest()


def test_the_clip_is_decoded_bit_for_bit():
    assert open_dataset(CLIP).frames == 50
    assert pixels(CLIP, 50) == PIXELS


def test_the_clip_is_the_beginning_of_the_recording(far26):
    clip, whole = open_dataset(CLIP), open_dataset(far26)
    assert pixels(far26, clip.frames) == PIXELS
    np.testing.assert_array_equal(clip.truth.attitude, whole.truth.attitude[: clip.frames])
    np.testing.assert_array_equal(clip.truth.rate, whole.truth.rate[: clip.frames])
    np.testing.assert_array_equal(clip.discs.centre, whole.discs.centre[whole.discs.frame < clip.frames])


def test_every_frame_is_tracked(figures):
    assert figures["frames"] == figures["tracked"] == 50
    assert figures["lost_episodes"] == 0


def test_attitude_and_rate(figures):
    """Bounds of issue and thesis are for 300 frames; over these 50 so3 has 0.02 deg and 0.4 deg/s, the others 0.03, 0.9."""
    attitude, rate = (0.05, 0.8) if figures["tracker"] == "so3" else (0.1, 1.4)
    assert figures["attitude_rmse_deg"]["combined"] < attitude
    assert figures["rate_rmse_deg_s"]["combined"] < rate
    assert figures["surface_speed_r"]["combined"] > 0.998


def test_discs_and_only_discs_are_used(figures):
    detection = figures["detection"]
    assert detection["recall"] > 0.75  # 0.84: most of what is missed is cut by a strut's edge or near the limb
    assert detection["false_share"] == 0.0
    assert detection["centre_rms_px"] < 0.1
    assert figures["mean_discs"] > 3.5


def test_the_camera_pose_and_its_standard_deviations(figures):
    pose = figures["pose_error"]
    position, angle = np.abs(pose["position_mm"]), np.abs(pose["angle_deg"])
    assert position.max() < 0.5
    assert angle.max() < 0.02
    assert np.all(position < 3.5 * np.array(pose["sigma_position_mm"]))
    assert np.all(angle < 3.5 * np.array(pose["sigma_angle_deg"]))
