"""The computer: disk, memory, scheduling rights and load."""

import os
import shutil
import sys
from pathlib import Path
from typing import Any

from spheremouse.finding import Finding, ok, unchecked, warning
from spheremouse.session.process.realtime import PRIORITY
from spheremouse.session.record.places import recordings_folder
from spheremouse.session.settings.record import RecordSettings

_MEMORY = 400.0  # MB: the daemon's 200, and as much for the compiler at its first start
_SYS_NICE = 23  # CAP_SYS_NICE


def disk(settings: RecordSettings, state: Path | None = None) -> Finding:
    """Check the room for one recording. `state` is the folder of a service, which runs as another account."""
    of_service = state is not None and settings.folder is None
    folder = state / "recordings" if state is not None and of_service else recordings_folder(settings)
    there = folder
    while not os.path.exists(there):  # or is closed to this account
        there = there.parent
    free, needed = shutil.disk_usage(there).free / 1e6, settings.megabytes + settings.free_megabytes
    text = f"{free / 1e3:.1f} GB free for recordings in {folder}"
    numbers: dict[str, Any] = {"free_mb": round(free), "needed_mb": round(needed)}
    if not of_service and not os.access(there, os.W_OK | os.X_OK):
        return warning("disk", f"{there} may not be written: no recordings", "set record.folder elsewhere", **numbers)
    if free < needed:
        return warning(
            "disk",
            f"{text}; a whole one needs {needed / 1e3:.1f}",
            "make room, or set record.folder elsewhere",
            **numbers,
        )
    return ok("disk", text, **numbers)


def memory(listed: Path = Path("/proc/meminfo")) -> Finding:
    """Check the free memory."""
    try:
        lines = listed.read_text(encoding="ascii").splitlines()
        free = next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")) * 1024 / 1e6
    except (OSError, ValueError, StopIteration, IndexError):
        return unchecked("memory", "this system does not say")
    if free < _MEMORY:
        return warning(
            "memory", f"{free:.0f} MB are free, {_MEMORY:.0f} are wanted", "end other programs", free_mb=round(free)
        )
    return ok("memory", f"{free / 1e3:.1f} GB are free", free_mb=round(free))


def scheduling(service: bool) -> Finding:
    """Check the right to real-time scheduling. A `service` has it by its unit."""
    if not sys.platform.startswith("linux"):
        return unchecked("scheduling", "not known on this system")
    import resource

    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    if limit >= PRIORITY or limit == resource.RLIM_INFINITY or _may_nice():
        return ok("scheduling", "real-time scheduling is granted", rtprio=limit)
    if service:
        return ok("scheduling", "not granted to this account, but to the service", rtprio=limit)
    return warning(
        "scheduling",
        "no real-time scheduling: other programs may delay the pointer",
        f"run it as a service (spheremouse service install), or grant rtprio {PRIORITY} in /etc/security/limits.d",
        rtprio=limit,
    )


def load() -> Finding:
    """Compare the number of busy programs with that of the cores."""
    if not hasattr(os, "getloadavg"):
        return unchecked("load", "this system does not say")
    cores, now = os.cpu_count() or 1, os.getloadavg()[0]
    text = f"{now:.1f} programs busy on {cores} core{'' if cores == 1 else 's'}"
    if now > cores:
        return warning("load", text, "end what is not needed: `top` shows it", load=round(now, 2), cores=cores)
    return ok("load", text, load=round(now, 2), cores=cores)


def _may_nice() -> bool:
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        effective = next(int(line.split()[1], 16) for line in lines if line.startswith("CapEff:"))
    except (OSError, ValueError, StopIteration, IndexError):
        return False
    return bool(effective >> _SYS_NICE & 1)
