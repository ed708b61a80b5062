"""The files that make spheremouse a service of systemd: which there are, where they go, and what became of them there.

What is placed begins with a line that holds the digest of the rest, so that a file edited by hand is known without any
list kept elsewhere: it is never replaced or removed without a copy. All is first worked out as actions, then done.
"""

import contextlib
import hashlib
import os
import re
import shutil
import sys
import sysconfig
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from spheremouse.errors import ConfigurationError, ServiceError, printable
from spheremouse.files.atomic import replace
from spheremouse.files.safe_open import open_to_read, others_may_change
from spheremouse.files.service import service_files

UNIT = "spheremouse.service"
USER = "spheremouse"  # and its group
RESTART_STEPS = 254  # the first systemd that can wait longer from try to try
_MARK = "# Placed by `spheremouse service install`; do not edit (digest of what follows: {})\n"
_MARKED = re.compile(re.escape(_MARK.strip()).replace(r"\{\}", "([0-9a-f]{16})"))
_UNREACHABLE = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")  # the unit's ProtectHome and PrivateTmp

# folders that a system or an account may have had no use for before
_MADE = (
    "spheremouse", "xorg.conf.d", "X11", "sysusers.d", "autostart", "default.target.wants", "user", "systemd",
)  # fmt: skip

State = Literal["missing", "ok", "older", "edited"]


@dataclass(frozen=True, slots=True)
class Place:
    """Places of a service: of the system or of the user who asks, all of it below `root`."""

    root: Path = Path("/")
    user: bool = False

    @property
    def configuration(self) -> Path:
        """Folder of config.yaml and rig.yaml."""
        return self._users("XDG_CONFIG_HOME", ".config") / "spheremouse" if self.user else self.at("/etc/spheremouse")

    @property
    def unit(self) -> Path:
        return self.files()[0][1]

    @property
    def link(self) -> Path:
        """The symbolic link with which systemd starts the unit by itself."""
        target = "default.target.wants" if self.user else "multi-user.target.wants"
        return self.unit.parent / target / UNIT

    @property
    def changes(self) -> Path:
        """Folder of what `systemctl edit` puts beside the unit."""
        return self.unit.with_name(f"{UNIT}.d")

    @property
    def state(self) -> Path:
        """Folder of map and recordings; a user's map is beside the rig."""
        users = self._users("XDG_STATE_HOME", ".local/state") / "spheremouse"
        return users if self.user else self.at("/var/lib/spheremouse")

    @property
    def cache(self) -> Path:
        """Folder of compiled code."""
        users = self._users("XDG_CACHE_HOME", ".cache") / "spheremouse"
        return users if self.user else self.at("/var/cache/spheremouse")

    def files(self) -> list[tuple[str, Path]]:
        """Files to place: name in the folder of this program's service files, and path; the unit first."""
        if self.user:
            configuration = self._users("XDG_CONFIG_HOME", ".config")
            return [
                ("systemd/spheremouse-user.service", configuration / "systemd" / "user" / UNIT),
                ("desktop/spheremouse-tray.desktop", configuration / "autostart" / "spheremouse-tray.desktop"),
            ]
        places = {
            "systemd/spheremouse.service": f"/etc/systemd/system/{UNIT}",
            "systemd/sysusers.conf": "/etc/sysusers.d/spheremouse.conf",
            "systemd/tmpfiles.conf": "/etc/tmpfiles.d/spheremouse.conf",
            "systemd/modules-load.conf": "/etc/modules-load.d/spheremouse.conf",
            "udev/70-spheremouse.rules": "/etc/udev/rules.d/70-spheremouse.rules",
            "desktop/90-spheremouse-xorg.conf": "/etc/X11/xorg.conf.d/90-spheremouse.conf",
            "desktop/spheremouse-tray.desktop": "/etc/xdg/autostart/spheremouse-tray.desktop",
        }
        return [(name, self.at(path)) for name, path in places.items()]

    def at(self, path: str | Path) -> Path:
        """An absolute path, below the root."""
        return self.root / Path(path).relative_to("/")

    def inside(self, path: Path) -> str:
        """A path as it is once `root` is the root."""
        return str(Path("/") / path.relative_to(self.root))

    def _users(self, variable: str, otherwise: str) -> Path:
        given = os.environ.get(variable, "")
        return self.at(given if given.startswith("/") else Path.home() / otherwise)


@dataclass(frozen=True, slots=True)
class FileAction:
    """One change, worked out and not done yet."""

    what: str  # "write", "update", ...
    path: Path
    do: Callable[[], object]
    note: str = ""
    must: bool = True  # what follows is not done unless this is

    def __str__(self) -> str:
        return printable(f"{self.what} {self.path}{f' ({self.note})' if self.note else ''}")


def executable(place: Place) -> tuple[str, str]:
    """The program that the unit is to start, and why it cannot be that one, with what to move where; empty: it can.

    It is this installation's, by the link `current` where it has versions.
    """
    prefix = Path(sys.prefix)
    current = prefix.parent / "current"
    if current.is_symlink() and current.resolve() == prefix.resolve():
        prefix = current
    scripts = [prefix / "bin", *(Path(sysconfig.get_path("scripts", scheme)) for scheme in _schemes())]
    path = next((p for folder in scripts if (p := folder / "spheremouse").exists()), prefix / "bin" / "spheremouse")
    if not path.exists():
        return str(path), f"{path} is not there; install spheremouse into a virtual environment: service/install.sh"
    if place.root != Path("/") and path.is_relative_to(place.root):
        path = Path(place.inside(path))
    if re.search(r"[^\w./+~@:=-]", str(path)):
        return str(path), f"{path}: systemd needs a path without spaces and other signs; install elsewhere, as in /opt"
    return str(path), "" if place.user or place.root != Path("/") else _unseen(path)


def _schemes() -> Iterator[str]:
    """Where pip puts programs outside of a virtual environment: for all, and for one account."""
    if sys.prefix == sys.base_prefix:
        yield sysconfig.get_default_scheme()
        yield sysconfig.get_preferred_scheme("user")


def _is_private(path: Path) -> bool:
    """Is a folder above it closed to other users?"""
    with contextlib.suppress(OSError):
        return any(not folder.stat().st_mode & 0o001 for folder in path.resolve().parents)
    return False


def _unseen(path: Path) -> str:
    """Why the service's user does not see a program or its Python; homes and temporary folders are hidden from it."""
    hidden = tuple(f"{p}/" for p in _UNREACHABLE)
    python = Path(sys.executable).resolve()
    own = "or make it your own service: spheremouse service install --user"
    if str(path).startswith(hidden) or str(path.resolve()).startswith(hidden) or _is_private(path):
        how = "sudo bash service/install.sh, in the release's folder, which puts it into /opt/spheremouse"
        if "pipx" in path.resolve().parts:
            how = "sudo PIPX_HOME=/opt/pipx PIPX_BIN_DIR=/usr/local/bin pipx install, and the file or name as before"
        return f"the system's service has a user of its own, who does not see {path}; install it for all: {how}; {own}"
    if str(python).startswith(hidden):
        return (
            f"the system's service has a user of its own, who does not see the Python of {path.parent}, {python}; make "
            f"that environment with the system's: /usr/bin/python3 -m venv; {own}"
        )
    return ""


def refuse_unsafe(place: Place) -> None:
    """Raise ServiceError if a link leads out of the root, or if this is root and others may change a folder."""
    folders = [place.root, place.link.parent, place.changes.parent, place.configuration, place.state.parent]
    folders += [place.cache.parent, *(path.parent for _, path in place.files())]
    there = (next(p for p in (folder, *folder.parents) if os.path.lexists(p)) for folder in folders)
    for folder in dict.fromkeys(there):
        try:
            if not folder.resolve().is_relative_to(place.root):
                raise ServiceError(f"{folder}: leads out of {place.root}; make it a folder there")
            if others_may_change(folder):
                raise ServiceError(
                    f"{folder}: others than root may change what is in it; make it root's alone, or do it as its owner"
                )
        except OSError as e:
            raise ServiceError(f"{folder}: cannot be examined: {e.strerror or e}") from None


# ---- what is to be done ----


def install(place: Place, program: str, systemd: int | None) -> Iterator[FileAction]:
    """Actions left until the service is in place; none where it is. `systemd`: its version, where known."""
    fresh = not place.unit.exists()
    for name, path in place.files():
        text = rendered(name, program, systemd)
        state = state_of(path, text)
        if state == "edited":
            yield _backup(path)
        if state != "ok":
            what = "write" if state == "missing" else "update"
            yield FileAction(what, path, partial(_write, path, text))
    if fresh and not place.link.is_symlink():  # one that was there and is not enabled stays so
        yield FileAction("enable", place.link, partial(_link, place))
    config = place.configuration / "config.yaml"
    if not config.exists():
        yield FileAction("write", config, partial(_write, config, configuration(place)))


def uninstall(place: Place, purge: bool) -> Iterator[FileAction]:
    """Actions left until the service is gone. Configuration, calibration and map stay unless `purge`."""
    if place.link.is_symlink():
        yield FileAction("disable", place.link, place.link.unlink)
    for _, path in place.files():
        if path.exists() or path.is_symlink():
            if state_of(path, None) == "edited" and not purge:
                yield _backup(path)
            yield FileAction("remove", path, path.unlink)
        for backup in sorted(path.parent.glob(f"{path.name}.bak*")) if purge else ():
            yield FileAction("remove", backup, backup.unlink)
    if place.cache.exists():
        yield FileAction("remove", place.cache, partial(_remove, place.cache), "compiled code", must=False)
    config = place.configuration / "config.yaml"
    if not purge and config.exists() and config.read_text(encoding="utf-8") == configuration(place):
        yield FileAction("remove", config, config.unlink, "as it was placed")
    for path in (place.configuration, place.state, place.changes) if purge else ():
        if path.exists():
            yield FileAction("remove", path, partial(_remove, path), must=False)


def left(place: Place) -> list[Path]:
    """Paths that an uninstallation leaves, since somebody may want them."""
    found = [p for folder in (place.configuration, place.state, place.changes) for p in _below(folder)]
    return sorted([*found, *(p for _, path in place.files() for p in path.parent.glob(f"{path.name}.bak*"))])


def tidy(place: Place) -> None:
    """Remove folders of ours that are empty; below a root of one's own all that are."""
    folders = (place.configuration, place.state, place.cache, place.link.parent, *(p.parent for _, p in place.files()))
    for folder in folders:
        for path in (p for p in (folder, *folder.parents) if p.is_relative_to(place.root) and p != place.root):
            if place.root == Path("/") and path.name not in _MADE:
                break
            with contextlib.suppress(OSError):  # not empty, or gone
                path.rmdir()


def state_of(path: Path, text: str | None) -> State:
    """State of a file that was to hold `text`; None: whatever some version of ours placed."""
    if not path.exists():
        return "missing"
    try:
        there = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return "edited"
    if there == text:
        return "ok"
    first, _, rest = there.partition("\n")
    mark = _MARKED.fullmatch(first)
    return "edited" if mark is None or mark[1] != _digest(rest) else "ok" if text is None else "older"


def rendered(name: str, program: str, systemd: int | None) -> str:
    """A file of the service as it is placed: with the program's path, without what this systemd does not know."""
    text = (service_files() / name).read_text(encoding="utf-8").replace("@EXECUTABLE@", program)
    known = systemd is not None and systemd >= RESTART_STEPS
    text = re.sub(r"^@254@(.*\n)", r"\1" if known else "", text, flags=re.M)
    return _MARK.format(_digest(text)) + text


def configuration(place: Place) -> str:
    """The configuration to begin with."""
    own = place.configuration
    learnt = own if place.user else place.state
    text = (service_files() / "config.yaml").read_text(encoding="utf-8")
    for name, path in (("@RIG@", own / "rig.yaml"), ("@MAP@", learnt / "rig.map.yaml")):
        text = text.replace(name, place.inside(path))
    return text


def carry_out(actions: Iterator[FileAction] | list[FileAction], umask: int = 0o022) -> Iterator[str]:
    """Do them one by one, in words; ServiceError where the system does not let us.

    The umask is ours and not the account's: with 077, what is placed would be closed to those who are to read it.
    """
    for action in list(actions):
        try:
            with _umask(umask):
                action.do()
        except (OSError, RecursionError, ConfigurationError, ServiceError) as e:
            why = f"{action}: {printable(e.strerror if isinstance(e, OSError) and e.strerror else e)}"
            if action.must:
                raise ServiceError(why) from None
            yield f"did not work: {why}"
        else:
            yield str(action)


def may(place: Place) -> bool:
    """May this account write where the files go?"""
    for _, path in place.files():
        there = path.parent
        while not there.exists():
            there = there.parent
        if not os.access(there, os.W_OK | os.X_OK):
            return False
    return True


# ---- within ----


@contextlib.contextmanager
def _umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    replace(path, text.encode("utf-8"), 0o644)  # whatever the account's umask: systemd, udev and desktops read them


def _link(place: Place) -> None:
    place.link.parent.mkdir(parents=True, exist_ok=True)
    place.link.symlink_to(place.inside(place.unit))


def _backup(path: Path) -> FileAction:
    names = (path.with_name(f"{path.name}.bak{n or ''}") for n in range(1000))
    free = next(p for p in names if not os.path.lexists(p))
    return FileAction("keep", free, partial(_copy, path, free), f"{path.name} as it was edited")


def _copy(path: Path, free: Path) -> None:
    if path.is_symlink():  # to /dev/null, for instance: masked
        free.symlink_to(os.readlink(path))
        return
    with open_to_read(path) as file:
        replace(free, file.read(), os.fstat(file.fileno()).st_mode & 0o777)


def _remove(path: Path) -> None:
    """Remove a folder with its content, or a link to one; what links lead to stays."""
    if path.is_symlink():
        path.unlink()
    else:
        shutil.rmtree(path)


def _below(folder: Path) -> list[Path]:
    try:
        return [p for p in folder.rglob("*") if not p.is_dir()]
    except (OSError, RecursionError):  # it is there, and no more can be said
        return [folder]
