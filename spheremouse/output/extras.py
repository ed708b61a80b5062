"""Optional packages of outputs."""

import importlib
from typing import Any

from spheremouse.errors import OutputError


def import_extra(kind: str, package: str, extra: str, module: str = "") -> Any:
    """Return a module of an optional package. Raise OutputError with the extra that installs it if it is missing."""
    try:
        return importlib.import_module(module or package)
    except ImportError:
        raise OutputError(f"{kind}: needs the package {package}", f"pip install 'spheremouse[{extra}]'") from None
