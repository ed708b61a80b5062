"""Every native entry point with damaged arguments: no crash, no long call, and no error but a documented one.

The calls come from small runs. Each then gets nan, infinite and huge numbers, empty arrays, other lengths, types and
orders, and indices out of range. The stubs list the entry points, so a new one is called too. `make sanitize` runs this
with the sanitizers.
"""

import contextlib
import math
from typing import Any

import numpy as np
import pytest
from native_calls import STUBS, Call, calls, invoke, places, replaced, value_at

from spheremouse.native import kernels
from tests.fuzz.fuzzing import EXAMPLES, bounded

CALLS = 100  # of an entry point in an example: 200 examples of all are a million
DOCUMENTED = TypeError, ValueError, IndexError
FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, 1e-12, 0.5, -1.0, 3.0, 1e9, -1e300, 1e300)
INTEGERS = (-(2**63), -(2**31) - 1, -(2**31), -1, 0, 1, 2, 3, 7, 255, 2**31 - 1, 2**31, 2**63 - 1)
OTHERS = (None, "text", (), [1.0], b"1", np.zeros(0), np.array(1.0), 1j)


def damaged(value: Any, rng: np.random.Generator) -> Any:
    """Return another value of the same type, or rarely of another type."""
    if rng.random() < 0.03:
        return OTHERS[rng.integers(len(OTHERS))]
    if isinstance(value, np.ndarray):
        return other_numbers(value, rng) if rng.random() < 0.7 else other_length(value, rng)
    if isinstance(value, tuple):
        at = int(rng.integers(len(value) + 1))
        return (value[:at], value[at:], (*value, *value), value[::-1], list(value), (None,) * len(value))[
            rng.integers(6)
        ]
    if isinstance(value, bool | np.bool_):
        return not value
    if isinstance(value, int | np.integer):
        return INTEGERS[rng.integers(len(INTEGERS))]
    if isinstance(value, float):
        return FLOATS[rng.integers(len(FLOATS))]
    return native_object(type(value).__name__, rng) or value


def other_numbers(value: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    new = value.copy()
    if new.size == 0 or new.dtype.kind not in "fiub":
        return new
    if new.dtype.kind == "f" and rng.random() < 0.2:
        with np.errstate(all="ignore"):
            return new * new.dtype.type(10.0 ** rng.integers(-30, 30))
    where = (new.size * rng.random(int(rng.choice([1, 2, new.size])))).astype(int)
    if new.dtype.kind == "f":
        some = np.array(FLOATS)
    else:
        limits = np.iinfo(new.dtype) if new.dtype.kind in "iu" else np.iinfo(np.uint8)
        some = np.array([n for n in INTEGERS if limits.min <= n <= limits.max], dtype=limits.dtype)
    with np.errstate(all="ignore"):
        new.reshape(-1)[where] = rng.choice(some, where.size).astype(new.dtype)
    return new


def other_length(value: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    if value.ndim == 0:
        return value
    axis = int(rng.integers(value.ndim))
    length = max(int(rng.choice([0, 1, value.shape[axis] - 1, value.shape[axis] + 1])), 0)
    if length and value.shape[axis] == 0:
        return np.zeros([n or 1 for n in value.shape], value.dtype)
    return np.take(value, range(length), axis=axis, mode="wrap")


def native_object(name: str, rng: np.random.Generator) -> Any:
    """Return an object made from damaged arguments, or None if they are refused."""
    if name not in STUBS:
        return None
    try:
        return getattr(kernels, name)(**damaged_call(name, rng))
    except DOCUMENTED:
        return None


def damaged_call(name: str, rng: np.random.Generator) -> Call:
    known = calls()[name]
    call = known[rng.integers(len(known))]
    for _ in range(rng.integers(1, 4)):
        paths = list(places(call))
        path = paths[rng.integers(len(paths))]
        call = replaced(call, path, damaged(value_at(call, path), rng))
    return call


def check(example: tuple[str, int]) -> None:
    name, seed = example
    for k in range(CALLS):
        call = damaged_call(name, np.random.default_rng((seed, k)))
        with contextlib.suppress(*DOCUMENTED):
            invoke(name, call)


@pytest.mark.parametrize("name", STUBS)
def test_damaged_arguments_do_no_harm(name: str) -> None:
    assert calls()[name], f"run() does not call {name}"
    for seed in range(EXAMPLES):
        bounded(check, (name, seed))
