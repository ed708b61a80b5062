"""An exported recording, read with the `mcap` package, has what the tracker gave and the recording shows."""

import errno
import io
import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from invoking import invoke, succeed
from scipy.spatial.transform import Rotation

import spheremouse as sm
from spheremouse.commands import app
from spheremouse.files.dataset.frames import read_frames

pytest.importorskip("foxglove")
reader = pytest.importorskip("mcap.reader")
decoding = pytest.importorskip("mcap_protobuf.decoder")

CLIP = Path(__file__).parents[1] / "data" / "far26_clip"
PLAIN = {"boolean", "string", "number", "integer"}  # fields and items that Lichtblick's parseJsonSchema accepts


@dataclass
class Contents:
    messages: dict[str, list[Any]] = field(default_factory=dict)
    times: dict[str, list[int]] = field(default_factory=dict)
    schemas: dict[str, Any] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)


def read(path):
    found = Contents()
    with path.open("rb") as file:
        mcap = reader.make_reader(file, validate_crcs=True, decoder_factories=[decoding.DecoderFactory()])
        for schema, channel, message in mcap.iter_messages():
            topic = channel.topic
            factory = decoding.DecoderFactory().decoder_for(channel.message_encoding, schema)
            made = json.loads(message.data) if factory is None else factory(message.data)
            found.messages.setdefault(topic, []).append(made)
            found.times.setdefault(topic, []).append(message.log_time)
            found.schemas[topic] = schema
        found.metadata = {record.name: record.metadata for record in mcap.iter_metadata()}
        assert mcap.get_summary() is not None
    return found


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "clip.mcap"
    succeed(app, "export", CLIP, path)
    return read(path)


@pytest.fixture(scope="module")
def samples():
    return list(sm.track(sm.open_dataset(CLIP)))


def test_topics_have_the_well_known_schemas(exported):
    names = {topic: schema.name for topic, schema in exported.schemas.items()}
    assert names == {
        "/camera/image": "foxglove.CompressedImage",
        "/camera/annotations": "foxglove.ImageAnnotations",
        "/camera/calibration": "foxglove.CameraCalibration",
        "/camera/transform": "foxglove.FrameTransform",
        "/ball/1/transform": "foxglove.FrameTransform",
        "/ball/1/sample": "spheremouse.Sample",
        "/scene": "foxglove.SceneUpdate",
        "/log": "foxglove.Log",
    }
    assert "so3" in exported.metadata["spheremouse"]["run"]


def test_samples_are_those_of_the_tracker(exported, samples):
    read_back = exported.messages["/ball/1/sample"]
    assert [m["sequence"] for m in read_back] == [s.sequence for s in samples]
    np.testing.assert_array_equal([m["rate"] for m in read_back], [s.rate for s in samples])
    np.testing.assert_array_equal([m["statistics"]["nis"] for m in read_back], [s.statistics["nis"] for s in samples])
    assert exported.times["/ball/1/sample"] == [round(1e9 * s.stamp) for s in samples]


def test_samples_keep_to_a_schema_that_viewers_accept(exported):
    schema = json.loads(exported.schemas["/ball/1/sample"].data)
    validator = pytest.importorskip("jsonschema").Draft202012Validator(schema)
    assert all(validator.is_valid(message) for message in exported.messages["/ball/1/sample"])
    assert {"rate", "counts", "statistics"} <= set(schema["properties"])
    assert "nis" in schema["properties"]["statistics"]["properties"]

    def accepted(kind):
        if kind["type"] == "object":
            return all(map(accepted, kind["properties"].values()))
        return (kind["items"] if kind["type"] == "array" else kind)["type"] in PLAIN

    assert accepted(schema)


def test_pictures_are_those_of_the_recording(exported):
    pictures, frames = exported.messages["/camera/image"], list(read_frames(sm.open_dataset(CLIP)))
    assert len(pictures) == len(frames)
    for picture, frame in zip(pictures[::10], frames[::10], strict=True):
        image = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)
        assert np.mean(np.abs(image.astype(float) - frame.image)) < 3.0  # grey values, lost by JPEG


def test_the_discs_of_the_scene_lie_where_the_annotations_are(exported):
    """Scene, transforms and calibration alone project onto the detected discs: all conventions agree."""
    (calibration, *_), (camera, *_) = exported.messages["/camera/calibration"], exported.messages["/camera/transform"]
    assert (camera.parent_frame_id, camera.child_frame_id) == ("obj", "cam")
    R_obj_cam = rotation_of(camera.rotation)
    ball, scene = exported.messages["/ball/1/transform"][-1], exported.messages["/scene"][-1]
    R_obj_ball = rotation_of(ball.rotation)
    (entity,) = [e for e in scene.entities if e.id == "ball"]
    assert entity.frame_id == ball.child_frame_id
    assert rotation_of(entity.spheres[0].pose.orientation).tolist() == np.eye(3).tolist()
    discs = np.array([[p.x, p.y, p.z] for p in (c.pose.position for c in entity.cylinders)])
    height = np.sqrt(entity.spheres[0].size.x ** 2 - entity.cylinders[0].size.x ** 2) / 2  # of the rim's plane
    obj = height * discs / np.linalg.norm(discs, axis=1, keepdims=True) @ R_obj_ball.T
    facing = np.einsum("ni,ni->n", vector(camera.translation) - obj, obj) > 0.0
    points = (obj - vector(camera.translation)) @ R_obj_cam
    distortion, K = np.array(calibration.D), np.reshape(calibration.K, (3, 3))
    projected = cv2.projectPoints(points[facing], np.zeros(3), np.zeros(3), K, distortion)[0].reshape(-1, 2)
    marks = exported.messages["/camera/annotations"][-1]
    targets = [[t.position.x, t.position.y] for t in marks.texts]
    green = [m for m in marks.points if m.outline_color.g > 0.8 and m.outline_color.r < 0.2]
    centres = np.array([np.mean([[p.x, p.y] for p in m.points], axis=0) for m in green])
    used = centres[distances(centres, np.array(targets)).min(axis=1) > 1.0]
    assert len(used) == exported.messages["/ball/1/sample"][-1]["statistics"]["discs_used"]
    off = distances(used, projected + 0.5).min(axis=1)  # px, from our pixel's centre to its corner
    assert np.median(off) < 0.25
    assert off.max() < 3.0  # of a disc that a strut covers


def test_a_wand_has_the_transforms_of_its_balls_in_cam(tmp_path):
    from spheremouse.simulate.to_dataset import write_wand
    from spheremouse.simulate.wand.film import WandOptions, prepare_wand

    film = prepare_wand(WandOptions(motion="hand", seed=1, seconds=0.2, size=(640, 480)))
    list(write_wand(tmp_path / "film", film))
    succeed(app, "export", tmp_path / "film", tmp_path / "wand.mcap")
    found, samples = read(tmp_path / "wand.mcap"), list(sm.track(sm.open_dataset(tmp_path / "film")))
    tracked = [s for s in samples if s.status == "tracking"]
    transforms = found.messages["/ball/1/transform"]
    assert {t.parent_frame_id for t in transforms} == {"cam"}
    np.testing.assert_allclose([vector(t.translation) for t in transforms], [s.position for s in tracked], atol=1e-12)
    rotations = [rotation_of(t.rotation) for t in transforms]
    np.testing.assert_allclose(rotations, [s.rotation for s in tracked], atol=1e-12)
    assert found.messages["/scene"][0].entities[0].spheres[0].size.x == pytest.approx(0.1)
    assert "/camera/transform" not in found.messages


# ---- the file is complete or absent ----


def test_an_existing_file_stays_without_force(tmp_path):
    out = tmp_path / "run.mcap"
    out.write_text("mine")
    code, text = invoke(app, "export", CLIP, out)
    assert (code, out.read_text()) == (2, "mine")
    assert "--force" in text


@pytest.mark.parametrize("error", [errno.ENOSPC, None], ids=["disk full", "interrupted"])
def test_nothing_is_left_of_an_export_that_ends_early(tmp_path, monkeypatch, capfd, error):
    class Ends(io.BufferedWriter):
        def write(self, data):
            if self.tell() > 20_000:
                raise KeyboardInterrupt if error is None else OSError(error, "No space left on device")
            return super().write(data)

    real = os.fdopen
    monkeypatch.setattr(
        os, "fdopen", lambda fd, *mode: Ends(real(fd, *mode).detach()) if mode == ("wb",) else real(fd, *mode)
    )
    code, text = invoke(app, "export", CLIP, tmp_path / "run.mcap")
    assert code == (130 if error is None else 2)
    assert error is None or "run.mcap: cannot be written: No space left on device" in text
    assert list(tmp_path.iterdir()) == []
    assert "McapError" not in capfd.readouterr().err


def test_an_export_that_is_interrupted_between_two_frames_prints_nothing(tmp_path):
    """The SDK ends its file when Python lets go of it, after the file is closed."""
    code = f"""
import sys
from spheremouse import commands
from spheremouse.session.mcap import McapWriter
show = McapWriter.show
def interrupted(self, *arguments):
    if self.frames == 20:
        raise KeyboardInterrupt
    show(self, *arguments)
McapWriter.show = interrupted
sys.argv = ["spheremouse", "export", {str(CLIP)!r}, {str(tmp_path / "run.mcap")!r}]
commands.main()
"""
    ended = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=120)
    assert (ended.returncode, ended.stderr.strip()) == (130, "")
    assert list(tmp_path.iterdir()) == []


def distances(a, b):
    return np.linalg.norm(a[:, None] - b[None], axis=2)


def vector(v):
    return np.array([v.x, v.y, v.z])


def rotation_of(q):
    return Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
