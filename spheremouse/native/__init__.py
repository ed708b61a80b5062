"""Per-frame functions in C++, described in `kernels.pyi`. Each source lies beside the Python module that calls it."""

from spheremouse.errors import SpheremouseError

try:
    from spheremouse.native import kernels
except ImportError as e:
    raise SpheremouseError(
        "the part of spheremouse in C++ is not built", "run make native; Debian's package of the compiler is g++"
    ) from e

__all__ = ["kernels"]
