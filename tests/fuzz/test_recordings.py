"""Datasets and films."""

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from hypothesis import strategies as st

from spheremouse.ball.settings import Settings
from spheremouse.calibrate.photos import image, read_photos
from spheremouse.capture import open_source
from spheremouse.commands.wand import read_picture
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from tests.fuzz.fuzzing import file, fuzz, refused
from tests.fuzz.scene import use
from tests.fuzz.strategies import mutated, mutated_bytes, mutated_json

CLIP = Path(__file__).parents[1] / "data" / "far26_clip"


@cache
def _dataset() -> dict[str, str | bytes]:
    scene = json.loads((CLIP / "scene.json").read_text(encoding="utf-8"))
    scene |= {"width": 16, "height": 12, "frames": 3}
    made: dict[str, str | bytes] = {"scene.json": json.dumps(scene, indent=1)}
    for name in ("truth.csv", "discs.csv"):
        rows = (CLIP / name).read_text(encoding="utf-8").splitlines()
        made[name] = "\n".join(r for r in rows if r.partition(",")[0] in ("frame", "0", "1", "2")) + "\n"
    image = np.random.default_rng(0).integers(0, 256, (12, 16, 3), dtype=np.uint8)
    for k in range(3):
        made[f"frames/{k:06d}.png"] = bytes(cv2.imencode(".png", image)[1])
    return made


@st.composite
def _datasets(draw: st.DrawFn) -> dict[str, str | bytes]:
    made = dict(_dataset())
    name = draw(st.sampled_from([*made, "scene.json", "scene.json"]))
    content = made[name]
    if name == "scene.json" and draw(st.booleans()):
        assert isinstance(content, str)
        made[name] = json.dumps(draw(mutated_json(json.loads(content))))
    elif isinstance(content, str) and draw(st.integers(0, 9)):
        made[name] = draw(mutated(content))
    else:
        made[name] = draw(mutated_bytes(content.encode() if isinstance(content, str) else content))
    return made


@fuzz(_datasets)
def test_dataset(made: dict[str, str | bytes]) -> None:
    folder = Path("dataset")
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    for name, content in made.items():
        file(content, str(folder / name))
    recording = refused(lambda: open_dataset(folder))
    if recording is None:
        return
    images = refused(lambda: [frame.image for frame in read_frames(recording)])
    if images:
        small = replace(Settings(), pose=replace(Settings().pose, frames=1))
        refused(lambda: use(recording.rig, small, images))
        if recording.pose is not None:
            refused(lambda: use(replace(recording.rig, pose=recording.pose), small, images))


@cache
def _picture(kind: str) -> bytes:
    image = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    return bytes(cv2.imencode(f".{kind}", image)[1])


@fuzz(
    lambda: st.sampled_from(["png", "jpg", "bmp", "tif"]).flatmap(
        lambda kind: st.tuples(
            st.just(kind), st.one_of(mutated_bytes(_picture(kind)), mutated_bytes(_picture(kind)[:200]))
        )
    )
)
def test_damaged_pictures(drawn: tuple[str, bytes]) -> None:
    """Read a file as a photo, in the wand's colour picker, and as a frame of a dataset."""
    kind, data = drawn
    path = file(data, f"picture.{kind}")
    photos = refused(lambda: read_photos([path], lambda _: None))
    if photos:
        refused(lambda: image(photos[0]))
    refused(lambda: read_picture(path))
    folder = Path("dataset")
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    for name, content in _dataset().items():
        file(data if name == "frames/000000.png" else content, str(folder / name))
    refused(lambda: list(read_frames(open_dataset(folder))))


@cache
def _video() -> bytes:
    return (CLIP / "video.mkv").read_bytes()[:180_000]


@fuzz(lambda: st.one_of(mutated_bytes(_video()), mutated_bytes(_video()[:2000]), st.binary(max_size=100)))
def test_video(content: bytes) -> None:
    path = file(content, "file.mkv")

    def read() -> None:
        with open_source(f"video:{path}") as frames:
            last = -math.inf
            for frame, _ in zip(frames, range(4), strict=False):
                assert frame.stamp > last
                last = frame.stamp

    refused(read)
