"""A sample as JSON: it is the estimate, digit by digit; unknown values are null."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tables import frame

from spheremouse.output import Report
from spheremouse.output.lines import json_lines
from spheremouse.output.sample import Sample, from_object, to_json, to_object
from spheremouse.tracker import Status

SEEDS = st.integers(0, 2**32 - 1)


def estimate(seed, status=Status.TRACKING):
    statistics = {"discs_used": 5, "chi2": float("nan")}
    return frame(seed, status).samples[0].estimate._replace(statistics=statistics)


@pytest.mark.parametrize("held", [False, True])
@given(SEEDS)
def test_every_number_reads_back_exactly_and_a_ball_in_a_hand_has_a_position_too(held, seed):
    e, coordinates = estimate(seed), "cam" if held else "obj"
    read = json.loads(to_json(Sample(e, 2, "blue", coordinates, ("ball-lost",), 1.7e9, 0.01), (1, -2, 3)))
    exact = {
        "sequence": seed, "stamp": e.stamp, "wall": 1.7e9, "latency": 0.01, "ball": 2, "name": "blue",
        "coordinates": coordinates, "status": "tracking", "confirmed": True, "events": ["ball-lost"],
        "statistics": {"discs_used": 5, "chi2": None}, "counts": [1, -2, 3], "rate": e.rate[:3].tolist(),
        "increment": e.increment[:3].tolist(), "attitude_covariance": e.covariance[:3, :3].tolist(),
        "rate_covariance": e.covariance[6:9, 6:9].tolist(),
        "increment_covariance": e.increment_covariance[:3, :3].tolist()
    }  # fmt: skip
    if held:
        assert len(read.pop("yaw_pitch_roll")) == 3
        exact |= {"position": e.position.tolist(), "velocity": e.rate[3:].tolist(), "shift": e.increment[3:].tolist()}
        exact["position_covariance"] = e.covariance[3:6, 3:6].tolist()
    w, x, y, z = read.pop("quaternion")
    assert read == exact
    assert w >= 0.0
    assert np.allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), e.rotation, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("status", [Status.SEARCHING, Status.LOST])
def test_a_ball_that_is_not_tracked_has_no_attitude(status):
    read = json.loads(to_json(Sample(estimate(1, status)), (0, 0, 0)))
    assert read["status"] == str(status)
    assert read["quaternion"] is read["rate"] is read["attitude_covariance"] is None


def test_the_counts_are_those_of_the_ball_that_points():
    samples = tuple(Sample(estimate(k), k + 1, coordinates="cam") for k in range(3))
    lines = [json.loads(line) for line in json_lines(Report((4, 5, 6), None, 0.0, samples, pointing=1))]
    assert [line["counts"] for line in lines] == [[0, 0, 0], [4, 5, 6], [0, 0, 0]]
    assert [line["ball"] for line in lines] == [1, 2, 3]


def test_outputs_with_the_same_counts_share_a_text():
    sample = Sample(estimate(1))
    text = to_json(sample, (1, 2, 3))
    assert to_json(sample, (1, 2, 3)) is text
    assert json.loads(to_json(sample, (4, 5, 6))) == json.loads(text) | {"counts": [4, 5, 6]}


def read_back(sample):
    return from_object(json.loads(to_json(sample, (0, 0, 0))))


@pytest.mark.parametrize("status", Status)
@pytest.mark.parametrize("coordinates", ["obj", "cam"])
@given(SEEDS)
def test_the_object_of_a_sample_is_that_of_the_sample_read_from_it(coordinates, status, seed):
    sample = Sample(estimate(seed, status), 2, "blue", coordinates, ("ball-lost", "map-begun"), 1.7e9, 0.01)
    there, again = (to_object(s, (0, 0, 0)) for s in (sample, read_back(sample)))
    for key in ("quaternion", "yaw_pitch_roll"):  # these alone are rounded
        one, other = there.pop(key, None), again.pop(key, None)
        assert (one is None) == (other is None)
        assert one is None or np.allclose(one, other, rtol=0.0, atol=1e-9)
    assert there == again


@pytest.mark.parametrize(
    "change",
    [
        {"status": "asleep"},
        {"stamp": None},
        {"quaternion": [1.0, 0.0, 0.0]},
        {"quaternion": [0.0, 0.0, 0.0, 0.0]},
        {"rate": [1.0, 2.0, "fast"]},
        {"rate": [1.0, 2.0, 1e999]},
        {"statistics": [1]},
        {"events": 3},
    ],
)
def test_another_object_is_refused(change):
    with pytest.raises(ValueError, match="no JSON object of a sample"):
        from_object(to_object(Sample(estimate(1)), (0, 0, 0)) | change)


SCHEMA = json.loads((Path(__file__).parents[2] / "docs" / "sample.schema.json").read_text())
accepted = pytest.importorskip("jsonschema").Draft202012Validator(SCHEMA).is_valid


@given(SEEDS, st.sampled_from(Status), st.sampled_from(["obj", "cam"]), st.sampled_from([None, 1.7e9]))
def test_the_schema_accepts_every_sample(seed, status, coordinates, time):
    made = Sample(estimate(seed, status), coordinates=coordinates, wall=time, latency=time, events=("ball-lost",))
    assert accepted(json.loads(to_json(made, (1, -2, 3))))


def test_the_schema_refuses_other_objects():
    good = json.loads(to_json(Sample(estimate(1), coordinates="cam"), (1, -2, 3)))
    assert accepted(good)
    assert not any(accepted({k: v for k, v in good.items() if k != key}) for key in good)
    bad = {"quaternion": [-1.0, 0, 0, 0], "rate": [0, 0], "coordinates": "ball", "counts": [0.5, 0, 0], "more": 1}
    assert not any(accepted(good | {key: value}) for key, value in bad.items())


def test_the_docs_list_every_key():
    page = (Path(__file__).parents[2] / "docs" / "samples.md").read_text()
    listed = re.findall(r"^\| `(\w+)` \|", page, re.M)
    assert sorted(listed) == sorted(SCHEMA["properties"])
