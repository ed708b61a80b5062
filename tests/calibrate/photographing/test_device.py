"""Which pictures of a device are taken: against the true places of the camera that photographed a simulated one."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from photographed import looked, resumed

from spheremouse.ball.device import Axes, Device
from spheremouse.calibrate.photographing.device import DeviceSelector
from spheremouse.errors import CalibrationError
from spheremouse.geometry.camera import Pose
from spheremouse.geometry.rotation import exp
from spheremouse.simulate.ball.stills import StillsOptions, device_picture, photos, prepare_stills

pytestmark = pytest.mark.slow  # films of many stills


@pytest.fixture(scope="module")
def stills():
    return prepare_stills(StillsOptions(photos=6, boards=0, size=(1280, 720), seed=1))


@pytest.fixture(scope="module")
def pictures(stills):
    return [photo.image for photo in photos(stills)]


def selector_of(stills, *pictures, **changes):
    targets, scene = stills.scene.targets, stills.scene
    device = Device(targets.ids, targets.codes, targets.radii, scene.disc_radius, Axes(2, 1, 3))
    camera = replace(scene.camera, covariance=1e-2 * np.eye(9) * np.array([1, 1, 1, 1, *[1e-6] * 5]))
    return resumed(DeviceSelector(replace(device, **changes), camera), *pictures)


def photographed(stills, pose):
    picture = device_picture(replace(stills.scene, pose=pose))
    noise = np.random.default_rng(5).normal(0.0, 1.0, picture.shape)
    return np.clip(np.rint(cv2.GaussianBlur(picture, (0, 0), 0.5) + noise), 0, 255).astype(np.uint8)


def turned(stills, pose, degrees, axis=(0.0, 1.0, 0.0)):
    middle = stills.scene.targets.position.mean(axis=0)
    R = exp(np.radians(degrees) * np.asarray(axis))
    return Pose(R @ pose.rotation, middle + R @ (pose.position - middle))


def test_a_picture_from_a_new_side_is_taken_and_its_angle_is_the_true_one(stills, pictures):
    selector = selector_of(stills, *pictures[:2])
    check = looked(selector, pictures[2])
    way = np.array([p.position for p in stills.device_poses[:3]]) - stills.scene.targets.position.mean(axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    true = np.degrees(np.arccos(way[:2] @ way[2])).min()
    (told,) = re.findall(r"(\d+)° from the nearest photo", check.gain)
    assert float(told) == pytest.approx(true, abs=1.0)


def test_the_same_side_is_taken_once_unless_it_is_from_nearer(stills, pictures):
    selector = selector_of(stills, *pictures[:2])
    front = stills.device_poses[0]
    near = looked(selector, photographed(stills, turned(stills, front, 6.0)))
    assert not near.gain
    assert "6° from a photo there is, 10° are wanted" in near.words
    assert looked(selector, photographed(stills, turned(stills, front, 14.0))).gain.startswith("14°")
    middle = stills.scene.targets.position.mean(axis=0)
    closer = Pose(front.rotation, middle + 0.7 * (front.position - middle))
    assert looked(selector, photographed(stills, closer)).gain == "from nearer"


def test_what_moves_or_is_blurred_is_refused(stills, pictures):
    selector = selector_of(stills)
    assert "hold still" in selector.check(pictures[0]).words
    assert "moves by 4 px" in selector.check(np.roll(pictures[0], 4, axis=1)).words
    assert looked(selector, pictures[0]).gain == "the first"
    blurred = looked(selector, cv2.GaussianBlur(pictures[0], (0, 0), 1.5))
    assert not blurred.gain
    assert re.search(r"blurred \(edges of 1\.\d px, 0\.4 px at best\)", blurred.words)


def test_too_few_targets_another_device_and_a_mirrored_picture_are_named(stills, pictures):
    selector = selector_of(stills, *pictures[:2])
    assert "0 of 4 targets found" in looked(selector, np.full_like(pictures[0], 90)).words
    assert looked(selector, np.zeros_like(pictures[0])).words == "the picture is dark"
    assert not looked(selector, pictures[2][:, ::-1].copy()).gain
    with pytest.raises(CalibrationError, match="colour"):
        selector.check(pictures[0][..., 0])


def test_photos_from_missing_sides_are_wanted_until_all_sides_have_one(stills, pictures):
    selector = selector_of(stills, *pictures[:2])
    assert "take one from the right" in selector.wanted()
    assert "take one from the left" not in selector.wanted()
    assert not selector.enough
    selector = selector_of(stills)
    for image in pictures:
        selector.add(selector.check(image).seen)
    assert selector.wanted() == ["take more from places between"]
    assert selector.enough


def test_a_complete_set_grows_if_the_session_is_called_again(stills, pictures):
    selector = selector_of(stills, *pictures)
    assert not selector.enough
    for _ in range(2):
        selector.add(selector.check(pictures[0]).seen)
    assert selector.enough
