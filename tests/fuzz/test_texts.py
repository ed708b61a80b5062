"""Configuration, rigs, parameters, and names of sources and outputs."""

import contextlib
import io
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from spheremouse.ball.settings import Settings
from spheremouse.capture import open_source
from spheremouse.files import config
from spheremouse.files.rig import load_camera, load_rig, rig_text
from spheremouse.files.yaml import parse_document
from spheremouse.output import open_output
from spheremouse.session.settings import Configuration
from tests.fuzz.fuzzing import file, fuzz, refused
from tests.fuzz.scene import film, known, small_rig, use
from tests.fuzz.strategies import letters, mutated, numbers, words


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
    with contextlib.redirect_stdout(io.StringIO()):
        refused(output)
