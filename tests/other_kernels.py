"""A plugin of pytest that loads the native part from the folder $KERNELS, built with sanitizers (`make sanitize`)."""

import importlib.util
import os
import sys
from pathlib import Path

_NAME = "spheremouse.native.kernels"
(_file,) = Path(os.environ["KERNELS"]).glob("*.so")
_spec = importlib.util.spec_from_file_location(_NAME, _file)
assert _spec is not None
assert _spec.loader is not None
sys.modules[_NAME] = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(sys.modules[_NAME])
