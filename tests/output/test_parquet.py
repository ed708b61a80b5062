"""Parquet tables, read by pyarrow and pandas."""

import numpy as np
import pandas as pd
import pytest
from reporting import refused
from tables import frame, write_and_be_killed

from spheremouse.output import open_output
from spheremouse.output.columns import columns, rows
from spheremouse.tracker import Status

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")


def written(path, *frames):
    with open_output(f"parquet:{path}") as output:
        for report in frames:
            output.send(report)
    assert not path.with_name(f"{path.name}.part").exists()
    return pq.read_table(path)


@pytest.mark.parametrize("coordinates", ["obj", "cam"])
def test_pyarrow_reads_every_value_exactly_and_the_unit_and_frame_of_each_column(tmp_path, coordinates):
    statuses = [Status.SEARCHING, Status.TRACKING, Status.LOST]
    frames = [frame(k, statuses[k % 3], coordinates, balls=2) for k in range(1, 40)]
    table = written(tmp_path / "a.parquet", *frames)
    there = columns(coordinates)
    assert table.column_names == [c.name for c in there]
    expected = [row for report in frames for row in rows(report)]
    assert [list(row.values()) for row in table.to_pylist()] == expected
    for column in there:
        metadata = table.schema.field(column.name).metadata
        assert (metadata[b"unit"], metadata[b"frame"]) == (column.unit.encode(), column.frame.encode())


def test_pandas_reads_numbers_with_nan_where_the_ball_is_not_tracked(tmp_path):
    written(tmp_path / "a.parquet", frame(1), frame(2, Status.LOST))
    table = pd.read_parquet(tmp_path / "a.parquet")
    quaternion = table[[f"quaternion_{axis}" for axis in "wxyz"]].to_numpy()
    assert np.array_equal(quaternion[0], frame(1).samples[0].quaternion)
    assert np.isnan(quaternion[1]).all()
    assert (table["confirmed"].dtype, table["sequence"].dtype) == (bool, np.int64)


@pytest.mark.slow
def test_a_table_that_cannot_be_read_costs_no_row_of_the_part(tmp_path):
    path = tmp_path / "a.parquet"
    write_and_be_killed(f"parquet:{path}", pause=1.1)
    path.write_bytes(b"PAR1 and no more")
    assert "a.parquet: cannot be written: " in refused(f"parquet:{path}")
    path.unlink()
    assert len(written(path)) >= 91


def test_arguments_that_are_none(tmp_path):
    assert refused("parquet:").endswith("needs a file; write parquet:FILE")
    assert refused("parquet:/dev/stdout") == "/dev/stdout: is no regular file; name one, or use csv"
    assert "No such file or directory" in refused(f"parquet:{tmp_path / 'no' / 'a.parquet'}")
