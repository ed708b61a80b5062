"""The program: its version, Python, and the compiled code on the disk."""

import platform

from spheremouse import __version__
from spheremouse.compiling import kernels_on_disk
from spheremouse.finding import Finding, ok, warning


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
    text = f"{kept} of {total} functions are compiled, in {folder}"
    if not folder:
        return warning(
            "compiled code",
            "cannot be kept: every start compiles for a minute",
            "set NUMBA_CACHE_DIR to a folder that this account may write",
        )
    if 2 * kept < total:
        advice = "nothing to mend: the first run compiles the rest, which takes about a minute, once"
        return warning("compiled code", text, advice, kept=kept, functions=total, folder=folder)
    return ok("compiled code", text, kept=kept, functions=total, folder=folder)
