"""pyproject.toml's ranges against the lock files: what is needed is locked, once, with hashes, and no place is named.

`make lock` is what mends them.
"""

import importlib.metadata
import re
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = PROJECT["project"]["optional-dependencies"]
CABINET = re.search(r"^CABINET := (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M).group(1).split()
RUN = [*PROJECT["project"]["dependencies"], *(w for extra in CABINET for w in EXTRAS[extra])]
OPTIONAL = [w for extra, words in EXTRAS.items() if extra not in CABINET for w in words]
BUILD = [*PROJECT["dependency-groups"]["release"], *PROJECT["build-system"]["requires"]]
WORK = [*PROJECT["dependency-groups"]["dev"], *PROJECT["dependency-groups"]["docs"]]
INSTALLED = ("service/requirements.lock", "service/sources.lock")
EVERYTHING = ("tests/requirements.lock",)
MACHINES = [
    {"python_version": python, "python_full_version": f"{python}.1", "platform_machine": machine}
    for python in ("3.11", "3.12", "3.13", "3.14")
    for machine in ("x86_64", "aarch64")
]


def locked(name):
    """Requirement and number of hashes of each package in a lock file."""
    text = re.sub(r"^#.*\n", "", (ROOT / name).read_text(encoding="utf-8"), flags=re.M)
    for entry in text.replace("\\\n", " ").splitlines():
        words, *sums = entry.split(" --hash=")
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64} *", one) for one in sums), entry
        yield Requirement(words), len(sums)


def pins(names, machine):
    where = {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix", **machine}
    found = {}
    for requirement, _ in (one for name in names for one in locked(name)):
        if requirement.marker is None or requirement.marker.evaluate(where):
            name = canonicalize_name(requirement.name)
            assert name not in found, f"{name} is locked twice"
            (pin,) = requirement.specifier
            assert pin.operator == "=="
            found[name] = pin.version
    return found


@pytest.mark.parametrize("machine", MACHINES, ids=lambda m: f"{m['python_version']}-{m['platform_machine']}")
@pytest.mark.parametrize(("names", "ranges"), [(INSTALLED, RUN + BUILD), (EVERYTHING, RUN + BUILD + WORK + OPTIONAL)])
def test_each_range_is_locked_within_it(names, ranges, machine):
    found = pins(names, machine)
    for words in ranges:
        wanted = Requirement(words)
        name = canonicalize_name(wanted.name)
        assert name in found, f"{words} is not locked: make lock"
        assert wanted.specifier.contains(found[name]), f"{words}, but locked is {found[name]}: make lock"


def test_what_the_packages_need_is_locked_too():
    """By what those say that are installed here, in whatever version."""
    found = pins(INSTALLED, {})
    waiting, seen = [Requirement(words) for words in RUN + BUILD], set()
    while waiting:
        one = waiting.pop()
        name = canonicalize_name(one.name)
        if name in seen or (one.marker is not None and not one.marker.evaluate({"extra": ""})):
            continue
        seen.add(name)
        assert name in found, f"{name} is not locked: make lock"
        try:
            there = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:
            continue
        if there.version == found[name]:
            waiting += [Requirement(words) for words in there.requires or ()]


def test_what_is_tested_is_what_is_installed():
    assert pins(INSTALLED, {}).items() <= pins(EVERYTHING, {}).items()


@pytest.mark.parametrize("name", [*INSTALLED, *EVERYTHING])
def test_a_lock_has_hashes_and_names_no_place(name):
    assert all(hashes for _, hashes in locked(name))
    assert "://" not in (ROOT / name).read_text(encoding="utf-8")
    assert not re.search(r"^ *-(?!-hash)|@", (ROOT / name).read_text(encoding="utf-8"), re.M)


@pytest.mark.skipif(sys.prefix != str(ROOT / ".venv"), reason="another environment than make's")
def test_this_environment_is_the_locked_one():
    found = pins(EVERYTHING, {})
    there = {canonicalize_name(d.name): d.version for d in importlib.metadata.distributions()}
    assert {name: there.get(name) for name in found} == found
