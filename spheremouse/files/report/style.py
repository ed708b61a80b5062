"""matplotlib, where it is installed."""

import importlib
from typing import TYPE_CHECKING

from spheremouse.errors import ConfigurationError

if TYPE_CHECKING:
    pass


def has_matplotlib() -> bool:
    """Whether it is there, and can be imported."""
    try:
        importlib.import_module("matplotlib")
    except Exception:  # an installation may be broken in any way
        return False
    return True


def require_matplotlib() -> None:
    """Raise ConfigurationError where matplotlib is not installed."""
    if not has_matplotlib():
        raise ConfigurationError("plots need matplotlib: pip install 'spheremouse[plot]'")
