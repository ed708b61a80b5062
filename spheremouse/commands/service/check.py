"""Check the service: installation, start with the computer, failures, and its user's right on the camera."""

import os
import subprocess
from pathlib import Path

from spheremouse.commands.service import systemd as service
from spheremouse.commands.service.systemd import UNIT, USER, Place
from spheremouse.files.access import group_of
from spheremouse.finding import Finding, Verdict, classify, ok, unchecked, warning, wrong

_QUERIED_PROPERTIES = ("ActiveState", "SubState", "Result", "NRestarts")


def installed(node: Path | None, root: Path = Path("/")) -> list[Finding]:
    """Check the system's service, the user's own, and the right of the service's user on the camera's `node`."""
    places = [p for p in (Place(root), Place(root, user=True)) if os.path.lexists(p.unit)]
    if not places:
        advice = "to start with the computer: spheremouse service install"
        return [ok("service", "not installed: spheremouse runs when it is started by hand", advice)]
    found = [f for p in places for f in (check_files(p), check_state(p))]
    if len(places) > 1:
        advice = "remove one: spheremouse service uninstall, with --user or without"
        found.append(warning("service", "the system's and one of your own: they fight for the camera", advice))
    if not places[0].user and node is not None:
        found.append(check_user(node))
    return found


def check_files(place: Place) -> Finding:
    """Check the files that the service consists of, and its start with the computer."""
    user = " --user" if place.user else ""
    program, trouble = service.executable(place)
    missing, other = list[Path](), list[Path]()
    for name, path in place.files.items():
        # a program that cannot be the service's did not place these files, so their text may differ
        if not os.path.lexists(path):
            missing.append(path)
        elif not trouble and service.differs(path, service.render_file(name, program)):
            other.append(path)
    config = place.configuration / "config.yaml"
    missing += [] if os.path.lexists(config) else [config]
    name, starts = "own service files" if place.user else "service files", place.link.is_symlink()
    text = f"{'starts' if starts else 'does not start'} {'at login' if place.user else 'with the computer'}"
    install = trouble or f"spheremouse service install{user}"
    return classify(
        name,
        text,
        (bool(missing), Verdict.WARNING, f"; missing: {', '.join(map(str, missing))}", install),
        (bool(other), Verdict.WARNING, f"; edited, or of another version: {', '.join(map(str, other))}", install),
        (not starts, Verdict.WARNING, "", f"systemctl{user} enable {UNIT}"),
    )


def check_state(place: Place) -> Finding:
    """Check whether the service runs."""
    name, user = ("own service", " --user") if place.user else ("service", "")
    output = _unit_properties(
        [*f"systemctl{user}".split(), "show", UNIT, f"--property={','.join(_QUERIED_PROPERTIES)}"]
    )
    active, result = output.get("ActiveState"), output.get("Result", "success")
    if not active:
        return unchecked(name, "systemd does not run here, or does not answer")
    log, restarts = f"see journalctl{user} -u {UNIT} -b", int(output.get("NRestarts") or 0)
    rig, start = place.configuration / "rig.yaml", f"systemctl{user} start {UNIT}"
    if not rig.exists():
        start = f"calibrate (spheremouse calibrate next), copy rig.yaml to {rig}, then: {start}"
    return classify(
        name,
        f"{active} ({output.get('SubState', '')})",
        (active == "failed" or result != "success", Verdict.WRONG, f": {result}", log),
        (active != "active", Verdict.WARNING, "", start),
        (restarts > 0, Verdict.WARNING, f", restarted {restarts} times", log),
        active=active,
        restarts=restarts,
    )


def check_user(node: Path | None) -> Finding:
    """Check the service's user, and its membership of the group of a camera's node."""
    import grp
    import pwd

    try:
        entry = pwd.getpwnam(USER)
    except KeyError:
        return wrong("service user", f"there is no user {USER}", "as root: spheremouse service install")
    group, numbers = None if node is None else group_of(node), os.getgrouplist(USER, entry.pw_gid)
    names = sorted(g.gr_name for g in grp.getgrall() if g.gr_gid in numbers)
    if group is not None and group not in names:
        advice = f"as root: usermod -aG {group} {USER}"
        return wrong("service user", f"{USER} is not in the group {group} of {node}", advice)
    return ok("service user", f"{USER}, in the groups {', '.join(names)}")


def _unit_properties(command: list[str]) -> dict[str, str]:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=3.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return {}
    return dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
