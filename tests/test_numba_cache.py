"""Where compiled code is kept when an account has no place of its own."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from spheremouse import numba_cache as compiled


def test_whoever_has_a_place_keeps_it(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(os, "access", lambda folder, mode: True)
    compiled.keep_somewhere()
    assert "NUMBA_CACHE_DIR" not in os.environ
    monkeypatch.setattr(os, "access", lambda folder, mode: False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    compiled.keep_somewhere()
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path)


@pytest.mark.parametrize("given", [True, False])
def test_an_account_without_a_place_gets_the_services_or_a_private_one(monkeypatch, tmp_path, given):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # so that it is set back afterwards
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    cache = tmp_path / "cache"
    cache.mkdir()
    monkeypatch.setenv("CACHE_DIRECTORY", str(cache))
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(os, "access", lambda folder, mode: given and folder == cache)
    compiled.keep_somewhere()
    kept = Path(os.environ["NUMBA_CACHE_DIR"])
    assert kept == cache if given else kept.parent == tmp_path and kept.stat().st_mode & 0o077 == 0


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="accounts")
def test_a_folder_that_others_may_write_is_not_trusted(monkeypatch, tmp_path):
    planted = tmp_path / f"spheremouse-{os.getuid()}"
    planted.mkdir(mode=0o777)
    planted.chmod(0o777)
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(os, "access", lambda folder, mode: False)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # so that it is set back afterwards
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    compiled.keep_somewhere()
    assert Path(os.environ["NUMBA_CACHE_DIR"]) != planted


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="takes root to become somebody else")
def test_an_account_without_a_home_can_run_it(tmp_path):
    """As a service's user that owns nothing; skipped where that user cannot read this checkout either."""
    code = "import os; os.setgroups([]); os.setgid(65534); os.setuid(65534); import spheremouse.commands; print('fine')"
    environment = {"PATH": os.environ["PATH"], "HOME": "/nonexistent", "TMPDIR": "/tmp"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment, cwd="/"
    )
    if "PermissionError" in done.stderr or "No module named" in done.stderr:
        pytest.skip("the checkout is not readable for others")
    assert done.stdout == "fine\n", done.stderr
