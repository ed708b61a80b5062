"""Tables of text, read by pandas."""

import os

import numpy as np
import pandas as pd
import pytest
from reporting import refused
from tables import frame

from spheremouse.errors import OutputError
from spheremouse.output import open_output
from spheremouse.output.columns import columns

# pandas 3 reads every digit without being asked to
EXACT = {} if int(pd.__version__.partition(".")[0]) >= 3 else {"float_precision": "round_trip"}
FULL = pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")


def written(path, *frames):
    with open_output(f"csv:{path}") as output:
        for report in frames:
            output.send(report)
    return read(path)


def read(path):
    return pd.read_csv(path, comment="#", **EXACT)


def names(start, suffixes):
    return [f"{start}_{suffix}" for suffix in suffixes]


@pytest.mark.parametrize("coordinates", ["obj", "cam"])
def test_pandas_reads_every_number_exactly(tmp_path, coordinates):
    frames = [frame(k, coordinates=coordinates, balls=2, pointing=1) for k in range(1, 30)]
    table = written(tmp_path / "a.csv", *frames)
    samples = [sample for report in frames for sample in report.samples]
    upper = np.triu_indices(3)
    pairs = ("xx", "xy", "xz", "yy", "yz", "zz")
    exact = {
        ("stamp",): [[s.stamp] for s in samples],
        ("wall",): [[s.wall] for s in samples],
        ("sequence", "ball"): [[s.sequence, s.ball] for s in samples],
        tuple(names("quaternion", "wxyz")): [s.quaternion for s in samples],
        tuple(names("rate", "xyz")): [s.rate for s in samples],
        tuple(names("increment", "xyz")): [s.increment for s in samples],
        tuple(names("attitude_covariance", pairs)): [s.attitude_covariance[upper] for s in samples],
        tuple(names("rate_covariance", pairs)): [s.rate_covariance[upper] for s in samples],
        tuple(names("count", "xyz")): [c for r in frames for c in ((0, 0, 0), r.counts)],
        ("latency",): [[s.latency] for s in samples],
    }
    if coordinates == "cam":
        exact |= {
            tuple(names("position", "xyz")): [s.position for s in samples],
            tuple(names("velocity", "xyz")): [s.velocity for s in samples],
            tuple(names("position_covariance", pairs)): [s.position_covariance[upper] for s in samples],
        }
    else:
        exact[("discs_used", "discs_seen", "discs_known", "nis")] = [list(s.statistics.values()) for s in samples]
    for group, values in exact.items():
        assert np.array_equal(table[list(group)].to_numpy(), values), group
    assert set(table["status"]) == {"tracking"}
    assert table["confirmed"].dtype == bool
    assert set(table["events"]) == {"turned ball-lost"}
    left = set(table) - {name for group in exact for name in group}
    assert left == {"status", "confirmed", "events"}


def test_each_column_has_its_unit_and_frame_in_the_head(tmp_path):
    written(tmp_path / "a.csv", frame(1))
    head = (tmp_path / "a.csv").read_text().splitlines()
    assert "# rate_x [rad/s, obj]: angular velocity, x" in head
    assert "# quaternion_w [obj from ball]: attitude, a unit quaternion, w" in head
    assert [line[2:].split(" [")[0].split(":")[0] for line in head[1:-2]] == [c.name for c in columns("obj")]


@FULL
def test_a_stream_takes_a_table_without_a_description_of_the_run():
    with pytest.raises(OutputError, match=r"^/dev/full: cannot be written: No space left on device$"):
        written("/dev/full", frame(1))


@pytest.mark.parametrize("spec", ["csv", "csv:", "csv:-"])
def test_a_table_needs_a_file(spec):
    assert refused(spec).endswith("needs a file; write csv:FILE")
