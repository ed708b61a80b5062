"""Per-frame functions in C++, described in `kernels.pyi`. Each source lies beside the Python module that calls it."""

from typing import NoReturn

from spheremouse.errors import SpheremouseError

try:
    from spheremouse.native import kernels
except ImportError as e:
    raise SpheremouseError(
        "the part of spheremouse in C++ is not built", "run make native; Debian's package of the compiler is g++"
    ) from e

__all__ = ["kernels"]


class OldKernelsError(SpheremouseError, AttributeError):
    """The kernels were built before the Python source needed this name."""


def _refuse(name: str) -> NoReturn:
    raise OldKernelsError(
        f"the part of spheremouse in C++ has no {name}: it is older than the rest", "run make native, or install again"
    )


kernels.__dict__["__getattr__"] = _refuse  # Python calls it for names that the module lacks (PEP 562)
