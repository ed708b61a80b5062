"""Bounds: every number that a person may write has two, and what lies within them works together."""

import pytest
from invoking import refusal

from spheremouse.errors import ConfigurationError
from spheremouse.files import config
from spheremouse.files.device import DeviceFile
from spheremouse.files.disc_map import MapFile
from spheremouse.files.picture_map import PictureMapFile
from spheremouse.files.rig.models import CameraFile, RigFile
from spheremouse.files.wand import WandModel
from spheremouse.geometry.camera import MAX_PIXELS, MAX_SIDE, too_large
from spheremouse.session.settings import Configuration
from spheremouse.wand.settings import ColourSettings

FREE = ("provenance",)  # sections for people, which nothing reads
FILES = RigFile, CameraFile, MapFile, PictureMapFile, WandModel, DeviceFile


def unbounded(schema, defs, path=""):
    """Paths of a JSON schema to numbers without a bound on either side, and to lists without a greatest length."""
    if "$ref" in schema:
        schema = defs[schema["$ref"].rpartition("/")[2]]
    for name, inner in schema.get("properties", {}).items():
        if name not in FREE:
            yield from unbounded(inner, defs, f"{path}.{name}")
    for kind in ("anyOf", "prefixItems"):
        for inner in schema.get(kind, ()):
            yield from unbounded(inner, defs, path)
    for inner in (schema.get("items"), schema.get("additionalProperties")):
        if isinstance(inner, dict):
            yield from unbounded(inner, defs, f"{path}[]")
    low, high = {"minimum", "exclusiveMinimum"}, {"maximum", "exclusiveMaximum"}
    number = schema.get("type") in ("number", "integer") and "enum" not in schema
    if number and not (low & set(schema) and high & set(schema)):
        yield path
    if schema.get("type") == "array" and "maxItems" not in schema:
        yield f"{path} (its length)"


@pytest.mark.parametrize("model", [*map(config.model_of, (Configuration, ColourSettings)), *FILES])
def test_every_number_has_a_bound_on_both_sides_and_every_list_a_greatest_length(model):
    schema = model.model_json_schema()
    assert len(schema["properties"]) > 1 or "camera" in schema["properties"]
    assert list(unbounded(schema, schema.get("$defs", {}))) == []


def test_the_defaults_lie_within_their_bounds():
    assert config.override(Configuration(), "so3.acceleration_sigma=0.1") == Configuration()
    whole = [
        f"{'.'.join(map(str, key))}={config.to_yaml(value)}"
        for key, value in config.parameters(Configuration())
        if key != ("output",)
    ]
    assert config.in_force(None, whole, Configuration) == Configuration()


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("discs.contrast=1e9", "must be at most 1, is 1000000000.0"),
        ("discs.masks=[[0, 0, 1e6, 9]]", "discs.masks[0][2]: must be at most "),
        (f"wand.balls={['a'] * 9}", "must be a list of at most 8, is a list of 9"),
        ("wand.particles=1000000", "must be at most 5000"),
        ("pose.frames=100000", "must be at most 100"),
        ("blobs.area=[400, 300]", "blobs: area: give [F_min, F_max]; 400 is above 300"),
        ("rings.cyan=[105, 75]", "rings: cyan: 105 is above 75"),
        ("discs.masks=[[10, 0, 5, 5]]", "discs: masks: give [left, top, right, bottom]"),
        ("discs.masks=[[1, 2, 3, 4, 5]]", "discs: masks: give 4 edges of a rectangle, or x and y of each corner"),
        (f"discs.masks=[{[1] * 66}]", "must be a list of at most 64, is a list of 66"),
        ("camera.size=[16384, 16384]", "camera: size: 16384x16384 is more than can be worked on"),
    ],
)
def test_what_would_not_work_is_refused_in_one_line(assignment, says):
    assert says in refusal(ConfigurationError, config.override, Configuration(), assignment)


@pytest.mark.parametrize(
    "assignments",
    [
        ["camera.size=[7680, 4320]", "camera.fps=1000"],  # 8K, a fast camera
        ["camera.size=[160, 120]", "camera.fps=1", "pose.frames=1"],
        ["motion.counts_per_mm=200", "motion.scale_z=0.05"],
        ["so3.acceleration_sigma=5", "discs.contrast=0.1"],
        ["loss.lost_after=5", "loss.reset_after=60"],
        ["wand.farthest=15", "wand.particles=2000"],
    ],
)
def test_what_is_sensible_is_taken(assignments):
    assert config.in_force(None, assignments, Configuration) != Configuration()


def test_pictures_may_be_as_large_as_8k_and_not_endless():
    assert not too_large(7680, 4320)
    assert not too_large(MAX_SIDE, MAX_PIXELS // MAX_SIDE)
    assert too_large(MAX_SIDE + 1, 1)
    assert too_large(MAX_SIDE, MAX_PIXELS // MAX_SIDE + 1)
