"""Every module can be imported, with whatever is installed: what a library has renamed shows here first."""

import importlib
import pkgutil
import sys

import pytest

import spheremouse

MODULES = [
    m.name for m in pkgutil.walk_packages(spheremouse.__path__, "spheremouse.") if m.name != "spheremouse.__main__"
]


@pytest.mark.skipif(sys.platform != "linux", reason="some are of Linux alone")
@pytest.mark.parametrize("name", MODULES)
def test_it_can_be_imported(name):
    importlib.import_module(name)
