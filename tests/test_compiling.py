"""How far the compiler is: kernels of the package are counted, each once, and nothing is said of what is on disk."""

import os
import subprocess
import sys

import pytest

CODE = """
import numpy as np
from spheremouse import compiling
from spheremouse.geometry.rotation import exp, log

said = []
with compiling.report_compilation(said.append):
    log(exp(np.array([[0.1, 0.2, 0.3]])))
print(*said, sep="\\n")
exp(np.array([[0.1]] * 3).T)
"""


def run(cache, code=CODE):
    env = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=env)
    return done.stdout.split("\n")[:-1], done.stderr


@pytest.mark.slow
def test_each_kernel_is_counted_once_and_what_is_on_disk_is_not_spoken_of(tmp_path):
    told, _ = run(tmp_path)
    counts = [line.partition(": ")[2].split()[:3] for line in told]
    assert len(told) > 3
    assert [int(done) for done, _, _ in counts] == list(range(len(told)))
    assert {total.rstrip(",") for _, _, total in counts} == {counts[0][2]}
    assert int(counts[0][2]) >= len(told) - 1  # of all that is imported; not all of it is called here
    assert told[0] == f"compiling for this machine, once after an installation: 0 of {counts[0][2]}"
    assert told[1].endswith(" left")
    assert run(tmp_path) == ([""], "")


@pytest.mark.slow
def test_by_default_lines_on_standard_error_not_too_many(tmp_path):
    _, said = run(tmp_path, CODE.replace("said.append", "") + "\nassert not said")
    assert said.startswith("spheremouse: compiling for this machine, once after an installation: 0 of ")
    assert said.count("\n") < 5
