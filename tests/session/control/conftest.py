import pytest


@pytest.fixture
def path(tmp_path_factory):
    """A short path; those of pytest may be too long for a socket."""
    return tmp_path_factory.mktemp("s") / "c"
