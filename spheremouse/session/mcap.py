"""Write a tracked recording as an MCAP file, which Foxglove, Lichtblick and Rerun show.

It has the pictures with their annotations, camera calibration, transforms, a scene in 3-D, the log, and the samples.
All but the samples are of Foxglove's well-known schemas. Stamps are those of the source.
"""

import importlib
import json
from collections.abc import Callable
from io import BufferedWriter
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from spheremouse.errors import ConfigurationError
from spheremouse.files.access import shipped
from spheremouse.geometry import Array
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.output import Report
from spheremouse.output.sample import Sample, to_object
from spheremouse.session.control.jpeg_picture import encode_jpeg
from spheremouse.session.tracker_adapter import FrameResult, TrackerAdapter
from spheremouse.tracker import Status

_MAX_SECONDS = 2**32 - 1  # of a stamp in the well-known schemas
_SCENE_PERIOD_S = 1.0  # between two scenes of the same discs, whose places the tracker refines
_HALF_PIXEL = 0.5  # px from a pixel's centre, the origin of our axes, to its corner, that of Foxglove's
_DISC_GAP_RADII = 0.02  # radii that a drawn disc stands out of the ball
_CIRCLE = np.stack([np.cos(t := np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)), np.sin(t)], axis=1)
_COLOURS = {
    "outline": (1.0, 1.0, 1.0, 0.8),
    "others": (0.7, 0.7, 0.7, 0.8),
    "used": (0.1, 0.9, 0.2, 1.0),
    "unused": (1.0, 0.6, 0.0, 1.0),
    "predicted": (0.2, 0.6, 1.0, 1.0),
    "gate": (0.2, 0.6, 1.0, 0.4),
    "targets": (0.1, 0.9, 0.2, 1.0),
    "strangers": (1.0, 0.9, 0.0, 1.0),
    "masked": (1.0, 0.0, 0.3, 1.0),
    "ball": (0.85, 0.85, 0.85, 1.0),
    "disc": (0.1, 0.1, 0.1, 1.0),
}


def sdk(module: str = "foxglove") -> Any:
    """Return a module of foxglove-sdk. Raise ConfigurationError if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ConfigurationError("export: needs the package foxglove-sdk", "pip install 'spheremouse[mcap]'") from None


class McapWriter:
    """Writes what a run displays. It is a `View` of the loop over recordings."""

    def __init__(self, file: BufferedWriter, run: dict[str, Any]) -> None:
        """Begin the file, with the description of the `run` as metadata. Raise ConfigurationError without the SDK."""
        self._context, self._file = sdk().Context(), _CheckedFile(file)
        options = sdk("foxglove.mcap").MCAPWriteOptions(compression_threads=0)
        self._writer = sdk().open_mcap(self._file, context=self._context, writer_options=options)
        self._writer.write_metadata("spheremouse", {"run": json.dumps(run)})
        self._channels: dict[str, Any] = {}
        self._lines: list[str] = []  # since the last frame
        self._time = 0  # ns, of the last frame
        self._camera: dict[str, Any] | None = None  # as it was written
        self._scene: tuple[int, int] | None = None  # time and number of discs of the written one
        self.frames = 0

    def log(self, text: str) -> None:
        """Write log lines with the time of the next frame."""
        self._lines += text.splitlines()

    def show(self, result: FrameResult, report: Report, adapter: TrackerAdapter) -> None:
        """Write a frame. Raise OSError if it cannot be written."""
        self._time = round(1e9 * min(max(float(result.frame.stamp), 0.0), _MAX_SECONDS))
        self._write_log()
        scene, pointing = adapter.scene(), result.samples[result.pointing]
        self._write_camera(scene["camera"], adapter.camera, pointing.coordinates == "obj")
        image = result.frame.image
        data = encode_jpeg(image if image.ndim == 3 else image[:, :, None])
        self._write("CompressedImage", "/camera/image", frame_id="cam", data=data, format="jpeg")
        annotations = image_annotations(adapter.annotations(result), self._stamp())
        self._channel("ImageAnnotations", "/camera/annotations").log(annotations, log_time=self._time)
        for sample, counts in report.counted:
            self._write_sample(sample, counts)
        self._write_scene(scene, pointing)
        self.frames += 1
        self._file.check()

    def close(self) -> None:
        """Write the end of the file. Raise OSError if that fails."""
        self._write_log()
        self._writer.close()
        self._file.check()

    # ---- parts ----

    def _write_log(self) -> None:
        level = _messages().LogLevel.Info
        for line in self._lines:
            self._write("Log", "/log", level=level, message=line, name="spheremouse")
        self._lines.clear()

    def _write_camera(self, found: dict[str, Any], camera: InteriorOrientation, in_obj: bool) -> None:
        """Write calibration and pose when the scene's camera, `found`, changes. `in_obj`: it has a pose in `obj`."""
        if found == self._camera or found["position"] is None:
            return
        self._camera, K = found, camera.matrix
        matrices = {"K": K, "R": np.eye(3), "P": np.column_stack([K, np.zeros(3)]), "D": camera.distortion}
        interior = {name: matrix.ravel().tolist() for name, matrix in matrices.items()}
        interior |= {"width": camera.width, "height": camera.height, "distortion_model": "plumb_bob"}
        self._write("CameraCalibration", "/camera/calibration", frame_id="cam", **interior)
        if in_obj:
            rotation = np.reshape(found["rotation"], (3, 3)).T
            self._write_transform("/camera/transform", ("obj", "cam"), np.array(found["position"]), rotation)

    def _write_sample(self, sample: Sample, counts: tuple[int, int, int]) -> None:
        topic = f"/ball/{sample.ball}"
        if sample.status is Status.TRACKING:
            ends = sample.coordinates, sample.name
            self._write_transform(f"{topic}/transform", ends, sample.position, sample.rotation)
        message = known_values(to_object(sample, counts))
        topic = f"{topic}/sample"
        if topic not in self._channels:
            data = json.dumps(channel_schema(message["statistics"])).encode()
            schema = sdk().Schema(name="spheremouse.Sample", encoding="jsonschema", data=data)
            self._channels[topic] = sdk().Channel(topic, schema=schema, message_encoding="json", context=self._context)
        self._channels[topic].log(json.dumps(message).encode(), log_time=self._time)

    def _write_scene(self, scene: dict[str, Any], sample: Sample) -> None:
        """Write the ball that points with its discs, and the targets, if there are other discs or at the period."""
        discs = np.reshape(scene["discs"] or [], (-1, 3))
        if self._scene is not None:
            time, number = self._scene
            if len(discs) == number and self._time - time < 1e9 * _SCENE_PERIOD_S:
                return
        self._scene = self._time, len(discs)
        m, radius = _messages(), scene["radius"]
        entity = {"timestamp": self._stamp(), "frame_locked": True}
        size, words = _vector(np.full(3, 2 * radius)), {"billboard": True, "font_size": 12.0, "scale_invariant": True}
        sphere = m.SpherePrimitive(pose=_pose(np.zeros(3)), size=size, color=_colour("ball"))
        cylinders = [_disc(direction, radius, scene["disc_radius"]) for direction in discs]
        entities = [m.SceneEntity(id="ball", frame_id=sample.name, spheres=[sphere], cylinders=cylinders, **entity)]
        labels = [
            m.TextPrimitive(pose=_pose(np.array(t["position"])), text=t["code"], color=_colour("targets"), **words)
            for t in scene["targets"]
        ]
        if labels:
            entities.append(m.SceneEntity(id="targets", frame_id=sample.coordinates, texts=labels, **entity))
        self._channel("SceneUpdate", "/scene").log(m.SceneUpdate(entities=entities), log_time=self._time)

    def _write_transform(self, topic: str, ends: tuple[str, str], position: Array, rotation: Array) -> None:
        """Write the pose of the axes `ends[1]` in the axes `ends[0]`."""
        names = dict(zip(("parent_frame_id", "child_frame_id"), ends, strict=True))
        self._write("FrameTransform", topic, translation=_vector(position), rotation=_quaternion(rotation), **names)

    # ---- channels ----

    def _stamp(self) -> Any:
        return _messages().Timestamp(*divmod(self._time, 10**9))

    def _channel(self, kind: str, topic: str) -> Any:
        if topic not in self._channels:
            made: Callable[..., Any] = getattr(sdk("foxglove.channels"), f"{kind}Channel")
            self._channels[topic] = made(topic, context=self._context)
        return self._channels[topic]

    def _write(self, kind: str, topic: str, **fields: Any) -> None:
        message = getattr(_messages(), kind)(timestamp=self._stamp(), **fields)
        self._channel(kind, topic).log(message, log_time=self._time)


class _CheckedFile:
    """A file for the SDK, which prints errors of writing and panics at a wrong position: `check` raises the first one.

    After an error, also after the file is closed, the SDK writes on into nothing until it has let go of the file.
    """

    def __init__(self, file: BufferedWriter) -> None:
        self._file = file
        self._error: BaseException | None = None
        self._position = self._end = 0  # as if everything had been written

    def write(self, data: bytes) -> int:
        self._try(lambda: self._file.write(data))
        self._position += len(data)
        self._end = max(self._end, self._position)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        self._position = offset + (0, self._position, self._end)[whence]
        self._try(lambda: self._file.seek(self._position))
        return self._position

    def flush(self) -> None:
        self._try(self._file.flush)

    def check(self) -> None:
        if self._error is not None:
            raise self._error

    def _try(self, action: Callable[[], object]) -> None:
        if self._error is None:
            try:
                action()
            except BaseException as e:  # an interrupt, too, since the SDK would drop it
                self._error = e


# ---- samples ----


def known_values(made: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON object of a sample without its unknown values, since viewers know no null."""
    known = {name: value for name, value in made.items() if value is not None}
    return known | {"statistics": {name: v for name, v in made["statistics"].items() if v is not None}}


def channel_schema(statistics: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of samples without null, references, conditions and matrices, which viewers reject.

    `statistics` has the names of a frame's figures. Matrices are in the messages; only their description is missing.
    """
    schema = json.loads(shipped("docs/sample.schema.json"))
    fields = {name: _simplify_field(field, schema["$defs"]) for name, field in schema["properties"].items()}
    fields["statistics"]["properties"] = {name: {"type": "number"} for name in statistics}
    described = {name: field for name, field in fields.items() if field.get("items", {}).get("type") != "array"}
    return {"title": schema["title"], "description": schema["description"], "type": "object", "properties": described}


def _simplify_field(field: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return type, items and description of a sample's field in JSON Schema, without references and null.

    Unknown values are left out of the messages (`known_values`), so none is null.
    """
    content = field
    if "anyOf" in field:
        content = next(choice for choice in field["anyOf"] if choice != {"type": "null"})
    if "$ref" in content:
        content = definitions[content["$ref"].rpartition("/")[2]]
    kind = content.get("type", "string")  # enumerations in `sample.schema.json` have no type
    simple = {"type": kind if isinstance(kind, str) else kind[0]}
    if "items" in content:
        simple["items"] = {"type": content["items"]["type"]}
    return simple | ({"description": field["description"]} if "description" in field else {})


# ---- annotations ----


def image_annotations(marks: dict[str, Any], stamp: Any) -> Any:
    """Return ImageAnnotations of the marks of `TrackerAdapter.annotations`."""
    lines = [_closed_line(np.reshape(points, (-1, 2)), "others", stamp) for points in marks.get("others", [])]
    lines.append(_closed_line(np.reshape(marks["outline"], (-1, 2)), "outline", stamp))
    ellipses = [(disc, disc["shape"], "used" if disc["used"] else "unused") for disc in marks["detected"]]
    ellipses += [(disc, disc["shape"], "predicted") for disc in marks["predicted"]]
    ellipses += [(disc, disc["gate"], "gate") for disc in marks["predicted"]]
    ellipses += [(target, target["shape"], "targets") for target in marks["targets"]]
    ellipses += [(other, [r := other["radius"] ** 2, 0.0, r], "strangers") for other in marks["strangers"]]
    ellipses += [({"x": x, "y": y}, [9.0, 0.0, 9.0], "masked") for x, y in marks["masked"]]
    lines += [_ellipse(*ellipse, stamp) for ellipse in ellipses]
    texts = [_label(mark, kind, stamp) for kind in ("targets", "strangers") for mark in marks[kind]]
    return _messages().ImageAnnotations(points=lines, texts=texts)


def _ellipse(at: dict[str, Any], shape: list[float], colour: str, stamp: Any) -> Any:
    """Return the outline of an ellipse with the shape [xx, xy, yy] px²."""
    xx, xy, yy = shape
    values, vectors = np.linalg.eigh([[xx, xy], [xy, yy]])
    rim = _CIRCLE @ (vectors * np.sqrt(values.clip(0.0))).T
    return _closed_line(rim + np.array([at["x"], at["y"]]), colour, stamp)


def _closed_line(points: Array, colour: str, stamp: Any) -> Any:
    """Return a PointsAnnotation of the polygon through points (n, 2) px, with a colour of `_COLOURS`."""
    m, shade = _messages(), _colour(colour)
    corners, kind = [_point(x, y) for x, y in points.tolist()], m.PointsAnnotationType.LineLoop
    return m.PointsAnnotation(timestamp=stamp, type=kind, points=corners, outline_color=shade, thickness=1.0)


def _label(mark: dict[str, Any], colour: str, stamp: Any) -> Any:
    m = _messages()
    look = {"font_size": 12.0, "text_color": _colour(colour), "background_color": m.Color(a=0.5)}
    return m.TextAnnotation(timestamp=stamp, position=_point(mark["x"], mark["y"]), text=mark["code"], **look)


# ---- geometry ----


def _point(x: float, y: float) -> Any:
    """Return a place in Foxglove's pixels."""
    return _messages().Point2(x=x + _HALF_PIXEL, y=y + _HALF_PIXEL)


def _disc(direction: Array, radius: float, disc_radius: float) -> Any:
    """Return a flat cylinder in ball axes, m, that hides the cap of a disc: from its rim to just above its middle.

    `direction` is the unit vector to the disc's middle. `disc_radius` is along the surface.
    """
    m = _messages()
    across, inner = 2.0 * radius * np.sin(disc_radius / radius), radius * np.cos(disc_radius / radius)
    height = (1.0 + _DISC_GAP_RADII) * radius - inner
    x = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    x /= np.linalg.norm(x)
    rotation = np.array([x, np.cross(direction, x), direction], dtype=float).T
    pose, size = _pose((inner + 0.5 * height) * direction, rotation), m.Vector3(x=across, y=across, z=height)
    return m.CylinderPrimitive(pose=pose, size=size, bottom_scale=1.0, top_scale=1.0, color=_colour("disc"))


def _pose(position: Array, rotation: Array = np.eye(3)) -> Any:  # noqa: B008  it is only read
    return _messages().Pose(position=_vector(position), orientation=_quaternion(rotation))


def _vector(v: Array) -> Any:
    x, y, z = v.tolist()
    return _messages().Vector3(x=x, y=y, z=z)


def _quaternion(rotation: Array) -> Any:
    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return _messages().Quaternion(x=x, y=y, z=z, w=w)


def _colour(name: str) -> Any:
    r, g, b, a = _COLOURS[name]
    return _messages().Color(r=r, g=g, b=b, a=a)


def _messages() -> Any:
    return sdk("foxglove.messages")
