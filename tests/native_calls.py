"""Calls of every native entry point, recorded in small runs of a ball in its frame and a ball in a hand."""

import ast
import contextlib
import io
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
from spheremouse.ball.texture.picture import correlate, measure_shift
from spheremouse.ball.track import step
from spheremouse.commands import app
from spheremouse.geometry.rotation import exp, left_jacobian
from spheremouse.native import kernels
from spheremouse.session.settings import Configuration
from spheremouse.wand.build import build as build_wand
from tests.conftest import directions
from tests.fuzz.test_parameters import CLIP, clip, follow, hand

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
    correlate(learnt.fine.seen, learnt.fine.picture, learnt.began[None], 50)
    measure_shift(patterned.detector_data.fine, learnt.fine.seen, learnt.fine.picture, learnt.began, 0.01)
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
    kernels.expected_field(np.full((3, 9), 0.5, np.float32))


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


def invoke(name: str, call: Call) -> Any:
    """Call an entry point; arguments that it may write to stay as they were."""
    arguments = {key: value.copy() if is_plain(value) else value for key, value in call.items()}
    owner, _, method = name.partition(".")
    function = getattr(kernels, owner)
    return getattr(function, method)(arguments.pop("self"), **arguments) if method else function(**arguments)


def is_plain(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.flags.c_contiguous
