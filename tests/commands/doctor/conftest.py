"""No daemon and no service of this computer, and a home of the test's own."""

import pytest

from spheremouse.commands.doctor import files
from spheremouse.commands.service import check
from spheremouse.commands.service.systemd import Place


@pytest.fixture(autouse=True)
def _nobody_home(monkeypatch, tmp_path):
    monkeypatch.setenv("SPHEREMOUSE_SOCKET", str(tmp_path / "nobody"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(files, "Place", lambda user=False: Place(tmp_path, user))
    monkeypatch.setattr(check, "Place", lambda root, user=False: Place(tmp_path, user))
