"""Kernel modules of the guest, as run_in_vm.sh lays them out."""

import subprocess
from pathlib import Path

import pytest

MODULES = Path("/run/cameras")


def insert(name, **parameters):
    """Load a module and what it needs; skips the test where there is none."""
    missing = MODULES / f"{name}.missing"
    if missing.exists():
        pytest.skip(missing.read_text().strip())
    *needs, module = (MODULES / name).read_text().split()
    for file in needs:
        subprocess.run(["/sbin/insmod", MODULES / file], check=False, capture_output=True)  # it may be there already
    given = [f"{k}={v}" for k, v in parameters.items()]
    subprocess.run(["/sbin/insmod", MODULES / module, *given], check=True)
