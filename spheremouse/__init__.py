"""Track a ball with a camera and turn its rotation into mouse motion."""

from spheremouse import numba_cache as _compiled

__version__ = "0.1.0"

_compiled.keep_somewhere()
