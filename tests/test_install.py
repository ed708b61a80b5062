"""service/install.sh with versions of a stand-in: beside each other, switched and back, gone. No network, no root.

The stand-in is a wheel made here, with a command that says its version; pip is the one that Python brings.
"""

import ensurepip
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from spheremouse import service

SCRIPT = service.folder() / "install.sh"
pytestmark = pytest.mark.skipif(sys.platform != "linux" or shutil.which("flock") is None, reason="needs Linux, flock")


def make_wheel(folder, version, code="print('stand-in {}'); "):
    """A wheel of that version, with what the installer asks for."""
    info = f"spheremouse-{version}.dist-info"
    files = {
        "spheremouse.py": f"def main():\n    {code.format(version)}\n",
        **{f"{name}.py": "" for name in ("cv2", "numba", "scipy")},
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: spheremouse\nVersion: {version}\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": "[console_scripts]\nspheremouse = spheremouse:main\n",
    }
    files[f"{info}/RECORD"] = "".join(f"{name},,\n" for name in [*files, f"{info}/RECORD"])
    path = folder / f"spheremouse-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        for name, text in files.items():
            wheel.writestr(name, text)
    return path


@pytest.fixture
def wheels(tmp_path):
    folder = tmp_path / "wheels"
    folder.mkdir()
    places = (Path(ensurepip.__file__).parent / "_bundled", Path("/usr/share/python-wheels"))
    bundled = [wheel for place in places for wheel in place.glob("pip-*.whl")]
    if not bundled:
        pytest.skip("this Python brings no wheel of pip")
    shutil.copy(bundled[0], folder)
    make_wheel(folder, "1.9")
    return folder


def call(tmp_path, *arguments, script=SCRIPT):
    """Exit code and what was said; the prefix has a space in no test, since systemd would not have it."""
    command = ["bash", script, "--no-service", "--prefix", tmp_path / "opt", "--bin", tmp_path / "bin", *arguments]
    environment = {"PATH": os.environ["PATH"], "HOME": str(tmp_path), "PYTHON": sys.executable}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120, check=False)
    return done.returncode, done.stdout + done.stderr


def in_use(tmp_path):
    """What the command says that an operator types."""
    return subprocess.run([tmp_path / "bin" / "spheremouse"], capture_output=True, text=True, check=True).stdout.strip()


def entries(tmp_path):
    return sorted(p.name for p in (tmp_path / "opt").iterdir() if not p.name.startswith("."))


def test_versions_stand_beside_each_other_and_change_places(tmp_path, wheels):
    code, said = call(tmp_path, "--wheelhouse", wheels)
    assert code == 0, said
    assert in_use(tmp_path) == "stand-in 1.9"
    make_wheel(wheels, "1.10")
    code, said = call(tmp_path, "--wheelhouse", wheels)
    assert (code, in_use(tmp_path)) == (0, "stand-in 1.10"), said
    both = ["1.10", "1.9", "current", "install.sh", "previous"]
    assert entries(tmp_path) == both
    installed = tmp_path / "opt" / "install.sh"
    for expected in ("stand-in 1.9", "stand-in 1.10"):
        code, said = call(tmp_path, "--rollback", script=installed)
        assert (code, in_use(tmp_path)) == (0, expected), said

    broken = make_wheel(wheels, "2.0", "raise SystemExit('broken')")
    code, said = call(tmp_path, "--wheelhouse", wheels)
    assert code == 1
    assert "2.0 does not start; nothing was changed" in said
    assert in_use(tmp_path) == "stand-in 1.10"
    assert entries(tmp_path) == both
    broken.unlink()

    (tmp_path / "opt" / "somebody's").mkdir()
    assert call(tmp_path, "--wheelhouse", wheels)[0] == 0  # the same version goes beside itself, the third goes
    assert entries(tmp_path) == ["1.10", "1.10-2", "current", "install.sh", "previous", "somebody's"]
    assert [os.readlink(tmp_path / "opt" / name) for name in ("current", "previous")] == ["1.10-2", "1.10"]
    code, said = call(tmp_path, "--uninstall", script=installed)
    assert code == 1
    assert "something in it that is not ours" in said
    assert entries(tmp_path) == ["somebody's"]
    assert not (tmp_path / "bin" / "spheremouse").is_symlink()


def test_what_cannot_be_done_is_said_and_leaves_nothing(tmp_path, wheels):
    (wheels / "BUILT-FOR").write_text("Python 2.7, pdp11\n")
    empty = tmp_path / "empty"
    empty.mkdir()
    for arguments, words in (
        (("--wheelhouse", wheels), "was built for Python 2.7, pdp11, this is Python"),
        (("--wheelhouse", empty), "no wheel of spheremouse in it"),
        (("--rollback",), "there is no version before"),
    ):
        code, said = call(tmp_path, *arguments)
        assert code == 1
        assert words in said
        assert entries(tmp_path) == []
