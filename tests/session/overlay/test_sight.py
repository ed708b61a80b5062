"""What is drawn before the camera's pose is known."""

import numpy as np

from spheremouse.ball.detect.rings import RingSettings
from spheremouse.session.overlay.pen import in_blocks
from spheremouse.session.overlay.sight import draw_sight, sight_of
from tests.ball.detect.test_rings import RADII, blank, photo, target


def test_targets_of_the_rig_strangers_and_a_grey_picture():
    image = blank(240, 320)
    target(image, "CMY", (80.0, 80.0), 20.0)
    target(image, "YCM", (220.0, 80.0), 20.0)
    sight = sight_of(photo(image), RADII, ("CMY", "MCY"), RingSettings())
    assert sight.strangers == ("YCM",)
    assert sight_of(photo(image), RADII, None, RingSettings()).strangers == ()
    assert len(sight_of(photo(image)[:, :, 0], RADII, ("CMY",), RingSettings()).targets) == 0
    kept = sight.kept((240, 320)) > 0
    assert kept[80, 80 + 38]
    assert not kept[80, 80 + 42]
    assert draw_sight(photo(image), sight, (("words", 0.0),)).shape == (960, 1280, 3)


def test_blocks_hide_what_is_not_kept_and_nothing_else():
    rng = np.random.default_rng(0)
    for shape in ((480, 640, 3), (480, 640), (7, 1000, 3)):
        image = rng.integers(0, 256, shape).astype(np.uint8)
        keep = np.zeros(shape[:2], np.uint8)
        keep[:5, :50] = 255
        made = in_blocks(image, keep)
        assert np.array_equal(made[keep > 0], image[keep > 0])
        hidden = made[keep == 0].reshape(int((keep == 0).sum()), -1)
        assert len(np.unique(hidden, axis=0)) <= 24 * max(1, round(24 * shape[0] / shape[1]))
