"""Plan the changes of files that make spheremouse a service of systemd, and carry them out."""

import contextlib
import os
import re
import shutil
import sys
import sysconfig
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from ipaddress import ip_network
from pathlib import Path

from spheremouse.errors import ConfigurationError, ServiceError, os_errors_as, printable
from spheremouse.files.access import service_files
from spheremouse.files.safe_files import others_may_change, replace

UNIT = "spheremouse.service"
VIEW_UNIT = "spheremouse-view.service"  # the live page
USER = "spheremouse"  # and its group
_MARK = "# Placed by `spheremouse service install`, which replaces it.\n"
_NETWORKS = ("multicast", "link-local", "localhost")  # names of IPAddressAllow, systemd.resource-control(5)
_UNREACHABLE = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")  # the unit's ProtectHome and PrivateTmp


class Place:
    """Paths of the system's service, or of the user's own one, all below `root`."""

    def __init__(self, root: Path = Path("/"), user: bool = False) -> None:
        self.root, self.user = root, user
        if user:
            configuration = self._users("XDG_CONFIG_HOME", ".config")
            placed = {
                "systemd/spheremouse-user.service": configuration / "systemd" / "user" / UNIT,
                "systemd/spheremouse-view-user.service": configuration / "systemd" / "user" / VIEW_UNIT,
                "desktop/spheremouse-tray.desktop": configuration / "autostart" / "spheremouse-tray.desktop",
            }
        else:
            configuration = self.at("/etc")
            placed = {
                "systemd/spheremouse.service": configuration / "systemd" / "system" / UNIT,
                "systemd/spheremouse-view.service": configuration / "systemd" / "system" / VIEW_UNIT,
                "systemd/sysusers.conf": configuration / "sysusers.d" / "spheremouse.conf",
                "systemd/tmpfiles.conf": configuration / "tmpfiles.d" / "spheremouse.conf",
                "systemd/modules-load.conf": configuration / "modules-load.d" / "spheremouse.conf",
                "udev/70-spheremouse.rules": configuration / "udev" / "rules.d" / "70-spheremouse.rules",
                "desktop/90-spheremouse-xorg.conf": configuration / "X11" / "xorg.conf.d" / "90-spheremouse.conf",
                "desktop/spheremouse-tray.desktop": configuration / "xdg" / "autostart" / "spheremouse-tray.desktop",
            }
        self.files = placed  # by their names in the folder `service/`
        self.unit, *_ = placed.values()
        self.units = [self.unit, self.unit.with_name(VIEW_UNIT)]
        self.configuration = configuration / "spheremouse"  # config.yaml and rig.yaml
        state = self._users("XDG_STATE_HOME", ".local/state") if user else self.at("/var/lib")
        self.state = state / "spheremouse"  # map and recordings; a user's map is beside the rig
        self.changes = self.unit.with_name(f"{UNIT}.d")  # those by `systemctl edit`
        self.network = self.changes / "spheremouse-network.conf"  # allows network addresses
        token = [] if user else [state / "spheremouse-view"]  # of the live page
        self.folders = [self.configuration, self.state, *token, self.changes]
        self.link = self.link_of(self.unit)

    def link_of(self, unit: Path) -> Path:
        """Return the symbolic link that makes systemd start a unit."""
        target = "default.target.wants" if self.user else "multi-user.target.wants"
        return unit.parent / target / unit.name

    def at(self, path: str | Path) -> Path:
        """Return an absolute path below the root."""
        return self.root / Path(path).relative_to("/")

    def inside(self, path: Path) -> str:
        """Return a path as seen from within `root`."""
        return str(Path("/") / path.relative_to(self.root))

    def _users(self, variable: str, otherwise: str) -> Path:
        given = os.environ.get(variable, "")
        return self.at(given if given.startswith("/") else Path.home() / otherwise)


@dataclass(frozen=True, slots=True)
class FileAction:
    """One planned change."""

    what: str  # "write", "update", ...
    path: Path
    do: Callable[[], object]
    note: str = ""
    must: bool = True  # if it fails, the later actions are left out

    def __str__(self) -> str:
        return printable(f"{self.what} {self.path}{f' ({self.note})' if self.note else ''}")


def executable(place: Place) -> tuple[str, str]:
    """Return the program that the unit starts, and the reason with remedy if it cannot start it, else "".

    It is the program of this installation, by the link `current` if that has versions.
    """
    prefix = Path(sys.prefix)
    current = prefix.parent / "current"
    if current.is_symlink() and current.resolve() == prefix.resolve():
        prefix = current
    scripts = [prefix / "bin"]
    if sys.prefix == sys.base_prefix:  # pip's schemes outside of a virtual environment, of all users and of one
        schemes = (sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user"))
        scripts += [Path(sysconfig.get_path("scripts", scheme)) for scheme in schemes]
    path = next((p for folder in scripts if (p := folder / "spheremouse").exists()), prefix / "bin" / "spheremouse")
    if not path.exists():
        return str(path), f"{path} does not exist; install spheremouse into a virtual environment: service/install.sh"
    if place.root != Path("/") and path.is_relative_to(place.root):
        path = Path(place.inside(path))
    if re.search(r"[^\w./+~@:=-]", str(path)):
        return str(path), f"{path}: systemd needs a path without spaces and other signs; install elsewhere, as in /opt"
    return str(path), "" if place.user or place.root != Path("/") else _unreadable_reason(path)


def _unreadable_reason(path: Path) -> str:
    """Return why the service's user cannot read the program or its Python, or "". It sees neither homes nor /tmp."""
    hidden = tuple(f"{p}/" for p in _UNREACHABLE)
    python = Path(sys.executable).resolve()
    own = "or make it your own service: spheremouse service install --user"
    closed = any(not folder.stat().st_mode & 0o001 for folder in path.resolve().parents if os.path.exists(folder))
    if closed or str(path).startswith(hidden) or str(path.resolve()).startswith(hidden):
        remedy = "sudo bash service/install.sh, in the release's folder, which puts it into /opt/spheremouse"
        if "pipx" in path.resolve().parts:
            remedy = "sudo PIPX_HOME=/opt/pipx PIPX_BIN_DIR=/usr/local/bin pipx install, and the file or name as before"
        return f"the service's own user cannot read {path}; install it for all: {remedy}; {own}"
    if str(python).startswith(hidden):
        return (
            f"the service's own user cannot read the Python of {path.parent}, {python}; make "
            f"that environment with the system's: /usr/bin/python3 -m venv; {own}"
        )
    return ""


def refuse_unsafe(place: Place) -> None:
    """Raise ServiceError if a link leads out of the root, or if this is root and others may change a folder."""
    folders = [place.root, place.link.parent, place.changes, place.configuration, place.state.parent]
    folders += [path.parent for path in place.files.values()]
    for folder in dict.fromkeys(map(_existing, folders)):
        with os_errors_as(ServiceError, f"{folder}: cannot be examined"):
            if not folder.resolve().is_relative_to(place.root):
                raise ServiceError(f"{folder}: leads out of {place.root}; make it a folder there")
            if others_may_change(folder):
                raise ServiceError(
                    f"{folder}: users other than root can change its contents; let only root write there, "
                    "or run the command as its owner"
                )


def install(place: Place, program: str, allow: Sequence[str] = ()) -> Iterator[FileAction]:
    """Yield the actions that are left until the service is in place. Addresses in `allow` replace earlier ones."""
    fresh = [unit for unit in place.units if not unit.exists()]
    texts = {path: render_file(name, program) for name, path in place.files.items()}
    if allow:
        texts[place.network] = network_text(allow)
    for path, text in texts.items():
        exists = os.path.lexists(path)
        if not exists or differs(path, text):
            yield FileAction("update" if exists else "write", path, partial(_write, path, text))
    for unit in fresh:  # a disabled service stays disabled
        if not place.link_of(unit).is_symlink():
            yield FileAction("enable", place.link_of(unit), partial(_link, place, unit))
    config = place.configuration / "config.yaml"
    if not config.exists():
        yield FileAction("write", config, partial(_write, config, configuration(place)))


def uninstall(place: Place, purge: bool) -> Iterator[FileAction]:
    """Yield the actions that remove the service. Configuration, calibration and map stay unless `purge`."""
    for link in filter(Path.is_symlink, map(place.link_of, place.units)):
        yield FileAction("disable", link, link.unlink)
    for path in (*place.files.values(), place.network):
        if os.path.lexists(path):
            yield FileAction("remove", path, path.unlink)
    config = place.configuration / "config.yaml"
    if not purge and config.exists() and config.read_text(encoding="utf-8") == configuration(place):
        yield FileAction("remove", config, config.unlink, "as it was placed")
    for path in place.folders if purge else ():
        if path.exists():
            yield FileAction("remove", path, partial(_remove, path), must=False)


def left(place: Place) -> list[Path]:
    """Return the paths that an uninstallation without `purge` leaves, and folders that cannot be listed."""
    found = list[Path]()
    for folder in place.folders:
        try:
            found += [p for p in folder.rglob("*") if not p.is_dir()]
        except (OSError, RecursionError):
            found.append(folder)
    return sorted(found)


def tidy(place: Place) -> None:
    """Remove the service's own folders that are empty."""
    for folder in place.folders:
        with contextlib.suppress(OSError):  # not empty, or gone
            folder.rmdir()


def differs(path: Path, text: str) -> bool:
    """Return whether a file has another text, or cannot be read."""
    try:
        return path.read_text(encoding="utf-8") != text
    except (OSError, UnicodeDecodeError):
        return True


def render_file(name: str, program: str) -> str:
    """Return the text of a file to install, with the program's path."""
    return _MARK + (service_files() / name).read_text(encoding="utf-8").replace("@EXECUTABLE@", program)


def network_text(addresses: Sequence[str]) -> str:
    """Return the text of the file that allows addresses besides this machine's. ServiceError if one is invalid.

    An address is an IP address, a network such as 192.168.1.0/24, or one of systemd's names, such as `multicast`.
    """
    for address in addresses:
        try:
            if address not in _NETWORKS:
                ip_network(address.replace("%", "/%"))  # no scope, whose text Python does not check
        except ValueError as e:
            problem = "has bits after its prefix" if "host bits" in str(e) else "is neither an IP address nor a network"
            raise ServiceError(
                f"--allow {address}: {problem}", f"write for example 192.168.1.7, 192.168.1.0/24 or {_NETWORKS[0]}"
            ) from None
    lines = "\n".join(f"IPAddressAllow={address}" for address in dict.fromkeys(addresses))
    return f"{_MARK}# Addresses of network outputs and metrics.\n[Service]\n{lines}\n"


def configuration(place: Place) -> str:
    """Return the first configuration."""
    own = place.configuration
    learnt = own if place.user else place.state
    text = (service_files() / "config.yaml").read_text(encoding="utf-8")
    for name, path in (("@RIG@", own / "rig.yaml"), ("@MAP@", learnt / "rig.map.yaml")):
        text = text.replace(name, place.inside(path))
    return text


def carry_out(actions: Iterator[FileAction] | list[FileAction], umask: int = 0o022) -> Iterator[str]:
    """Carry out the actions, and yield a line for each; ServiceError if one that `must` succeed fails.

    The umask replaces the account's own: with 077, other users could not read the placed files.
    """
    for action in list(actions):
        try:
            with under_umask(umask):
                action.do()
        except (OSError, RecursionError, ConfigurationError, ServiceError) as e:
            problem = f"{action}: {printable(e.strerror if isinstance(e, OSError) and e.strerror else e)}"
            if action.must:
                raise ServiceError(problem) from None
            yield f"failed: {problem}"
        else:
            yield str(action)


def may(place: Place) -> bool:
    """Return True if this account can write into the folders of the files."""
    return all(os.access(_existing(path.parent), os.W_OK | os.X_OK) for path in place.files.values())


def _existing(folder: Path) -> Path:
    return next(p for p in (folder, *folder.parents) if os.path.lexists(p))


@contextlib.contextmanager
def under_umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    replace(path, text.encode("utf-8"), 0o644)  # systemd, udev and desktops must read it, whatever the umask


def _link(place: Place, unit: Path) -> None:
    link = place.link_of(unit)
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(place.inside(unit))


def _remove(path: Path) -> None:
    """Remove a folder with its content, or a link. Targets of links stay."""
    if path.is_symlink():
        path.unlink()
    else:
        shutil.rmtree(path)
