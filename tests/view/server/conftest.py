"""The page's server in front of a real daemon: a film behind a scripted camera."""

import shutil

import pytest
from daemon_world import Film, World
from page_server import serving


@pytest.fixture(scope="module")
def film():
    return Film.render()


@pytest.fixture(scope="module")
def daemon(film, tmp_path_factory):
    world = World(film, tmp_path_factory.mktemp("view"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("spheremouse.session.outputs.open_output", world.open_output)
        world.start()
        yield world
        world.stop()


@pytest.fixture
def world(daemon):
    """The daemon of all tests; each finds it as it began."""
    daemon.reach("tracking")
    before = daemon.config.read_text()
    yield daemon
    daemon.config.write_text(before)
    for command in ("reload", "resume"):
        daemon.client.ask(command)
    shutil.rmtree(daemon.folder / "recordings", ignore_errors=True)


@pytest.fixture
def page(world):
    with serving(world.socket) as port:
        yield port


@pytest.fixture
def alone(tmp_path):
    """The page without a daemon."""
    with serving(tmp_path / "s") as port:
        yield port
