"""The program itself: version, Python, and whether its compiled code is on the disk."""

import os
import platform
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from spheremouse import __version__
from spheremouse.commands.doctor.finding import Finding, ok, warning

_LEAST = (3, 11)


def version() -> Finding:
    """Version of the program, of Python and of the system."""
    python = platform.python_version()
    system = f"{platform.system()} {platform.release()}, {platform.machine()}"
    text = f"spheremouse {__version__}, Python {python}, {system}"
    values: dict[str, Any] = {"spheremouse": __version__, "python": python, "system": system}
    if sys.version_info < _LEAST:
        return warning("version", text, f"install Python {'.'.join(map(str, _LEAST))} or newer", **values)
    return ok("version", text, **values)


def compiled_code() -> Finding:
    """Number of the functions compiled by numba that are on the disk already, and the folder."""
    import spheremouse.ball.track  # noqa: F401  with all that tracking calls

    return compiled(_dispatchers())


def compiled(functions: Iterable[Any]) -> Finding:
    """The same of given dispatchers of numba."""
    every = list(functions)
    folders = {str(f.stats.cache_path) for f in every if f.stats.cache_path}
    there = sum(_is_kept(f) for f in every)
    first = os.path.commonpath(folders) if folders else ""
    numbers: dict[str, Any] = {"kept": there, "functions": len(every), "folder": first}
    if not first:
        return warning(
            "compiled code",
            "cannot be kept: every start compiles for a minute",
            "set NUMBA_CACHE_DIR to a folder that this account may write",
            **numbers,
        )
    if 2 * there < len(every):
        return warning(
            "compiled code",
            f"{there} of {len(every)} functions are compiled for this processor, in {first}",
            "nothing to mend: the first run compiles the rest, which takes about a minute, once",
            **numbers,
        )
    return ok("compiled code", f"{there} of {len(every)} functions are kept for this processor, in {first}", **numbers)


def _dispatchers() -> list[Any]:
    from numba.core.dispatcher import Dispatcher

    modules = [m for name, m in sys.modules.items() if name.partition(".")[0] == "spheremouse"]
    found = {id(f): f for m in modules for f in vars(m).values() if isinstance(f, Dispatcher)}
    return list(found.values())


def _is_kept(function: Any) -> bool:
    """Is there compiled code of this function as it is written now, for this processor?

    numba's index holds both; what it keeps to itself may change, then whatever file it left counts.
    """
    from numba.core.registry import cpu_target

    body, folder = function.py_func, function.stats.cache_path
    if not folder:
        return False
    try:
        kept = function._cache._cache_file._load_index()
        target: Any = cpu_target.target_context
        here = target.codegen().magic_tuple()
        return any(here in key for key in kept)
    except (AttributeError, TypeError):
        names = f"{Path(body.__code__.co_filename).stem}.{body.__qualname__}-{body.__code__.co_firstlineno}.*.nbi"
        return any(Path(folder).glob(names))
    except Exception:  # an index that cannot be read, whatever that raises
        return False
