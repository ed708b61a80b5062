"""Configuration, rigs, parameters, and names of sources and outputs.

The numbers of rig and wand files are also set to extremes, alone and with others. Devices of any size are in use.
"""

import contextlib
import io
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import strategies as st

from spheremouse.ball.build import begin, build
from spheremouse.ball.detect.rings import detect_targets
from spheremouse.ball.rig import Rig, in_metres
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import step
from spheremouse.capture import open_source
from spheremouse.errors import SpheremouseError
from spheremouse.files import config
from spheremouse.files.fictrac import KEYS, read_fictrac
from spheremouse.files.rig import load_camera, load_rig, rig_text
from spheremouse.files.wand import load_wand, wand_text
from spheremouse.files.yaml import parse_document
from spheremouse.output import open_output
from spheremouse.session.settings import Configuration
from spheremouse.tracker import Frame
from spheremouse.wand.build import build as build_wand
from spheremouse.wand.colour import DEFAULT_COLOURS
from tests.fuzz.extremes import USUAL
from tests.fuzz.fuzzing import bounded, file, fuzz, refused
from tests.fuzz.scene import film, known, small_rig, use
from tests.fuzz.strategies import letters, mutated, numbers, words
from tests.fuzz.test_parameters import as_usual, clip, follow, hand, in_time, sound

SCALES = (1e-6, 1e-3, 0.08, 1.0, 17.0, 1e3, 1.6e6)  # of lengths; the clip's ball has 0.6
EXTREMES = (*USUAL, 16_384, 16_385, 8192, 250.0, 1e-5, 1e5, -1e5)
NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?(e-?\d+)?(?![\w.])")


@fuzz(
    lambda: st.one_of(
        st.binary(max_size=60),
        st.text(max_size=60),
        st.text("schema: 2\n-{}[]#&*!|>'\"%@`,?tracker so3.null/", max_size=60),
        mutated(config.dump_commented(Configuration())),
        mutated(config.dump(Settings(), Settings())),
    )
)
def test_configuration(content: str | bytes) -> None:
    """A configuration that is read can be written and read again."""
    path = file(content)
    refused(lambda: load_rig(path))
    found = refused(lambda: config.load(path, Configuration))
    if found is not None:
        text = config.dump(found, Configuration())
        assert config.loads(parse_document(text, "again"), Configuration) == found


@fuzz(lambda: st.one_of(st.binary(max_size=60), mutated(rig_text(known())), mutated(rig_text(small_rig()))))
def test_rig(content: str | bytes) -> None:
    path = file(content)
    refused(lambda: load_camera(path))
    rig = refused(lambda: load_rig(path))
    if rig is not None and max(rig.camera.width, rig.camera.height) <= 640:
        images = [np.full((rig.camera.height, rig.camera.width, 3), 128, np.uint8)]
        if (rig.camera.width, rig.camera.height) == (640, 480):
            images = [f.image for f in film()[:2]]
        refused(lambda: use(rig, replace(Settings(), pose=replace(Settings().pose, frames=1)), images))


FICTRAC = """## FicTrac v2.1.2 config file
c2a_r            : { 0.72, -0.13, -0.46 }
do_display       : y
q_factor         : 6
roi_circ         : { 63, 171, 81, 145, 106, 135 }
roi_ignr         : { { 96, 156, 113, 147, 106, 128 }, { 71, 213, 90, 219, 114, 218 } }
src_fn           : sample.mp4
vfov             : 45
"""


@fuzz(lambda: st.one_of(st.binary(max_size=60), mutated(FICTRAC)))
def test_fictrac(content: str | bytes) -> None:
    """Every value that is read has the form of its key."""
    read = refused(lambda: read_fictrac(file(content)))
    if read is not None:
        assert all(isinstance(number, float) for number in read.values.get("roi_circ", ()))
        assert set(read.values) <= set(KEYS)


@fuzz(
    lambda: st.one_of(
        st.text(letters, max_size=20),
        st.builds(
            "{}:{}".format,
            st.sampled_from(["video", "dataset", "text", "null", "spec", "__init__", "_pixels"]),
            st.text(letters, max_size=12),
        ),
        st.builds("opencv:{}".format, st.one_of(st.text(letters.filter(lambda c: not c.isdigit()), max_size=8))),
        st.builds(
            "synthetic:{}".format,
            st.lists(
                st.builds(
                    "{}={}".format,
                    st.sampled_from(
                        ["motion", "seconds", "noise", "size", "dist", "hands", "dim", "fps", "view", "blur"]
                    ),
                    st.one_of(words, numbers),
                ),
                max_size=3,
            ).map(",".join),
        ),
    ).filter(lambda s: not s.startswith("uinput") and s.partition(":")[2] not in (".", ".."))
)
def test_spec(spec: str) -> None:
    def source() -> None:
        with open_source(spec) as s:
            assert s.live in (True, False)

    def output() -> None:
        with open_output(spec):
            pass

    refused(source)
    with contextlib.redirect_stdout(io.TextIOWrapper(io.BytesIO())):
        refused(output)


@st.composite
def with_extremes(draw: st.DrawFn, text: str) -> str:
    """A file with up to three of its numbers at extremes. Zeros in the rows of a matrix stay."""
    text = re.sub(r" *#.*", "", text)
    for _ in range(draw(st.integers(1, 3))):
        places = [
            found
            for line in re.finditer(r"^(?!schema).*$", text, re.M)
            for found in NUMBER.finditer(text, *line.span())
            if float(found[0]) or "- [" not in line[0]
        ]
        place = draw(st.sampled_from(places))
        whole, value = place[0].lstrip("-").isdigit(), float(place[0])
        new = draw(st.sampled_from((*EXTREMES, 0.5 * value, 0.99 * value, 1.01 * value, 2.0 * value, -value)))
        text = f"{text[: place.start()]}{int(new) if whole else float(new)!r}{text[place.end() :]}"
    return text


@cache
def certain_rig() -> str:
    rig, _ = clip()
    assert rig.pose is not None
    camera = replace(rig.camera, covariance=np.diag([1.0, 1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-6, 1e-6, 1e-4]))
    targets = replace(rig.targets, covariance=1e-6 * np.eye(3 * len(rig.targets.ids)))
    pose, ball = replace(rig.pose, covariance=1e-6 * np.eye(6)), replace(rig.ball, covariance=1e-6 * np.eye(4))
    known = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [-0.6, 0.0, 0.8]])
    parts = {"camera": camera, "targets": targets, "pose": pose, "ball": ball, "disc_directions": known}
    return rig_text(replace(rig, **parts, readout_s=0.01, exposure_s=0.005))


@fuzz(lambda: st.tuples(st.sampled_from((1.0, 1.0, 1.0, *SCALES)), with_extremes(certain_rig())))
def test_rig_numbers(drawn: tuple[float, str]) -> None:
    track(*drawn)


@pytest.mark.parametrize("scale", SCALES)
def test_rig_scales(scale: float) -> None:
    bounded(lambda s: track(s, certain_rig()), scale)


def track(scale: float, text: str) -> None:
    path = file(text)
    rig = refused(lambda: load_rig(path))
    if rig is None:
        return
    path = file(rig_text(in_metres(rig, scale)))
    if refused(lambda: load_rig(path)) is not None:
        in_use(in_metres(rig, scale))


def in_use(rig: Rig) -> None:
    camera, (_, film) = rig.camera, clip()
    share = max(camera.width * camera.height / film[0].image[..., 0].size, 1.0)
    frames = film[-3:]
    if (camera.width, camera.height) != (640, 480):
        image = np.resize(film[-1].image, (camera.height, camera.width, 3))
        frames = [Frame(image, frame.stamp, frame.sequence) for frame in frames]
    refused(lambda: detect_targets(frames[0].image, rig.targets.radii, Settings().rings))
    assert rig.pose is not None
    pose = rig.pose
    tracker = refused(lambda: build(rig, pose, Settings()))
    if tracker is None:
        return
    state = begin(tracker, frames[0].stamp)
    for frame in frames:
        try:
            state, motion, _ = in_time(
                "so3, default",
                lambda s=state, f=frame: step(s, f, tracker),
                lambda: as_usual(Configuration()),
                share,
            )
        except SpheremouseError:
            return
        sound(motion)
        assert np.all(np.isfinite(state.filter.covariance))
        assert np.all(np.isfinite(state.filter.attitude))


@fuzz(lambda: with_extremes(wand_text(hand()[0].scene.balls[0].ball, DEFAULT_COLOURS)))
def test_wand_numbers(text: str) -> None:
    path = file(text)
    found = refused(lambda: load_wand(path))
    if found is not None:
        film, frames = hand()
        follow(build_wand(film.scene.camera, (found.ball,), None, found.colours), frames[:2], Configuration())
