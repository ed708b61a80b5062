import pytest

from spheremouse.simulate.ball.render import Renderer
from spheremouse.simulate.ball.scene import default_scene


@pytest.fixture(scope="session")
def small():
    return Renderer(default_scene(width=320, height=240, discs=40))
