"""The computer: the program, the service, and disk, memory, scheduling rights and load."""

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

from spheremouse import __version__
from spheremouse.commands.service import systemd as service
from spheremouse.commands.service.systemd import UNIT, USER, Place
from spheremouse.compiling import kernels_on_disk
from spheremouse.files.access import group_of
from spheremouse.finding import Finding, Verdict, classify, ok, unchecked, warning, wrong
from spheremouse.session.process.realtime import PRIORITY
from spheremouse.session.record.places import recordings_folder
from spheremouse.session.settings.record import RecordSettings

_MIN_MEMORY_MB = 400.0  # the daemon's 200, and as much for the compiler at its first start
_CAP_SYS_NICE = 23
_ASKED = ("ActiveState", "SubState", "Result", "NRestarts")

# ---- program ----


def version() -> Finding:
    """Report the versions of the program, of Python and of the system."""
    python = platform.python_version()
    system = f"{platform.system()} {platform.release()}, {platform.machine()}"
    text = f"spheremouse {__version__}, Python {python}, {system}"
    return ok("version", text, spheremouse=__version__, python=python, system=system)


def compiled_code() -> Finding:
    """Report the number of functions that Numba has compiled and kept."""
    import spheremouse.ball.track  # noqa: F401  with all that tracking calls

    kept, total, folder = kernels_on_disk()
    if not folder:
        advice = "set NUMBA_CACHE_DIR to a folder that this account may write"
        return warning("compiled code", "cannot be kept: every start compiles for a minute", advice)
    first = "nothing to mend: the first run compiles the rest, which takes about a minute, once"
    return classify(
        "compiled code",
        f"{kept} of {total} functions are compiled, in {folder}",
        (2 * kept < total, Verdict.WARNING, "", first),
        kept=kept,
        functions=total,
        folder=folder,
    )


# ---- service ----


def installed(node: Path | None, root: Path = Path("/")) -> list[Finding]:
    """Check the system's service, the user's own, and the right of the service's user on the camera's `node`."""
    places = [p for p in (Place(root), Place(root, user=True)) if os.path.lexists(p.unit)]
    if not places:
        advice = "to start with the computer: spheremouse service install"
        return [ok("service", "not installed: spheremouse runs when it is started by hand", advice)]
    found = [f for p in places for f in (service_files(p), service_state(p))]
    if len(places) > 1:
        advice = "remove one: spheremouse service uninstall, with --user or without"
        found.append(warning("service", "the system's and one of your own: they fight for the camera", advice))
    if not places[0].user and node is not None:
        found.append(service_user(node))
    return found


def service_files(place: Place) -> Finding:
    """Check the files that the service consists of, and its start with the computer."""
    user = " --user" if place.user else ""
    program, trouble = service.executable(place)
    systemd = service.systemd_version()
    states: dict[str, str] = {}
    for name, path in place.files():
        # a program that cannot be the service's did not place these files, so their text may differ
        states[str(path)] = service.state_of(path, None if trouble else service.rendered(name, program, systemd))
    config = place.configuration / "config.yaml"
    states[str(config)] = "ok" if os.path.lexists(config) else "missing"
    missing, older, edited = (
        ", ".join(p for p, s in states.items() if s == state) for state in ("missing", "older", "edited")
    )
    name, starts = "own service files" if place.user else "service files", place.link.is_symlink()
    text = f"{'starts' if starts else 'does not start'} {'at login' if place.user else 'with the computer'}"
    text += f"; edited by hand: {edited}" if edited else ""
    install = trouble or f"spheremouse service install{user}"
    return classify(
        name,
        text,
        (bool(missing), Verdict.WARNING, f"; missing: {missing}", install),
        (bool(older), Verdict.WARNING, f"; of another version or installation: {older}", install),
        (not starts, Verdict.WARNING, "", f"systemctl{user} enable {UNIT}"),
    )


def service_state(place: Place) -> Finding:
    """Check whether the service runs."""
    name, user = ("own service", " --user") if place.user else ("service", "")
    told = _shown([*f"systemctl{user}".split(), "show", UNIT, f"--property={','.join(_ASKED)}"])
    active, result = told.get("ActiveState"), told.get("Result", "success")
    if not active:
        return unchecked(name, "systemd does not run here, or does not answer")
    log, restarts = f"see journalctl{user} -u {UNIT} -b", int(told.get("NRestarts") or 0)
    rig, start = place.configuration / "rig.yaml", f"systemctl{user} start {UNIT}"
    if not rig.exists():
        start = f"calibrate (spheremouse calibrate next), copy rig.yaml to {rig}, then: {start}"
    return classify(
        name,
        f"{active} ({told.get('SubState', '')})",
        (active == "failed" or result != "success", Verdict.WRONG, f": {result}", log),
        (active != "active", Verdict.WARNING, "", start),
        (restarts > 0, Verdict.WARNING, f", restarted {restarts} times", log),
        active=active,
        restarts=restarts,
    )


def service_user(node: Path | None) -> Finding:
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


def _shown(command: list[str]) -> dict[str, str]:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=3.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return {}
    return dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)


# ---- computer ----


def disk(settings: RecordSettings, state: Path | None = None) -> Finding:
    """Check the room for one recording. `state` is the folder of a service, which runs as another account."""
    of_service = state is not None and settings.folder is None
    folder = state / "recordings" if state is not None and of_service else recordings_folder(settings)
    there = folder
    while not os.path.exists(there):  # or is closed to this account
        there = there.parent
    free, needed = shutil.disk_usage(there).free / 1e6, settings.megabytes + settings.free_megabytes
    elsewhere = "set record.folder elsewhere"
    values = {"free_mb": round(free), "needed_mb": round(needed)}
    if not of_service and not os.access(there, os.W_OK | os.X_OK):
        text = f"{there} may not be written: no recordings"
        return warning("disk", text, elsewhere, **values)
    return classify(
        "disk",
        f"{free / 1e3:.1f} GB free for recordings in {folder}",
        (free < needed, Verdict.WARNING, f"; a whole one needs {needed / 1e3:.1f}", f"make room, or {elsewhere}"),
        **values,
    )


def memory(listed: Path = Path("/proc/meminfo")) -> Finding:
    """Check the free memory."""
    free_kb = _proc_value(listed, "MemAvailable")
    if free_kb is None:
        return unchecked("memory", "this system does not say")
    free = int(free_kb) * 1024 / 1e6
    wanted = f", {_MIN_MEMORY_MB:.0f} are wanted"
    return classify(
        "memory",
        f"{free:.0f} MB are free",
        (free < _MIN_MEMORY_MB, Verdict.WARNING, wanted, "end other programs"),
        free_mb=round(free),
    )


def scheduling(service: bool, status: Path = Path("/proc/self/status")) -> Finding:
    """Check the right to real-time scheduling. A `service` has it by its unit."""
    if not sys.platform.startswith("linux"):
        return unchecked("scheduling", "not known on this system")
    import resource

    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    effective = int(_proc_value(status, "CapEff") or "0", 16)
    if limit >= PRIORITY or limit == resource.RLIM_INFINITY or effective >> _CAP_SYS_NICE & 1:
        return ok("scheduling", "real-time scheduling is granted", rtprio=limit)
    if service:
        return ok("scheduling", "not granted to this account, but to the service", rtprio=limit)
    limits = f"grant rtprio {PRIORITY} in /etc/security/limits.d"
    return warning(
        "scheduling",
        "no real-time scheduling: other programs may delay the pointer",
        f"run it as a service (spheremouse service install), or {limits}",
        rtprio=limit,
    )


def load() -> Finding:
    """Compare the number of busy programs with that of the cores."""
    if not hasattr(os, "getloadavg"):
        return unchecked("load", "this system does not say")
    cores, now = os.cpu_count() or 1, os.getloadavg()[0]
    return classify(
        "load",
        f"{now:.1f} programs busy on {cores} core{'' if cores == 1 else 's'}",
        (now > cores, Verdict.WARNING, "", "end what is not needed: `top` shows it"),
        load=round(now, 2),
        cores=cores,
    )


def _proc_value(file: Path, key: str) -> str | None:
    """Return the first word after `key:` in a file of /proc; None if it is not there."""
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
        return next(line.split()[1] for line in lines if line.startswith(f"{key}:"))
    except (OSError, StopIteration, IndexError):
        return None
