"""Parquet tables, read by pyarrow and pandas."""

import json
import sys

import numpy as np
import pandas as pd
import pytest
from reporting import refused
from tables import frame, full_disk, write_and_be_killed

from spheremouse.errors import OutputError
from spheremouse.output import open_output, parquet_part, table
from spheremouse.output.columns import columns, rows
from spheremouse.tracker import Status

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")


@pytest.fixture
def each_row(monkeypatch):
    """Write each row to the part at once, and two to a row group."""
    monkeypatch.setattr(table, "_PERIOD", 0.0)
    monkeypatch.setattr(parquet_part, "_GROUP_ROWS", 2)


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


def test_a_table_is_continued_and_no_other_file_is_written_to(tmp_path, each_row):
    path = tmp_path / "a.parquet"
    for runs in (1, 4, 7):
        table = written(path, *(frame(runs + k) for k in range(3)))
        assert table["sequence"].to_pylist() == [*range(1, runs + 3)]
    with pytest.raises(OutputError, match="exists and has other columns; choose another name or remove it"):
        written(path, frame(10, coordinates="cam"))
    assert pq.read_table(path).equals(table)
    for name in ("a.parquet", "b.parquet.part"):
        (tmp_path / name).write_text("a,b\n1,2\n")
    assert "a.parquet: exists and is no log in this format" in refused(f"parquet:{path}")
    assert "b.parquet.part: exists and is no log in this format" in refused(f"parquet:{tmp_path}/b.parquet")
    assert (tmp_path / "b.parquet.part").read_text() == "a,b\n1,2\n"


def test_a_run_that_is_killed_loses_at_most_a_second_and_is_finished_by_the_next(tmp_path):
    path = tmp_path / "a.parquet"
    write_and_be_killed(f"parquet:{path}", pause=1.1)
    with open(f"{path}.part", "rb") as part:  # as docs/outputs.md reads it
        kept = pa.ipc.open_stream(part).read_all()["sequence"].to_pylist()
    assert len(kept) >= 91  # all before the pause, and the one after it
    assert kept == [*range(1, len(kept) + 1)]
    with open_output(f"parquet:{path}"):
        assert pq.read_table(path)["sequence"].to_pylist() == kept
    assert json.loads((tmp_path / "a.parquet.json").read_text())["runs"][0]["end"] is None
    assert written(path, frame(200))["sequence"].to_pylist() == [*kept, 200]


def test_a_second_run_takes_no_row_from_the_first(tmp_path, each_row):
    path = tmp_path / "a.parquet"
    with open_output(f"parquet:{path}") as first:
        first.send(frame(1))
        line = f"{path}.part: another run writes it; choose another name, or stop that run"
        assert refused(f"parquet:{path}") == line
        first.send(frame(2))
    assert pq.read_table(path)["sequence"].to_pylist() == [1, 2]


@pytest.mark.slow
def test_a_table_that_cannot_be_read_costs_no_row_of_the_part(tmp_path):
    path = tmp_path / "a.parquet"
    write_and_be_killed(f"parquet:{path}", pause=1.1)
    path.write_bytes(b"PAR1 and no more")
    assert "a.parquet: cannot be written: " in refused(f"parquet:{path}")
    path.unlink()
    assert len(written(path)) >= 91


@pytest.mark.parametrize("size", [100, 20_000, 30_001])
def test_a_full_disk_is_one_line_and_leaves_whole_rows(tmp_path, each_row, size):
    path = tmp_path / "a.parquet"
    with full_disk(size), pytest.raises(OutputError, match=r"a\.parquet: cannot be written: File too large$"):
        written(path, *(frame(k) for k in range(1, 40)))
    found = written(path, frame(99))["sequence"].to_pylist()
    assert found == [*range(1, len(found)), 99]
    assert (len(found) > 5) == (size > 10_000)


def test_arguments_that_are_none(tmp_path):
    assert refused("parquet:").endswith("needs a file; write parquet:FILE")
    assert refused("parquet:/dev/stdout") == "/dev/stdout: is no regular file; name one, or use csv"
    assert "No such file or directory" in refused(f"parquet:{tmp_path / 'no' / 'a.parquet'}")


def test_without_pyarrow_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert refused("parquet:a") == "parquet: needs the package pyarrow; pip install 'spheremouse[parquet]'"
