"""A film of a speckled ball, which the tests of the texture share."""

import pytest

from tests.ball.texture.test_method import film, follow


@pytest.fixture(scope="session")
def speckle():
    """Frames of a ball that begins to roll, a tracker that knows rig and pose, and its steps over them."""
    made, tracker = film("speckle")
    return made, tracker, follow([m.frame for m in made], tracker)
