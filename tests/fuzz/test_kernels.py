"""Every native entry point with damaged arguments: no crash, no long call, and no error but a documented one.

The calls come from small runs. Each then gets nan, infinite and huge numbers, empty arrays, other lengths, types and
orders, and indices out of range. The stubs list the entry points, so a new one is called too. `make sanitize` runs this
with the sanitizers.
"""

import ast
import contextlib
import io
import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spheremouse import native
from spheremouse.ball.build import begin, build
from spheremouse.ball.constellation.identify import attitude, shared_rotation
from spheremouse.ball.filters.so3_state import inject
from spheremouse.ball.texture.picture import correlate
from spheremouse.ball.track import step
from spheremouse.commands import app
from spheremouse.geometry.rotation import exp, left_jacobian
from spheremouse.native import kernels
from spheremouse.session.settings import Configuration
from spheremouse.wand.build import build as build_wand
from tests.conftest import directions
from tests.fuzz.fuzzing import EXAMPLES, bounded
from tests.fuzz.test_parameters import CLIP, clip, follow, hand

CALLS = 100  # of an entry point in an example: 200 examples of all are a million
DOCUMENTED = TypeError, ValueError, IndexError
FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, 1e-12, 0.5, -1.0, 3.0, 1e9, -1e300, 1e300)
INTEGERS = (-(2**63), -(2**31) - 1, -(2**31), -1, 0, 1, 2, 3, 7, 255, 2**31 - 1, 2**31, 2**63 - 1)
OTHERS = (None, "text", (), [1.0], b"1", np.zeros(0), np.array(1.0), 1j)
TYPES = ("f4", "f8", ">f8", "i4", "i8", "u1", "c16", "?", "O")

Call = dict[str, Any]


def stubs() -> dict[str, list[str]]:
    """Names of functions, classes and `Class.method`, each with those of its parameters."""
    found = {}
    tree = ast.parse(Path(native.__file__).with_name("kernels.pyi").read_text(encoding="utf-8"))
    for node in tree.body:
        for function in [node, *(node.body if isinstance(node, ast.ClassDef) else ())]:
            if isinstance(function, ast.FunctionDef):
                owner = f"{node.name}." if function is not node else ""
                name = f"{owner}{function.name}".removesuffix(".__init__")
                found[name] = [a.arg for a in function.args.args if a.arg != "self"]
    return found


STUBS = stubs()


@cache
def calls() -> dict[str, list[Call]]:
    """Some calls of each entry point in runs of a ball in its frame and a ball in a hand."""
    found: dict[str, list[Call]] = defaultdict(list)
    count: dict[str, int] = defaultdict(int)

    def record(name: str, *args: Any, **kwargs: Any) -> None:
        count[name] += 1
        if count[name] & (count[name] - 1) == 0:  # 1, 2, 4, 8...: of the whole run
            names = STUBS[name] if "." not in name else ["self", *STUBS[name]]
            found[name].append({k: copied(v) for k, v in (dict(zip(names, args, strict=False)) | kwargs).items()})

    with pytest.MonkeyPatch.context() as patch:
        for name in STUBS:
            if "." not in name:
                patch.setattr(kernels, name, recording(name, getattr(kernels, name), record))
        run()
    return found


def recording(name: str, original: Any, record: Callable[..., None]) -> Any:
    """Return a function or a class like the original one that records its calls."""

    def wrapped(function: Callable[..., Any], name: str) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            record(name, *args, **kwargs)
            return function(*args, **kwargs)

        return call

    if not isinstance(original, type):
        return wrapped(original, name)

    def initialise(self: Any, *args: Any, **kwargs: Any) -> None:
        record(name, *args, **kwargs)
        original.__init__(self, *args, **kwargs)

    methods = [other.partition(".")[2] for other in STUBS if other.startswith(f"{name}.")]
    namespace = {method: wrapped(getattr(original, method), f"{name}.{method}") for method in methods}
    return type(name, (original,), {"__init__": initialise, **namespace})


def run() -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        app(["evaluate", str(CLIP), "--smooth"], standalone_mode=False)
    rig, frames = clip()
    assert rig.pose is not None
    tracker = build(rig, rig.pose, Configuration())
    state = begin(tracker, frames[0].stamp)
    for frame in (*frames[:8], *frames[8::4]):  # after a gap an update is not ordinary
        state = step(state, frame, tracker).state
    inject(state.filter, np.full(len(state.filter.joint), 1e-3))  # as a lone disc's twist does
    patterned = build(rig, rig.pose, Configuration(detector="texture"))
    state = begin(patterned, frames[0].stamp)
    for frame in frames[:8]:
        state = step(state, frame, patterned).state
    learnt = state.search
    correlate(patterned.detector_data.fine, learnt.fine.seen, learnt.fine.picture, learnt.began[None], 50)
    known = directions(12, 0)
    turn = exp(np.array([0.2, -0.1, 0.3]))
    seen = (known @ turn.T)[(known @ turn.T)[:, 2] > 0.2]
    axis = np.array([0.0, 0.0, 1.0])
    assert attitude(seen, known, 0.005, axis, 0.2) is not None
    shared_rotation(known, known @ turn.T, 0.005)
    left_jacobian(np.zeros((2, 3)))
    film, pictures = hand()
    balls = tuple(carried.ball for carried in film.scene.balls)
    follow(build_wand(film.scene.camera, balls), pictures, Configuration())
    # what only tests call
    image, mask = frames[0].image[200:260, 280:360].copy(), np.full((60, 80), 255, np.uint8)
    place = np.array([[40.2, 30.1], [20.0, 20.0]])
    expected = place, np.tile(np.diag([36.0, 25.0]), (2, 1, 1)), np.zeros((2, 7))
    settings = tracker.detector_data.model.fit
    kernels.fit_discs(image, mask, expected, 2.0, settings, settings.contrast, 0.0)
    bounds = np.array([[0, 30, 0.3, 1, 20, 255]], np.float32)
    kernels.grow_glare(image, bounds, np.ones((9, 8), np.float32), 20, 30, 0.5, mask.copy())
    kernels.expected_field(np.full((3, 8), 0.5, np.float32))


def copied(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.copy()
    return tuple(map(copied, value)) if isinstance(value, tuple) else value


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths to all values in a call: arguments, and members of tuples."""
    if path:
        yield path
    members = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, tuple) else ()
    for key, member in members:
        yield from places(member, (*path, key))


def value_at(value: Any, path: tuple[Any, ...]) -> Any:
    return value_at(value[path[0]], path[1:]) if path else value


def replaced(value: Any, path: tuple[Any, ...], new: Any) -> Any:
    if not path:
        return new
    members = dict(value) if isinstance(value, dict) else list(value)
    members[path[0]] = replaced(value[path[0]], path[1:], new)
    return members if isinstance(value, dict) else tuple(members)


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


def invoke(name: str, call: Call) -> Any:
    """Call an entry point; arguments that it may write to stay as they were."""
    arguments = {key: value.copy() if is_plain(value) else value for key, value in call.items()}
    owner, _, method = name.partition(".")
    function = getattr(kernels, owner)
    return getattr(function, method)(arguments.pop("self"), **arguments) if method else function(**arguments)


def is_plain(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.flags.c_contiguous


def check(example: tuple[str, int]) -> None:
    name, seed = example
    for k in range(CALLS):
        call = damaged_call(name, np.random.default_rng((seed, k)))
        with contextlib.suppress(*DOCUMENTED):
            invoke(name, call)


def wrong_kinds(value: np.ndarray) -> Iterator[np.ndarray]:
    """Arrays that no entry point takes in place of this one: another type, order, or number of axes."""
    yield from (np.zeros(value.shape, kind) for kind in TYPES if np.dtype(kind) != value.dtype)
    yield value[None]
    yield np.asarray(value[0]) if len(value) else np.zeros(value.shape[1:], value.dtype)
    doubled = np.repeat(value, 2, axis=-1)
    yield from (a for a in (np.asfortranarray(value), doubled[..., ::2]) if not a.flags.c_contiguous)


@pytest.mark.parametrize("name", STUBS)
def test_damaged_arguments_do_no_harm(name: str) -> None:
    assert calls()[name], f"run() does not call {name}"
    for seed in range(EXAMPLES):
        bounded(check, (name, seed))


@pytest.mark.parametrize("name", STUBS)
def test_a_wrong_type_shape_or_order_is_a_type_error_that_names_the_argument(name: str) -> None:
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
