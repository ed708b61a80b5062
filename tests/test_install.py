"""service/install.sh with versions of a stand-in: beside each other, switched and back, gone; and what it does as root.

The stand-in is a wheel made here, or a checkout with a build backend of its own; pip is the one that Python brings, and
the index of packages is a folder. No network; as root there is more to see.
"""

import ensurepip
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tarfile
import tempfile
import textwrap
import zipfile
from pathlib import Path

import pytest

from spheremouse.files.access import service_files

SCRIPT = service_files() / "install.sh"
KIND = f"Python {sys.version_info[0]}.{sys.version_info[1]}, {platform.machine()}\n"
ROOT = os.geteuid() == 0
BUILD_PACKAGES = (
    "scikit_build_core", "hatch_fancy_pypi_readme", "nanobind", "cmeel_eigen", "cmake", "ninja", "setuptools",
)  # fmt: skip
pytestmark = pytest.mark.skipif(sys.platform != "linux" or shutil.which("flock") is None, reason="needs Linux, flock")


def make_wheel(folder, version, code="print('stand-in {}'); ", name="spheremouse", modules=("cv2", "scipy")):
    """A wheel of that version, with what the installer asks for."""
    info = f"{name}-{version}.dist-info"
    files = {
        f"{name}.py": f"def main():\n    {code.format(version)}\n",
        **{f"{module}.py": "" for module in modules},
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": f"[console_scripts]\n{name} = {name}:main\n",
    }
    if name == "spheremouse":
        files[f"{name}-{version}.data/data/share/man/man1/spheremouse.1"] = f"stand-in {version}"
    files[f"{info}/RECORD"] = "".join(f"{name},,\n" for name in [*files, f"{info}/RECORD"])
    path = folder / f"{name}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        for inner, text in files.items():
            wheel.writestr(inner, text)
    return path


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def seal(folder, *wheels):
    wheels = [*wheels, *folder.glob("pip-*.whl")]
    (folder / "SHA256SUMS").write_text("".join(f"{digest(path)}  {path.name}\n" for path in wheels))
    (folder / "BUILT-FOR").write_text(KIND)


def bundled():
    places = (Path(ensurepip.__file__).parent / "_bundled", Path("/usr/share/python-wheels"))
    found = [wheel for place in places for wheel in place.glob("pip-*.whl")]
    if not found:
        pytest.skip("this Python brings no wheel of pip")
    return found[0]


@pytest.fixture
def wheels(tmp_path):
    folder = tmp_path / "wheels"
    folder.mkdir()
    shutil.copy(bundled(), folder)
    seal(folder, make_wheel(folder, "1.9"))
    return folder


def call(tmp_path, *arguments, script=SCRIPT, umask=0o022, cwd=None, **more):
    """Exit code and what was said; the prefix has a space in no test, since systemd would not have it."""
    command = ["bash", script, "--no-service", "--prefix", tmp_path / "opt", "--bin", tmp_path / "bin", *arguments]
    environment = {"PATH": os.environ["PATH"], "HOME": str(tmp_path), "PYTHON": sys.executable, **more}
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, timeout=300, check=False, umask=umask, cwd=cwd
    )
    return done.returncode, done.stdout + done.stderr


def in_use(tmp_path):
    return subprocess.run(
        [tmp_path / "bin" / "spheremouse"], capture_output=True, text=True, check=True, env={}
    ).stdout.strip()


def entries(tmp_path):
    return sorted(p.name for p in (tmp_path / "opt").iterdir() if not p.name.startswith("."))


@pytest.mark.slow
def test_versions_stand_beside_each_other_and_change_places(tmp_path, wheels):
    code, said = call(tmp_path, "--wheelhouse", wheels)
    assert code == 0, said
    assert in_use(tmp_path) == "stand-in 1.9"
    seal(wheels, make_wheel(wheels, "1.10"))
    code, said = call(tmp_path, "--wheelhouse", wheels)
    assert (code, in_use(tmp_path)) == (0, "stand-in 1.10"), said
    both = ["1.10", "1.9", "current", "install.sh", "previous"]
    assert entries(tmp_path) == both
    installed = tmp_path / "opt" / "install.sh"
    for expected in ("stand-in 1.9", "stand-in 1.10"):
        code, said = call(tmp_path, "--rollback", script=installed)
        assert (code, in_use(tmp_path)) == (0, expected), said
        assert (tmp_path / "share/man/man1/spheremouse.1").read_text() == expected

    seal(wheels, make_wheel(wheels, "2.0", "raise SystemExit('broken')"))
    code, said = call(tmp_path, "--wheelhouse", wheels)
    assert code == 1
    assert "2.0 does not start; nothing was changed" in said
    assert in_use(tmp_path) == "stand-in 1.10"
    assert entries(tmp_path) == both
    seal(wheels, wheels / "spheremouse-1.10-py3-none-any.whl")

    (tmp_path / "opt" / "somebody's").mkdir()
    assert call(tmp_path, "--wheelhouse", wheels)[0] == 0  # the same version goes beside itself, the third goes
    assert entries(tmp_path) == ["1.10", "1.10-2", "current", "install.sh", "previous", "somebody's"]
    assert [os.readlink(tmp_path / "opt" / name) for name in ("current", "previous")] == ["1.10-2", "1.10"]
    code, said = call(tmp_path, "--uninstall", script=installed)
    assert code == 1
    assert "something in it that is not ours" in said
    assert entries(tmp_path) == ["somebody's"]
    assert not (tmp_path / "bin" / "spheremouse").is_symlink()
    assert not (tmp_path / "share/man/man1/spheremouse.1").is_symlink()


def test_what_cannot_be_done_is_said_and_leaves_nothing(tmp_path, wheels):
    (wheels / "BUILT-FOR").write_text("Python 2.7, pdp11\n")
    empty, bare = tmp_path / "empty", tmp_path / "bare"
    empty.mkdir()
    bare.mkdir()
    shutil.copy(bundled(), bare)
    seal(bare)
    for arguments, words in (
        (("--wheelhouse", wheels), "was built for Python 2.7, pdp11, this is Python"),
        (("--wheelhouse", empty), "no BUILT-FOR and SHA256SUMS in it"),
        (("--wheelhouse", bare), "no wheel of spheremouse in it"),
        (("--rollback",), "there is no version before"),
    ):
        code, said = call(tmp_path, *arguments)
        assert code == 1
        assert words in said
        assert entries(tmp_path) == []


def other_bytes(wheels):
    with (wheels / "spheremouse-1.9-py3-none-any.whl").open("ab") as f:
        f.write(b"more")


def other_hash(wheels):
    sums = wheels / "SHA256SUMS"
    sums.write_text(sums.read_text().translate(str.maketrans("0123", "1230")))


def gone(wheels):
    (wheels / "spheremouse-1.9-py3-none-any.whl").unlink()


def elsewhere(wheels):
    sums = wheels / "SHA256SUMS"
    (wheels.parent / "spheremouse-1.9-py3-none-any.whl").write_bytes(next(wheels.glob("spheremouse-*")).read_bytes())
    sums.write_text(sums.read_text().replace("spheremouse-", "../spheremouse-"))


@pytest.mark.parametrize("change", [other_bytes, other_hash, gone, elsewhere])
def test_a_folder_of_wheels_that_was_changed_on_the_way_is_refused_in_one_line(tmp_path, wheels, change):
    change(wheels)
    code, said = call(tmp_path, "--wheelhouse", wheels)
    assert code == 1
    assert said.count("\n") == 1
    assert "is not the file that SHA256SUMS names" in said or "a line names no wheel" in said
    assert entries(tmp_path) == []


BACKEND = """
    import json, os, zipfile
    NAME, NEEDS = {name!r}, {needs!r}
    def build_wheel(folder, settings=None, metadata=None):
        above = [os.getcwd()]
        while os.path.dirname(above[-1]) != above[-1]:
            above.append(os.path.dirname(above[-1]))
        by = dict(uid=os.getuid(), private=any(os.stat(path).st_mode & 0o077 == 0 for path in above))
        info = NAME + "-1.0.dist-info"
        files = {{
            "built_" + NAME + ".py": "BY = " + repr(by),
            info + "/METADATA": "Metadata-Version: 2.1\\nName: " + NAME + "\\nVersion: 1.0\\n" + NEEDS,
            info + "/WHEEL": "Wheel-Version: 1.0\\nGenerator: t\\nRoot-Is-Purelib: true\\nTag: py3-none-any\\n",
        }}
        if NAME == "spheremouse":
            files |= {{"cv2.py": "", "scipy.py": ""}}
            files[info + "/entry_points.txt"] = "[console_scripts]\\nspheremouse = built_spheremouse:main\\n"
            files["built_spheremouse.py"] += (
                "\\ndef main():\\n    import built_evdev, json\\n    print(json.dumps([BY, built_evdev.BY]))\\n"
            )
        files[info + "/RECORD"] = "".join(name + ",,\\n" for name in [*files, info + "/RECORD"])
        name = NAME + "-1.0-py3-none-any.whl"
        with zipfile.ZipFile(os.path.join(folder, name), "w") as wheel:
            for path, text in files.items():
                wheel.writestr(path, text)
        return name
"""


def project(folder, where, name, needs=""):
    (folder / where).mkdir(parents=True)
    (folder / where / "backend.py").write_text(textwrap.dedent(BACKEND.format(name=name, needs=needs)))
    (folder / "pyproject.toml").write_text(
        f'[build-system]\nrequires = []\nbuild-backend = "backend"\nbackend-path = ["{where}"]\n'
        f'[project]\nname = "{name}"\nversion = "1.0"\n'
    )


@pytest.fixture
def shared():
    """A folder that others than root may enter; pytest's may not be."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.fixture
def release(shared):
    """A checkout that builds itself, beside an index with what its locks name."""
    checkout, index, source = shared / "checkout", shared / "index", shared / "evdev-1.0"
    project(checkout, "service", "spheremouse", needs="Requires-Dist: evdev>=1\n")
    project(source, ".".join("ab"), "evdev")
    index.mkdir()
    (source / "PKG-INFO").write_text("Metadata-Version: 2.1\nName: evdev\nVersion: 1.0\n")
    with tarfile.open(index / "evdev-1.0.tar.gz", "w:gz") as archive:
        archive.add(source, source.name)
    for name in ("CMakeLists.txt", "README.md", "LICENSE", "docs/sample.schema.json", "calibration/device.yaml"):
        (checkout / name).parent.mkdir(exist_ok=True)
        (checkout / name).write_text("")
    (checkout / "spheremouse").mkdir()
    shutil.copy(SCRIPT, checkout / "service")
    shutil.copy(bundled(), index)
    made = [make_wheel(index, "99", name=name, modules=()) for name in BUILD_PACKAGES]
    pip = next(index.glob("pip-*.whl"))
    lines = [(*path.name.split("-")[:2], path) for path in (*made, pip)]
    for lock, named in (("requirements", lines), ("sources", [("evdev", "1.0", index / "evdev-1.0.tar.gz")])):
        text = "".join(f"{name}=={version} --hash=sha256:{digest(path)}\n" for name, version, path in named)
        (checkout / "service" / f"{lock}.lock").write_text(text)
    return checkout


def others_python():
    """A Python that others than root may run, with all that the installer would else fetch with apt-get."""
    for python in (sys.executable, "/usr/bin/python3"):
        header = 'import ensurepip, os, sys, sysconfig, venv; os.stat(sysconfig.get_path("include") + "/Python.h")'
        drop = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "env"] if ROOT else []
        command = [*drop, python, "-c", f"{header}; assert sys.version_info >= (3, 11)"]
        if subprocess.run(command, capture_output=True, check=False, cwd="/").returncode == 0:
            break
    else:
        pytest.skip("no Python 3.11 with venv and headers that others than root may run")
    if shutil.which("cc") is None or not Path("/usr/include/linux/uinput.h").exists():
        pytest.skip("no compiler, or no headers of the kernel")
    return python


def install(tmp_path, release, *arguments, **more):
    index = {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(release.parent / "index")}
    script = release / "service" / "install.sh"
    return call(tmp_path, *arguments, script=script, PYTHON=others_python(), **index, **more)


@pytest.mark.slow
@pytest.mark.parametrize("lock", ["requirements.lock", "sources.lock"])
def test_what_the_lock_does_not_name_is_refused_in_one_line(tmp_path, release, lock):
    path = release / "service" / lock
    name, _, sums = path.read_text().partition("sha256:")
    path.write_text(f"{name}sha256:{'0' * 8}{sums[8:]}")
    code, said = install(tmp_path, release)
    assert code == 1
    told = [line for line in said.splitlines() if ": fetching " not in line and ": building " not in line]
    assert len(told) == 1, said
    assert f"service/{lock} could not be " in told[0]
    assert "HASHES" in told[0]
    assert entries(tmp_path) == []


def test_a_release_without_a_lock_is_refused(tmp_path, release):
    (release / "service" / "sources.lock").unlink()
    code, said = install(tmp_path, release)
    assert (code, said.count("\n")) == (1, 1)
    assert "has no sources.lock" in said


@pytest.mark.slow
def test_a_folder_of_wheels_holds_what_is_locked_and_what_was_built_in_a_private_folder(tmp_path, shared, release):
    """Installed without network, with umask 077, a newer evdev beside the listed one, and modules of Python's names."""
    carried, here = shared / "user" / "wheels", tmp_path / "here"
    code, said = install(tmp_path, release, "--build-wheelhouse", carried)
    assert code == 0, said
    listed = (carried / "SHA256SUMS").read_text().split()[1::2]
    assert {name.split("-")[0] for name in listed} == {
        "evdev", "pip", "spheremouse", *BUILD_PACKAGES,
    }  # fmt: skip

    here.mkdir()
    for name in ("cv2", "scipy", "zipfile", "venv", "compileall", "random"):
        (here / f"{name}.py").write_text(f"open({str(tmp_path / 'planted')!r}, 'w').write(__name__)\n")
    make_wheel(shared / "index", "9.0", name="evdev", modules=())  # where a setting of pip's leads
    make_wheel(carried, "9.0", name="evdev", modules=())  # or put beside
    settings = {"PIP_FIND_LINKS": str(shared / "index"), "PYTHON": others_python()}
    code, said = call(tmp_path, script=carried / "install.sh", umask=0o077, cwd=here, **settings)
    assert code == 0, said
    assert digest(carried / "SHA256SUMS") in said
    assert not (tmp_path / "planted").exists()
    placed = [path for path in (tmp_path / "opt").rglob("*") if not path.is_symlink() and not path.name.startswith(".")]
    assert all(
        path.stat().st_mode & 0o005 == (0o005 if path.is_dir() else path.stat().st_mode & 1 | 4) for path in placed
    )
    for by in json.loads(in_use(tmp_path)):
        assert by == {"uid": os.getuid(), "private": True}


as_root = pytest.mark.skipif(not ROOT, reason="only root can be misled")


@as_root
@pytest.mark.parametrize(
    ("option", "mode", "owner"),
    [("--prefix", 0o755, 65534), ("--prefix", 0o777, 0), ("--bin", 0o775, 0), ("--bin", 0o1777, 0)],
)
def test_root_installs_nothing_where_another_may_change_it(tmp_path, wheels, option, mode, owner):
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    os.chown(theirs, owner, 65534)
    theirs.chmod(mode)
    (tmp_path / "link").symlink_to(theirs)
    for path in (theirs, tmp_path / "link", *([theirs / "below"] if not mode & 0o1000 else [])):
        code, said = call(tmp_path, "--wheelhouse", wheels, option, path)
        assert (code, said.count("\n")) == (1, 1), said
        assert "others than root may change" in said
    assert list(theirs.iterdir()) == []


@pytest.mark.slow
@as_root
@pytest.mark.parametrize("way", ["owner", "all", "file", "link"])
@pytest.mark.parametrize("what", ["--from", "--wheelhouse", "--build-wheelhouse"])
def test_root_takes_nothing_from_where_another_may_change_it(tmp_path, release, wheels, what, way):
    """Nor does it print a line of a file that a link there leads to. The user who has called sudo is no other user."""
    place = {"--from": release, "--wheelhouse": wheels}.get(what, tmp_path / "built")
    place.mkdir(exist_ok=True)
    place.chmod(0o755)
    secret = tmp_path / "secret"
    secret.write_text("root:hash\n")
    changed = next((path for path in place.rglob("*") if path.is_file()), None)
    if way == "owner":
        os.chown(place, 65534, 65534)
    elif way == "all":
        place.chmod(0o777)
    elif way == "file" and changed is not None:
        changed.chmod(0o666)
    else:
        (tmp_path / "link").symlink_to(place)
        place = tmp_path / "link"
        os.chown(place, 65534, 65534, follow_symlinks=False)
    if what == "--wheelhouse" and way != "file":
        (wheels / "SHA256SUMS").unlink()
        (wheels / "SHA256SUMS").symlink_to(secret)
    before = sorted(tmp_path.rglob("*"))
    code, said = install(tmp_path, release, what, place)
    assert (code, said.count("\n")) == (1, 1), said
    assert "others than root may change" in said
    assert "hash" not in said
    assert [path for path in sorted(tmp_path.rglob("*")) if path not in before and not path.name.startswith(".")] == [
        path for path in (tmp_path / "bin", tmp_path / "opt") if path.exists()
    ]
    if way == "owner" and what == "--from":
        for path in (release, *release.rglob("*")):
            os.chown(path, 65534, 65534)
        code, said = install(tmp_path, release, what, place, SUDO_UID="65534", SUDO_GID="65534")
        assert code == 0, said
