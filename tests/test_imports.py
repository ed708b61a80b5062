"""Every module can be imported, with whatever is installed: what a library has renamed shows here first."""

import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import spheremouse

CLIP = Path(__file__).parent / "data" / "far26_clip"

MODULES = [
    m.name for m in pkgutil.walk_packages(spheremouse.__path__, "spheremouse.") if m.name != "spheremouse.__main__"
]


@pytest.mark.skipif(sys.platform != "linux", reason="some are of Linux alone")
@pytest.mark.parametrize("name", MODULES)
def test_it_can_be_imported(name):
    importlib.import_module(name)


def test_a_ball_is_tracked_without_scipy():
    """Its import takes as long as the rest of the start."""
    run = f"app(['run', '--source', 'dataset:{CLIP}', '--frames', '2', '--output', 'null'], standalone_mode=False)"
    code = f"import sys; from spheremouse.commands import app; {run}; assert 'scipy' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
