"""Every native entry point is in the stubs, and names an argument of a wrong type, shape or order."""

from collections.abc import Iterator

import numpy as np
import pytest
from native_calls import STUBS, calls, invoke, places, replaced, value_at

from spheremouse.native import kernels

TYPES = ("f4", "f8", ">f8", "i4", "i8", "u1", "c16", "?", "O")


def wrong_kinds(value: np.ndarray) -> Iterator[np.ndarray]:
    """Arrays that no entry point takes in place of this one: another type, order, or number of axes."""
    yield from (np.zeros(value.shape, kind) for kind in TYPES if np.dtype(kind) != value.dtype)
    yield value[None]
    yield np.asarray(value[0]) if len(value) else np.zeros(value.shape[1:], value.dtype)
    doubled = np.repeat(value, 2, axis=-1)
    yield from (a for a in (np.asfortranarray(value), doubled[..., ::2]) if not a.flags.c_contiguous)


def test_a_wrong_type_shape_or_order_is_a_type_error_that_names_the_argument():
    for name in STUBS:
        assert calls()[name], f"run() does not call {name}"
        for call in calls()[name]:
            for path in places(call):
                value = value_at(call, path)
                if not isinstance(value, np.ndarray):
                    continue
                named = rf"^{path[0]}: must be" if len(path) == 1 else r"^\w+: must be"
                for wrong in wrong_kinds(value):
                    with pytest.raises(TypeError, match=named):
                        invoke(name, replaced(call, path, wrong))


def test_the_stubs_have_all_entry_points() -> None:
    functions = {name for name in dir(kernels) if callable(getattr(kernels, name)) and not name.startswith("_")}
    methods = {
        f"{name}.{method}"
        for name in functions
        if isinstance(getattr(kernels, name), type)
        for method in dir(getattr(kernels, name))
        if not method.startswith("_") and callable(getattr(getattr(kernels, name), method))
    }
    assert functions | methods == set(STUBS)
