"""Every number of the device's files at its extremes, alone and with others, and devices of any size, in use."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.rings import detect_targets
from spheremouse.ball.rig import Rig, in_metres
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import step
from spheremouse.errors import SpheremouseError
from spheremouse.files import config
from spheremouse.files.rig import load_rig, rig_text
from spheremouse.files.wand import load_wand, wand_text
from spheremouse.files.yaml import parse_document
from spheremouse.tracker import Frame
from spheremouse.wand.build import build as build_wand
from spheremouse.wand.colour import DEFAULT_COLOURS
from tests.fuzz.extremes import USUAL
from tests.fuzz.fuzzing import bounded, file, fuzz, refused
from tests.fuzz.test_parameters import Configuration, as_usual, clip, follow, hand, in_time, sound

SCALES = (1e-6, 1e-3, 0.08, 1.0, 17.0, 1e3, 1.6e6)  # of lengths; the clip's ball has 0.6
MORE = (16_384, 16_385, 8192, 250.0, 1e-5, 1e5, -1e5)  # besides the usual ones

Place = tuple[str | int, ...]
Change = tuple[Place, float]


@cache
def _rig() -> Any:
    rig, _ = clip()
    known = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [-0.6, 0.0, 0.8]])
    rig = replace(rig, disc_directions=known, readout_s=0.01, exposure_s=0.005)
    return _with_sigmas(parse_document(rig_text(rig), "rig").data, rig)


def _with_sigmas(data: Any, rig: Rig) -> Any:
    """The content of a rig file with covariances of camera, ball and targets."""
    camera = {**data["camera"], "covariance": _diagonal([1.0, 1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-6, 1e-6, 1e-4])}
    n = 3 * len(rig.targets.ids)
    data = {**data, "camera": camera, "ball": {**data["ball"], "covariance": _diagonal([1e-6] * 4)}}
    return {**data, "targets_covariance": _diagonal([1e-6] * n), "pose_covariance": _diagonal([1e-6] * 6)}


def _diagonal(values: list[float]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in np.diag(values).tolist())


@cache
def _wand() -> Any:
    film, _ = hand()
    return parse_document(wand_text(film.scene.balls[0].ball, DEFAULT_COLOURS), "wand").data


def _places(tree: Any, at: Place = ()) -> Iterator[tuple[Place, float]]:
    """Where there are numbers, and which."""
    if isinstance(tree, dict | tuple):
        for key, inner in tree.items() if isinstance(tree, dict) else enumerate(tree):
            yield from _places(inner, (*at, key))
    elif isinstance(tree, int | float) and (tree or not str(at).count("covariance")):  # of those, the diagonals
        yield at, tree


def _changes(tree: Any) -> list[Change]:
    found = []
    for place, value in _places(tree):
        whole = isinstance(value, int)
        for v in (*USUAL, *MORE, 0.5 * value, 0.99 * value, 1.01 * value, 2.0 * value, -value):
            found.append((place, int(v) if whole else float(v)))
    return list(dict.fromkeys(found))


@cache
def _rig_changes() -> list[Change]:
    return _changes({k: v for k, v in _rig().items() if k != "schema"})


@cache
def _wand_changes() -> list[Change]:
    return _changes({k: v for k, v in _wand().items() if k != "schema"})


def _changed(tree: Any, place: Place, value: float) -> Any:
    if not place:
        return value
    if isinstance(tree, dict):
        return {**tree, place[0]: _changed(tree[place[0]], place[1:], value)}
    return tuple(_changed(inner, place[1:], value) if k == place[0] else inner for k, inner in enumerate(tree))


def _text(tree: Any) -> str:
    """As YAML on one line."""
    if isinstance(tree, dict):
        return "{" + ", ".join(f"{key}: {_text(value)}" for key, value in tree.items()) + "}"
    return "[" + ", ".join(map(_text, tree)) + "]" if isinstance(tree, tuple) else config.to_yaml(tree)


@fuzz(
    lambda: st.tuples(
        st.sampled_from((1.0, 1.0, 1.0, *SCALES)), st.lists(st.sampled_from(_rig_changes()), min_size=1, max_size=3)
    )
)
def test_rig_numbers(drawn: tuple[float, list[Change]]) -> None:
    _track(*drawn)


@pytest.mark.parametrize("scale", SCALES)
def test_rig_scales(scale: float) -> None:
    bounded(lambda s: _track(s, []), scale)


def _track(scale: float, changes: list[Change]) -> None:
    tree = _rig()
    for place, value in changes:
        tree = _changed(tree, place, value)
    path = file(_text(tree))
    rig = refused(lambda: load_rig(path))
    if rig is None:
        return
    rig = in_metres(rig, scale)
    path = file(rig_text(rig))
    if refused(lambda: load_rig(path)) is not None:
        _in_use(rig)


def _in_use(rig: Rig) -> None:
    camera = rig.camera
    _, film = clip()
    share = max(camera.width * camera.height / film[0].image[..., 0].size, 1.0)
    frames = film[-3:]
    if (camera.width, camera.height) != (640, 480):
        image = np.resize(film[-1].image, (camera.height, camera.width, 3))
        frames = [Frame(image, frame.stamp, frame.sequence) for frame in frames]
    refused(lambda: detect_targets(frames[0].image, rig.targets.radii, Settings().rings))
    assert rig.pose is not None
    tracker = refused(lambda: build(rig, rig.pose, Settings()))
    if tracker is None:
        return
    state = begin(tracker, frames[0].stamp)
    for frame in frames:
        try:
            state, motion, _ = in_time(
                "so3, default", lambda s=state, f=frame: step(s, f, tracker), lambda: as_usual(Configuration()), share
            )
        except SpheremouseError:
            return
        sound(motion)
        assert np.all(np.isfinite(state.filter.covariance))
        assert np.all(np.isfinite(state.filter.attitude))


@fuzz(lambda: st.lists(st.sampled_from(_wand_changes()), min_size=1, max_size=3))
def test_wand_numbers(changes: list[Change]) -> None:
    tree = _wand()
    for place, value in changes:
        tree = _changed(tree, place, value)
    path = file(_text(tree))
    found = refused(lambda: load_wand(path))
    if found is not None:
        film, frames = hand()
        tracker = build_wand(film.scene.camera, (found.ball,), None, found.colours)
        follow(tracker, frames[:2], Configuration())
