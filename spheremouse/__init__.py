"""Track a ball with a camera and turn its rotation into mouse motion.

`import spheremouse as sm` takes hundredths of a second: the names below load the program when they are first used.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spheremouse.api import evaluate, load_configuration, load_rig, open_dataset, smooth, track
    from spheremouse.ball.rig import Rig
    from spheremouse.capture import Source, open_source
    from spheremouse.errors import SpheremouseError
    from spheremouse.output.sample import Sample
    from spheremouse.session.control.client import connect
    from spheremouse.session.settings import Configuration
    from spheremouse.tracker import Estimate, Status

__version__ = "0.1.0"

__all__ = [
    "Configuration",
    "Estimate",
    "Rig",
    "Sample",
    "Source",
    "SpheremouseError",
    "Status",
    "__version__",
    "connect",
    "evaluate",
    "load_configuration",
    "load_rig",
    "open_dataset",
    "open_source",
    "smooth",
    "track",
]

_HOMES = {
    "Configuration": "session.settings",
    "Estimate": "tracker",
    "Rig": "ball.rig",
    "Sample": "output.sample",
    "Source": "capture",
    "SpheremouseError": "errors",
    "Status": "tracker",
    "connect": "session.control.client",
    "open_source": "capture",
}


def __getattr__(name: str) -> Any:
    """Load a public name. Raises AttributeError for another one."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f"{__name__}.{_HOMES.get(name, 'api')}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
