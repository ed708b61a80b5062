"""The computer: the program, and disk, memory, scheduling rights and load."""

import os
import platform
import shutil
import sys
from pathlib import Path

from spheremouse import __version__
from spheremouse.errors import format_count
from spheremouse.finding import Finding, Verdict, classify, ok, unchecked, warning
from spheremouse.session.process.realtime import PRIORITY
from spheremouse.session.record.places import recordings_folder
from spheremouse.session.settings import RecordSettings

_MIN_MEMORY_MB = 200.0  # tracking takes 180
_CAP_SYS_NICE = 23


def version() -> Finding:
    """Report the versions of the program, of Python and of the system."""
    python = platform.python_version()
    system = f"{platform.system()} {platform.release()}, {platform.machine()}"
    text = f"spheremouse {__version__}, Python {python}, {system}"
    return ok("version", text, spheremouse=__version__, python=python, system=system)


def disk(settings: RecordSettings, state: Path | None = None) -> Finding:
    """Check the room for one recording. `state` is the folder of a service, which runs as another account."""
    of_service = state is not None and settings.folder is None
    folder = state / "recordings" if state is not None and of_service else recordings_folder(settings)
    existing = folder
    while not os.path.exists(existing):  # or is closed to this account
        existing = existing.parent
    free, needed = shutil.disk_usage(existing).free / 1e6, settings.megabytes + settings.free_megabytes
    elsewhere = "set record.folder elsewhere"
    values = {"free_mb": round(free), "needed_mb": round(needed)}
    if not of_service and not os.access(existing, os.W_OK | os.X_OK):
        text = f"{existing} may not be written: no recordings"
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
        return unchecked("memory", "this system does not report it")
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
        return unchecked("load", "this system does not report it")
    cores, now = os.cpu_count() or 1, os.getloadavg()[0]
    return classify(
        "load",
        f"{now:.1f} programs busy on {format_count(cores, 'core')}",
        (now > cores, Verdict.WARNING, "", "end other programs: `top` lists them"),
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
