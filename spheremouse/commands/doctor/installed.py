"""The service: installation, start with the computer, failures, and its user's right on the camera."""

import os
import subprocess
from pathlib import Path
from typing import Any

from spheremouse.commands.service import systemd as service
from spheremouse.commands.service.systemd import UNIT, USER, Place
from spheremouse.files.access import group_of
from spheremouse.finding import Finding, ok, unchecked, warning, wrong

_ASKED = ("ActiveState", "SubState", "Result", "NRestarts")


def check(node: Path | None, root: Path = Path("/")) -> list[Finding]:
    """Check the system's service and the user's own."""
    places = [p for p in (Place(root), Place(root, user=True)) if os.path.lexists(p.unit)]
    if not places:
        return [ok("service", "not installed: spheremouse runs when it is started by hand",
                   "to start with the computer: spheremouse service install")]  # fmt: skip
    found = [f for p in places for f in (_files(p), _runs(p))]
    if len(places) > 1:
        found.append(warning(
            "service", "the system's and one of your own: they fight for the camera",
            "remove one: spheremouse service uninstall, with --user or without",
        ))  # fmt: skip
    if not places[0].user and node is not None:
        found.append(_user(node))
    return found


def _files(place: Place) -> Finding:
    name = "service files" if not place.user else "own service files"
    again = f"spheremouse service install{' --user' if place.user else ''}"
    states = {path: service.state_of(path, None) for _, path in place.files()}
    missing = [str(p) for p, s in states.items() if s == "missing"]
    edited = [str(p) for p, s in states.items() if s == "edited"]
    config = place.configuration / "config.yaml"
    if not os.path.lexists(config):
        missing.append(str(config))
    if missing:
        return warning(name, f"missing: {', '.join(missing)}", again)
    told = "starts with the computer" if place.link.is_symlink() else "does not start with the computer"
    told += f"; edited by hand: {', '.join(edited)}" if edited else ""
    if not place.link.is_symlink():
        return warning(name, told, f"systemctl {'--user ' if place.user else ''}enable {UNIT}")
    return ok(name, told)


def _runs(place: Place) -> Finding:
    name = "service" if not place.user else "own service"
    user = ["--user"] if place.user else []
    told = _asked(["systemctl", *user, "show", UNIT, f"--property={','.join(_ASKED)}"])
    if not told.get("ActiveState"):
        return unchecked(name, "systemd does not run here, or does not answer")
    log = f"journalctl {'--user ' if place.user else ''}-u {UNIT} -b"
    text = f"{told['ActiveState']} ({told.get('SubState', '')})"
    restarts = int(told.get("NRestarts") or 0)
    numbers: dict[str, Any] = {"active": told["ActiveState"], "restarts": restarts}
    if told["ActiveState"] == "failed" or told.get("Result", "success") != "success":
        return wrong(name, f"{text}: {told.get('Result')}", f"see {log}", **numbers)
    if told["ActiveState"] != "active":
        return warning(name, text, f"systemctl {'--user ' if place.user else ''}start {UNIT}", **numbers)
    if restarts:
        return warning(name, f"{text}, restarted {restarts} times", f"see {log}", **numbers)
    return ok(name, text, **numbers)


def _user(node: Path) -> Finding:
    """Check the service's user, and its membership of the camera's group."""
    import grp
    import pwd

    try:
        entry = pwd.getpwnam(USER)
    except KeyError:
        return wrong("service user", f"there is no user {USER}", "as root: spheremouse service install")
    group = group_of(node)
    names = []
    for number in os.getgrouplist(USER, entry.pw_gid):
        try:
            names.append(grp.getgrgid(number).gr_name)
        except KeyError:
            continue
    if group is not None and group not in names:
        return wrong(
            "service user", f"{USER} is not in the group {group} of {node}", f"as root: usermod -aG {group} {USER}"
        )
    return ok("service user", f"{USER}, in the groups {', '.join(sorted(names))}")


def _asked(command: list[str]) -> dict[str, str]:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=3.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return {}
    return dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
