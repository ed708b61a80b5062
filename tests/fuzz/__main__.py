"""Broken input of every kind: `python -m tests.fuzz [--short] [--seconds S] [--seed S] [--only NAME] [--guided]`.

Files, names of sources and outputs, and parameters may be refused by a SpheremouseError of one message, nothing else.
Pictures and detections may be anything, and the core takes them all without an exception and without a nan. What
hypothesis finds it makes small; the example is printed, and the exit code is 1.

With --guided, and `pip install atheris`, text is made by libFuzzer instead, which looks where in our code it leads:
longer, for control messages, configuration and the files of a device.
"""

import argparse
import contextlib
import importlib.util
import io
import json
import math
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spheremouse import config
from spheremouse.daemon.client import Client
from spheremouse.daemon.control import ControlServer, Limits
from spheremouse.daemon.control_settings import ControlSettings
from spheremouse.daemon.protocol import COMMANDS, BadRequestError, encode
from spheremouse.daemon.protocol import parse as parse_request
from spheremouse.daemon.protocol import refused as refused_reply
from spheremouse.detect.blobs import BlobDetector, BlobSettings
from spheremouse.detect.detections import Detections
from spheremouse.detect.discs import DiscSettings, disc_detector
from spheremouse.detect.rings import RingSettings, detect_targets
from spheremouse.errors import SpheremouseError
from spheremouse.frame import Frame
from spheremouse.output import open_output
from spheremouse.recording import open_dataset, read_frames
from spheremouse.resect import gather, resect
from spheremouse.rig import Rig
from spheremouse.rig_file import load_camera, load_rig, rig_text
from spheremouse.session import initialise
from spheremouse.simulate import SimulationOptions, prepare, simulate
from spheremouse.source import open_source
from spheremouse.track import Settings, advance, begin, build, step
from spheremouse.yaml_file import parse_document

DT = 1.0 / 30.0
CLIP = Path(__file__).parent / "data" / "far26_clip"
ROOT = Path(__file__).parents[1]

# ---- what is broken, and how ----

numbers = st.one_of(
    st.sampled_from([0, -1, 1, 2, 3, 4, 0.5, 255, 256, 1e-12, 1e-300, 1e9, 1e300, -0.0, math.inf, -math.inf, math.nan]),
    st.integers(-100, 100),
    st.floats(-1e3, 1e3),
)
words = st.one_of(
    st.sampled_from(
        ["", "~", "null", "true", "off", "1e3", "0x10", "1_000", ".nan", "-.inf", "[", "{", "- ", ": ", "#"]
    ),
    st.sampled_from(
        ["&a", "*a", "!!python/none", "%", "'", '"', "\t", "|", ">", "---", "2001-01-01", "\ufeff", "\u2028"]
    ),
    st.text(max_size=8),
    numbers.map(str),
)
json_values = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, st.text(max_size=6)),
    lambda inner: st.one_of(st.lists(inner, max_size=5), st.dictionaries(st.text(max_size=4), inner, max_size=3)),
    max_leaves=6,
)


@st.composite
def mutated(draw: st.DrawFn, text: str) -> str:
    """A text with a few of its words, lines or characters changed."""
    for _ in range(draw(st.integers(1, 3))):
        lines = text.split("\n")
        i = draw(st.integers(0, len(lines) - 1))
        tokens = re.split(r"([\s,:\[\]{}]+)", lines[i])
        match draw(st.integers(0, 5)):
            case 0:
                tokens[draw(st.integers(0, len(tokens) - 1))] = draw(words)
                lines[i] = "".join(tokens)
            case 1:
                del lines[i]
            case 2:
                lines.insert(i, lines[draw(st.integers(0, len(lines) - 1))])
            case 3:
                at = draw(st.integers(0, len(lines[i])))
                lines[i] = lines[i][:at] + draw(words) + lines[i][at:]
            case 4:
                lines[i] = " " * draw(st.integers(0, 5)) + lines[i].lstrip()
            case 5:
                lines = lines[: i + 1]
        text = "\n".join(lines)
    return text


@st.composite
def mutated_json(draw: st.DrawFn, tree: Any) -> Any:
    """A tree of plain data with one of its nodes replaced or removed."""
    if not isinstance(tree, dict | list) or not tree or draw(st.integers(0, 5)) == 0:
        return draw(json_values)
    places = list(tree) if isinstance(tree, dict) else list(range(len(tree)))
    place = draw(st.sampled_from(places))
    copy = dict(tree) if isinstance(tree, dict) else list(tree)
    if draw(st.integers(0, 5)) == 0:
        del copy[place]
    else:
        copy[place] = draw(mutated_json(tree[place]))
    return copy


@st.composite
def mutated_bytes(draw: st.DrawFn, data: bytes) -> bytes:
    """Bytes overwritten here and there, or cut short."""
    out = bytearray(data)
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(out) - 1))
        new = draw(st.binary(min_size=1, max_size=8))
        out[at : at + len(new)] = new
    if draw(st.booleans()):
        del out[draw(st.integers(0, len(out))) :]
    return bytes(out)


@st.composite
def pictures(draw: st.DrawFn, width: int | None = None, height: int | None = None) -> NDArray[np.uint8]:
    """Any picture a frame may hold: noise, flats, shapes, real ones cut up; grey or colour, in any layout of memory."""
    w = draw(st.integers(1, 200)) if width is None else width
    h = draw(st.integers(1, 200)) if height is None else height
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    match draw(st.integers(0, 4)):
        case 0:
            image = np.full((h, w, 3), draw(st.tuples(*[st.integers(0, 255)] * 3)), np.uint8)
        case 1:
            image = rng.integers(0, draw(st.integers(1, 256)), (h, w, 3), dtype=np.uint8)
        case 2:
            image = np.full((h, w, 3), draw(st.integers(0, 255)), np.uint8)
            for _ in range(draw(st.integers(1, 60))):
                centre = [int(v) for v in rng.integers(-20, 220, 2)]
                axes = [int(v) for v in rng.integers(0, draw(st.integers(2, 60)), 2)]
                colour = [int(v) for v in rng.choice([0, 40, 128, 220, 255], 3)]
                cv2.ellipse(image, centre, axes, float(rng.uniform(0, 180)), 0, 360, colour, -1, cv2.LINE_AA)
        case 3:
            image = np.kron(rng.integers(0, 256, (h // 8 + 1, w // 8 + 1, 3)), np.ones((8, 8, 1)))[:h, :w]
            image = image.astype(np.uint8)
        case _:
            image = cv2.resize(film()[0].image, (w, h), interpolation=cv2.INTER_AREA)
            image = np.roll(image, [int(v) for v in rng.integers(-30, 30, 2)], axis=(0, 1))
            image = cv2.convertScaleAbs(image, alpha=draw(st.floats(0, 4)), beta=draw(st.floats(-100, 100)))
    image = np.asarray(image, dtype=np.uint8).reshape(h, w, 3)
    match draw(st.integers(0, 4)):
        case 0:
            return np.ascontiguousarray(image[..., 0])
        case 1:
            return image[..., ::-1]  # not contiguous
        case 2:
            image.flags.writeable = False
    return image


@cache
def film() -> list[Frame]:
    """A few frames of the simulated far scene."""
    return [made.frame for made in simulate(prepare(SimulationOptions(seconds=0.2)))]


@cache
def known() -> Rig:
    """The simulated device with the camera's pose."""
    scene = prepare(SimulationOptions()).scene
    return replace(scene.rig(), pose=scene.pose)


@cache
def small_rig() -> Rig:
    """The device filmed at 160x120."""
    scene = prepare(SimulationOptions(size=(160, 120))).scene
    return replace(scene.rig(), pose=scene.pose)


def use(rig: Rig, chosen: Settings, images: list[NDArray[np.uint8]]) -> None:
    """Find the pose and track, as a run with this rig and these settings would."""
    frames = iter([Frame(image, k * DT, k) for k, image in enumerate(images)])
    start = initialise(frames, rig, chosen)
    tracker = build(rig, start.pose, chosen)
    state = begin(tracker, 0.0)
    for frame in start.frames:
        state, motion = step(state, frame, tracker)
        assert np.all(np.isfinite(motion.rotation))


def refused(action: Callable[[], Any]) -> Any:
    """What the action returns, or None where it is refused as a user may be: in lines that say something."""
    try:
        return action()
    except SpheremouseError as e:
        message = str(e)
    assert message.strip(), "an empty message"
    return None


# ---- targets ----

TARGETS: dict[str, Callable[[Any], None]] = {}
STRATEGIES: dict[str, Callable[[], st.SearchStrategy[Any]]] = {}
Check = Callable[[Any], None]


def target(name: str, strategy: Callable[[], st.SearchStrategy[Any]]) -> Callable[[Check], Check]:
    def add(function: Check) -> Check:
        TARGETS[name], STRATEGIES[name] = function, strategy
        return function

    return add


def _file(content: str | bytes, name: str = "file.yaml") -> Path:
    path = Path(name)
    path.write_bytes(content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content)
    return path


@target(
    "configuration",
    lambda: st.one_of(
        st.binary(max_size=60),
        st.text(max_size=60),
        st.text("schema: 1\n-{}[]#&*!|>'\"%@`,?tracker so3.", max_size=40),
        mutated(config.dump_commented(Settings())),
        mutated(config.dump(Settings(), Settings())),
    ),
)
def check_configuration(content: str | bytes) -> None:
    path = _file(content)
    refused(lambda: config.load(path, Settings))
    refused(lambda: load_rig(path))


@target(
    "daemon's configuration",
    lambda: st.one_of(st.text("schema: 1\n-{}[]null.controlcord'/", max_size=60), mutated(_whole_configuration())),
)
def check_whole_configuration(content: str | bytes) -> None:
    path = _file(content)
    found = refused(lambda: config.load(path, _whole()))
    if found is not None:
        assert config.loads(parse_document(config.dump(found, _whole()()), "again"), _whole()) == found


@cache
def _whole() -> type[Any]:
    """The settings of the daemon's file; those of the control socket while there are no others."""
    try:
        from spheremouse.daemon.settings import Configuration
    except ImportError:
        return ControlSettings
    return Configuration


@cache
def _whole_configuration() -> str:
    return config.dump_commented(_whole()())


# ---- control ----

MESSAGES = (
    '{"command": "status", "id": 7}',
    '{"command": "set", "id": "a", "assignments": ["motion.scale_x=2", "so3.acceleration_sigma=0.5"]}',
    '{"command": "record", "seconds": 60.0, "folder": "bug-1", "everything": false}',
    '{"command": "record", "stop": true}',
    '{"command": "snapshot", "file": "a.png"}',
    '{"command": "watch", "interval": 0.5}',
)


@target(
    "control messages",
    lambda: st.one_of(
        st.binary(max_size=60),
        st.sampled_from(MESSAGES).flatmap(lambda m: mutated_json(json.loads(m)).map(json.dumps)),
        st.sampled_from(MESSAGES).flatmap(mutated),
        st.builds("{}{}{}".format, st.sampled_from(["[", '{"a":', '{"command":']), words, st.just("]" * 3)),
        st.builds(
            lambda part, n: part * n, st.sampled_from(["[", '{"a":', "9", "\\", '"', "[[],"]), st.integers(1, 60000)
        ),
    ),
)
def check_message(content: str | bytes) -> None:
    line = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    try:
        request = parse_request(line)
    except BadRequestError as e:
        reply = refused_reply(str(e), e.id)
    else:
        assert request.command in COMMANDS
        for name in (getattr(request, "folder", None), getattr(request, "file", None)):
            assert name is None or Path("/x", name).resolve().parent == Path("/x"), "a name that leads elsewhere"
        return
    assert encode(reply).count(b"\n") == 1, "a message of several lines"
    assert reply["error"]


@target(
    "control socket",
    lambda: st.lists(
        st.one_of(
            st.binary(max_size=30),
            st.sampled_from([b"\n", b'{"command": "status"}\n', b'{"command": "sta', b"[", b"\xff", b"\x00" * 5000]),
            st.sampled_from(MESSAGES).flatmap(mutated).map(lambda m: m.encode("utf-8", "surrogatepass") + b"\n"),
        ),
        max_size=10,
    ),
)
def check_socket(chunks: list[bytes]) -> None:
    """Whatever one client sends, in whatever pieces, the next one is answered."""
    server = _control_server()
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as hostile:
        hostile.settimeout(10.0)
        hostile.connect(str(server.path))
        with contextlib.suppress(ConnectionError):
            for chunk in chunks:
                hostile.sendall(chunk)
        with Client(server.path) as client:
            assert client.ask("status") == {"state": "tracking"}
    assert not _SAID, _SAID


_SAID: list[str] = []


@cache
def _control_server() -> ControlServer:
    return ControlServer(
        Path("control.sock").absolute(),
        ControlSettings(),
        lambda request, reply: reply({"state": "tracking"}),
        _SAID.append,
        Limits(pace=1e6, burst=1e6),
    )


# ---- recordings, sources, pictures ----


@target("rig", lambda: st.one_of(st.binary(max_size=60), mutated(rig_text(known())), mutated(rig_text(small_rig()))))
def check_rig(content: str | bytes) -> None:
    path = _file(content)
    refused(lambda: load_camera(path))
    rig = refused(lambda: load_rig(path))
    if rig is not None and max(rig.camera.width, rig.camera.height) <= 640:
        images = [np.full((rig.camera.height, rig.camera.width, 3), 128, np.uint8)]
        if (rig.camera.width, rig.camera.height) == (640, 480):
            images = [f.image for f in film()[:2]]
        refused(lambda: use(rig, replace(Settings(), pose=replace(Settings().pose, frames=1)), images))


@cache
def _keys() -> list[str]:
    return [".".join(str(k) for k in key) for key, _ in config.parameters(Settings())]


@target(
    "--set",
    lambda: st.lists(
        st.one_of(
            st.text(max_size=30),
            st.builds(
                "{}={}".format, st.sampled_from(_keys()), st.one_of(words, numbers, st.lists(numbers, max_size=5))
            ),
        ),
        min_size=1,
        max_size=3,
    ),
)
def check_set(assignments: list[str]) -> None:
    chosen: Settings | None = Settings()
    for assignment in assignments:
        chosen = refused(lambda a=assignment, c=chosen: config.override(c, a))
        if chosen is None:
            return
    sizes = (chosen.pose.frames, chosen.blobs.masks, chosen.rings.median, chosen.rings.opening, chosen.blobs.median)
    if max(sizes) > 1000 or chosen.blobs.opening > 1000:
        return  # a user's wish for a long wait
    values = [v for _, value in config.parameters(chosen) for v in (value if isinstance(value, tuple) else (value,))]
    if any(isinstance(v, int | float) and v and not 1e-6 <= abs(v) <= 1e6 for v in values):
        return  # double precision ends somewhere: 1e200 squared is no number
    image = film()[0].image
    refused(lambda: use(known(), chosen, [f.image for f in film()[:3]]))
    refused(lambda: detect_targets(image, known().targets.radii, chosen.rings))


@cache
def _dataset() -> dict[str, str | bytes]:
    """A dataset of three tiny frames, file by file."""
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


@target("dataset", _datasets)
def check_dataset(made: dict[str, str | bytes]) -> None:
    folder = Path("dataset")
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    for name, content in made.items():
        _file(content, str(folder / name))
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
def _video() -> bytes:
    """The clip's first frames as a video file."""
    return (CLIP / "video.mkv").read_bytes()[:180_000]


@target("video", lambda: st.one_of(mutated_bytes(_video()), mutated_bytes(_video()[:2000]), st.binary(max_size=100)))
def check_video(content: bytes) -> None:
    path = _file(content, "file.mkv")

    def read() -> None:
        with open_source(f"video:{path}") as frames:
            last = -math.inf
            for frame, _ in zip(frames, range(4), strict=False):
                assert frame.stamp > last
                last = frame.stamp

    refused(read)


_LETTERS = st.characters(exclude_characters="/\\\0", exclude_categories=["Cs"])


@target(
    "source and output",
    lambda: st.one_of(
        st.text(_LETTERS, max_size=20),
        st.builds(
            "{}:{}".format,
            st.sampled_from(["video", "dataset", "text", "null", "spec", "__init__", "_capture"]),
            st.text(_LETTERS, max_size=12),
        ),
        st.builds("opencv:{}".format, st.one_of(st.text(_LETTERS.filter(lambda c: not c.isdigit()), max_size=8))),
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
    ).filter(lambda s: not s.startswith("uinput") and s.partition(":")[2] not in (".", "..")),
)
def check_spec(spec: str) -> None:
    def source() -> None:
        with open_source(spec) as s:
            assert s.live in (True, False)

    def output() -> None:
        with open_output(spec):
            pass

    refused(source)
    with contextlib.redirect_stdout(io.StringIO()):
        refused(output)


@target("pictures of any size", lambda: st.tuples(pictures(), st.integers(0, 3)))
def check_any_picture(drawn: tuple[NDArray[np.uint8], int]) -> None:
    image, shift = drawn
    _sound(BlobDetector(BlobSettings()).detect(image), image)
    if image.ndim == 3:
        radii = np.array([0.012, 0.024, 0.036]) * (1.0, 0.5, 2.0, 10.0)[shift]
        found = detect_targets(image, radii, RingSettings())
        assert np.all(np.isfinite(found.centre))
        assert np.all(found.radius > 0)
        refused(lambda: resect(gather([found] * 2, Settings().pose), small_rig(), image))


@target("pictures of the camera's size", lambda: st.lists(pictures(160, 120), min_size=1, max_size=4))
def check_pictures(images: list[NDArray[np.uint8]]) -> None:
    rig = small_rig()
    assert rig.pose is not None
    for polarity in ("dark", "light"):
        detector = disc_detector(DiscSettings(polarity=polarity, min_area=3.0), rig, rig.pose)
        for image in images:
            _sound(detector.detect(image), image)
    refused(lambda: use(replace(rig, pose=None), Settings(), images))
    use(rig, replace(Settings(), discs=DiscSettings(min_area=3.0)), images)


def _sound(found: Detections, image: NDArray[np.uint8]) -> None:
    n = len(found)
    assert found.centre.shape == (n, 2)
    assert found.covariance.shape == (n, 2, 2)
    assert np.all(np.isfinite(found.centre))
    assert np.all(np.isfinite(found.covariance))
    assert np.all(np.linalg.eigvalsh(found.covariance) > 0)
    assert np.all(found.area > 0)
    assert np.all(found.centre >= -1)
    assert np.all(found.centre <= (image.shape[1], image.shape[0]))


@st.composite
def _sights(draw: st.DrawFn) -> tuple[str, list[tuple[float, Any]]]:
    """A tracker, and stamps with detections: at random, still, or moved along by a few pixels; on the ball and off."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    stamp, uv = draw(st.floats(-1e6, 1e6)), rng.uniform((150, 70), (490, 410), (12, 2))
    sights: list[tuple[float, Any]] = []
    for _ in range(draw(st.integers(1, 40))):
        match draw(st.integers(0, 6)):
            case 0:
                uv = rng.uniform(-2000, 2000, (draw(st.integers(0, 30)), 2))
            case 1:
                uv = rng.uniform((150, 70), (490, 410), (draw(st.integers(0, 40)), 2))
            case 2:
                uv = np.repeat(uv[:3], 3, axis=0)
            case _:
                uv = uv + rng.normal(0, 3, 2)
        stamp += draw(st.sampled_from([DT, DT, DT, DT, 0.0, -DT, 5.0, -5.0, 1e-9, 1e5, -1e5]))
        sights.append((stamp, uv))
    return draw(st.sampled_from(["so3", "so3", "ekf1", "ekf2"])), sights


@target("detections", _sights)
def check_detections(drawn: tuple[str, list[tuple[float, Any]]]) -> None:
    name, sights = drawn
    rig = known()
    assert rig.pose is not None
    tracker = build(rig, rig.pose, Settings(tracker=name))  # pyright: ignore[reportArgumentType]
    state = begin(tracker, sights[0][0])
    for stamp, uv in sights:
        seen = Detections(uv, np.tile(0.01 * np.eye(2), (len(uv), 1, 1)), np.full(len(uv), 50.0))
        state, motion = advance(state, stamp, seen, tracker)
        for values in (motion.rotation, motion.rate, state.filter.attitude, state.filter.covariance):
            assert np.all(np.isfinite(values)), "a number that is not finite"
        assert np.abs(state.filter.attitude @ state.filter.attitude.T - np.eye(3)).max() < 1e-6, "no rotation"


# ---- guided by what of our code is reached ----

SEEDS: dict[str, Callable[[], list[str]]] = {
    "configuration": lambda: [config.dump(Settings(), Settings()), "schema: 1\nso3: {acceleration_sigma: 1}\n"],
    "daemon's configuration": lambda: [config.dump(_whole()(), _whole()()), "schema: 1\n"],
    "control messages": lambda: list(MESSAGES),
    "rig": lambda: [rig_text(small_rig())],
}
GUIDING = ("yaml_file", "validate", "config", "rig_file", "daemon.protocol")  # the modules that are looked into


def guide(name: str, seconds: float, first: int) -> None:
    """Let libFuzzer make input for a target in this process, which it ends: with 0 if nothing was found."""
    import atheris  # pyright: ignore[reportMissingImports]

    with atheris.instrument_imports(include=[f"spheremouse.{m}" for m in GUIDING], enable_loader_override=False):
        loaded = [importlib.reload(importlib.import_module(f"spheremouse.{m}")) for m in GUIDING]
    for name_here, value in list(globals().items()):  # what was imported from them by name
        for module in loaded:
            if getattr(value, "__module__", None) == module.__name__:
                globals()[name_here] = getattr(module, value.__name__)
    corpus = Path("corpus")
    corpus.mkdir(exist_ok=True)
    for k, text in enumerate(SEEDS[name]()):
        (corpus / str(k)).write_text(text, encoding="utf-8")
    words = [
        f"-max_total_time={seconds:.0f}",
        f"-seed={first + 1}",
        "-max_len=20000",
        "-print_final_stats=1",
        str(corpus),
    ]
    atheris.Setup([sys.argv[0], *words], TARGETS[name])
    atheris.Fuzz()


def guided(name: str, seconds: float, first: int) -> tuple[int, str | None]:
    """As `run`, by `guide` in a process of its own."""
    words = [sys.executable, "-m", "tests.fuzz", "--guide", name, "--seconds", str(seconds), "--seed", str(first)]
    here = os.environ | {"TMPDIR": str(Path.cwd())}  # it cannot tidy up
    done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False, cwd=ROOT, env=here)
    count = re.search(r"number_of_executed_units: (\d+)", done.stderr)
    return int(count[1]) if count else 0, None if done.returncode == 0 else (done.stdout + done.stderr)[-5000:]


# ---- the run ----


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without what C libraries write to standard error about broken pictures."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def run(name: str, seconds: float, first: int) -> tuple[int, str | None]:
    """Examples tried in `seconds`, and what the smallest that fails does, if one does."""
    count = 0

    def counted(example: Any) -> None:
        nonlocal count
        count += 1
        TARGETS[name](example)

    end, batch = time.perf_counter() + seconds, 0
    while time.perf_counter() < end:
        options = settings(
            max_examples=25,
            deadline=None,
            database=None,
            print_blob=False,
            phases=(Phase.generate, Phase.shrink),
            suppress_health_check=(HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large),
        )
        told = io.StringIO()
        try:
            with contextlib.redirect_stdout(told), _quiet():
                seed(first * 100_003 + batch)(options(given(STRATEGIES[name]())(counted)))()
        except Exception as e:
            lines = traceback.format_exception(e)
            return count, "".join(lines)[-3000:] + told.getvalue()[-2000:]
        batch += 1
    return count, None


def main() -> int:
    """Fuzz every target for its share of the time; 1 if anything was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--short", action="store_true", help="half a minute in all; otherwise ten minutes")
    parser.add_argument("--seconds", type=float, metavar="S", help="in all")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--only", choices=list(TARGETS), help="one target, with its share of the time")
    parser.add_argument("--guided", action="store_true", help="by atheris, targets of text only; 60 s each unless told")
    parser.add_argument("--guide", choices=list(SEEDS), help=argparse.SUPPRESS)
    args = parser.parse_args()
    names = list(SEEDS) if args.guided else list(TARGETS)
    if args.only is not None and args.only not in names:
        parser.error(f"--guided: {args.only} is not among {', '.join(names)}")
    if args.guided and importlib.util.find_spec("atheris") is None:
        parser.error("--guided needs atheris: pip install atheris")
    share = (args.seconds or (28.0 if args.short else 60.0 * len(names) if args.guided else 600.0)) / len(names)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # broken videos are meant to be broken
    cv2.utils.logging.setLogLevel(0)
    warnings.simplefilter("error", RuntimeWarning)  # what NumPy warns of is on its way to a nan
    failed = 0
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        if args.guide:
            guide(args.guide, args.seconds, args.seed)
        for name in names if args.only is None else (args.only,):
            count, found = (guided if args.guided else run)(name, share, args.seed)
            print(f"{name}: {count} examples, {'FAILED' if found else 'nothing found'}", flush=True)
            if found:
                failed += 1
                print("".join(f"    {line}\n" for line in found.splitlines()), flush=True)
    print("fuzz: " + (f"{failed} of the targets failed" if failed else "nothing was found"))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
