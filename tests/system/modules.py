"""Kernel modules of the guest, as run_in_vm.sh lays them out."""

import subprocess
import time
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


def remove(name, patience=120.0):
    """Unload a module as soon as nobody has it open; AssertionError if that takes longer than `patience` s."""
    end = time.monotonic() + patience
    while subprocess.run(["/sbin/rmmod", name], check=False, capture_output=True).returncode != 0:
        assert time.monotonic() < end, f"{name} is still in use"
        time.sleep(0.05)
