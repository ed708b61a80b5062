"""Tables of samples: CSV, Parquet, and the description of their run."""

import json
from datetime import datetime

import numpy as np
import pandas as pd
import pytest
from reporting import refused
from tables import frame, full_disk, write_and_be_killed

from spheremouse.errors import OutputError
from spheremouse.output import log_file, open_output, parquet
from spheremouse.output.columns import columns, rows
from spheremouse.output.table import beside
from spheremouse.tracker import Status


@pytest.fixture(params=["csv", "parquet"])
def kind(request, monkeypatch):
    """Write each row at once, and two to a row group."""
    monkeypatch.setattr(log_file, "MAX_WAIT_S", 0.0)
    if request.param == "parquet":
        pytest.importorskip("pyarrow")
        monkeypatch.setattr(parquet, "_GROUP_BATCHES", 2)
    return request.param


def sequences(kind, path):
    read = pd.read_csv(path, comment="#") if kind == "csv" else pd.read_parquet(path)
    return read["sequence"].tolist()


def write(spec, *frames, run=dict):
    with open_output(spec) as output:
        output.begin(run)
        for report in frames:
            output.send(report)


def written(kind, path, *frames):
    write(f"{kind}:{path}", *frames)
    return sequences(kind, path)


def test_a_table_is_continued_and_no_other_file_is_written_to(kind, tmp_path):
    path, other = tmp_path / "a", tmp_path / "b"
    for runs in (1, 4, 7):
        assert written(kind, path, *(frame(runs + k) for k in range(3))) == [*range(1, runs + 3)]
    with pytest.raises(OutputError, match="exists and has other columns; choose another name or remove it"):
        written(kind, path, frame(10, coordinates="cam"))
    assert sequences(kind, path) == [*range(1, 10)]
    other.write_text("a,b\n1,2\n")
    assert refused(f"{kind}:{other}").endswith("; choose another name or remove it")
    assert other.read_text() == "a,b\n1,2\n"


def test_a_second_run_takes_no_row_from_the_first(kind, tmp_path):
    with open_output(f"{kind}:{tmp_path / 'a'}") as first:
        first.send(frame(1))
        line = refused(f"{kind}:{tmp_path / 'a'}")
        assert line.endswith(": another run writes it; choose another name, or stop that run")
        first.send(frame(2))
    assert sequences(kind, tmp_path / "a") == [1, 2]


@pytest.mark.parametrize("frames", [0, 1])
def test_a_description_that_cannot_be_written_is_one_line_with_its_own_path(kind, tmp_path, frames):
    path = tmp_path / f"a.{kind}"
    output = open_output(f"{kind}:{path}").__enter__()
    for k in range(frames):
        output.send(frame(k))
    beside(path).unlink(missing_ok=True)
    beside(path).mkdir()
    with pytest.raises(OutputError, match=r"a\.\w+\.json: (cannot be written: Is|exists and is|is a)"):
        output.close() if frames else output.send(frame(0))


@pytest.mark.parametrize("size", [100, 20_000, 30_001])
def test_a_full_disk_is_one_line_and_leaves_whole_rows(kind, tmp_path, size):
    with full_disk(size), pytest.raises(OutputError, match=r"a\.[\w.]+: cannot be written: File too large$"):
        written(kind, tmp_path / f"a.{kind}", *(frame(k) for k in range(1, 100)))
    found = written(kind, tmp_path / f"a.{kind}", frame(999))
    assert found == [*range(1, len(found)), 999]
    assert (len(found) > 5) == (size > 10_000)


def test_a_run_that_is_killed_loses_at_most_one_wait_and_is_finished_by_the_next(kind, tmp_path):
    path = tmp_path / "a"
    write_and_be_killed(f"{kind}:{path}")
    if kind == "parquet":
        pa = pytest.importorskip("pyarrow")
        with open(f"{path}.part", "rb") as part:  # as docs/outputs.md reads it
            assert len(pa.ipc.open_stream(part).read_all()) >= 91
    kept = written(kind, path)
    assert len(kept) >= 91  # all before the pause, and the one after it
    assert kept == [*range(1, len(kept) + 1)]
    run = json.loads((tmp_path / "a.json").read_text())["runs"][0]
    assert (run["end"], run["source"]) == (None, "a test")
    assert written(kind, path, frame(200)) == [*kept, 200]


def test_a_head_that_was_cut_between_two_lines_is_written_again(tmp_path):
    path = tmp_path / "a.csv"
    assert written("csv", path, frame(1)) == [1]
    whole = path.read_bytes()
    path.write_bytes(b"".join(whole.splitlines(keepends=True)[:3]))
    assert written("csv", path, frame(1)) == [1]
    assert path.read_bytes() == whole


# pandas 3 reads every digit without being asked to
EXACT = {} if int(pd.__version__.partition(".")[0]) >= 3 else {"float_precision": "round_trip"}


def names(start, suffixes):
    return [f"{start}_{suffix}" for suffix in suffixes]


@pytest.mark.parametrize("coordinates", ["obj", "cam"])
def test_pandas_reads_every_number_exactly(tmp_path, coordinates):
    frames = [frame(k, coordinates=coordinates, balls=2, pointing=1) for k in range(1, 30)]
    write(f"csv:{tmp_path / 'a.csv'}", *frames)
    table = pd.read_csv(tmp_path / "a.csv", comment="#", **EXACT)
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
    write(f"csv:{tmp_path / 'a.csv'}", frame(1))
    head = (tmp_path / "a.csv").read_text().splitlines()
    assert "# rate_x [rad/s, obj]: angular velocity, x" in head
    assert "# quaternion_w [obj from ball]: attitude, a unit quaternion, w" in head
    assert [line[2:].split(" [")[0].split(":")[0] for line in head[1:-2]] == [c.name for c in columns("obj")]


def test_a_stream_takes_a_table_without_a_description_of_the_run():
    with pytest.raises(OutputError, match=r"^/dev/full: cannot be written: No space left on device$"):
        write("csv:/dev/full", frame(1))


pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")


def written_parquet(path, *frames):
    write(f"parquet:{path}", *frames)
    assert not path.with_name(f"{path.name}.part").exists()
    return pq.read_table(path)


@pytest.mark.parametrize("coordinates", ["obj", "cam"])
def test_pyarrow_reads_every_value_exactly_and_the_unit_and_frame_of_each_column(tmp_path, coordinates):
    statuses = [Status.SEARCHING, Status.TRACKING, Status.LOST]
    frames = [frame(k, statuses[k % 3], coordinates, balls=2) for k in range(1, 40)]
    table = written_parquet(tmp_path / "a.parquet", *frames)
    there = columns(coordinates)
    assert table.column_names == [c.name for c in there]
    expected = [row for report in frames for row in rows(report)]
    assert [list(row.values()) for row in table.to_pylist()] == expected
    types = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
    for column, field in zip(there, table.schema, strict=True):
        assert field.type == types[column.type]
        unit_and_frame = field.metadata[b"unit"], field.metadata[b"frame"]
        assert unit_and_frame == (column.unit.encode(), column.frame.encode())


@pytest.mark.slow
def test_a_table_that_cannot_be_read_costs_no_row_of_the_part(tmp_path):
    path = tmp_path / "a.parquet"
    write_and_be_killed(f"parquet:{path}")
    path.write_bytes(b"PAR1 and no more")
    assert "a.parquet: cannot be written: " in refused(f"parquet:{path}")
    path.unlink()
    assert len(written_parquet(path)) >= 91


def test_arguments_that_are_none(tmp_path):
    for spec in ("csv", "csv:", "csv:-", "parquet:"):
        assert refused(spec).endswith(f"needs a file; write {spec.partition(':')[0]}:FILE")
    assert refused("parquet:/dev/stdout") == "/dev/stdout: is no regular file; name one, or use csv"
    assert "No such file or directory" in refused(f"parquet:{tmp_path / 'no' / 'a.parquet'}")


def described(path, *frames, run=dict):
    write(f"csv:{path}", *frames, run=run)
    return json.loads(path.with_name(f"{path.name}.json").read_text())


def test_losses_and_missing_frames_are_counted_and_the_verdict_says_so(tmp_path):
    lost = {4, 5, 6, 20, 21}
    frames = [frame(k, Status.LOST if k in lost else Status.TRACKING) for k in range(1, 22) if k not in (10, 11)]
    found = described(tmp_path / "a.csv", *frames, run=lambda: {"source": "a test"})
    assert found["schema"] == 1
    (run,) = found["runs"]
    assert datetime.fromisoformat(run["start"]) <= datetime.fromisoformat(run["end"])
    assert run["losses"] == [
        {"ball": 1, "start": 4 / 30, "end": 7 / 30},
        {"ball": 1, "start": 20 / 30, "end": None},
    ]
    assert (run["rows"], run["rows_tracked"], run["frames_missing"]) == (19, 14, 2)
    assert run["stamps"] == [1 / 30, 21 / 30]
    assert run["source"] == "a test"
    assert run["verdict"] == "14 of 19 rows tracked (73.7 %), lost 2 times, 0.13 s in all; 2 frames are missing"


def test_each_opening_of_a_table_is_a_run(tmp_path):
    for runs in (1, 2, 3):
        found = described(tmp_path / "a.csv", frame(runs))["runs"]
        assert [run["stamps"] for run in found] == [[k / 30, k / 30] for k in range(1, runs + 1)]
    assert found[0]["verdict"] == "1 of 1 rows tracked (100.0 %), never lost"


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": 1, "runs": 3}'])
def test_another_file_is_not_replaced(tmp_path, text):
    (tmp_path / "a.csv.json").write_text(text)
    with pytest.raises(OutputError, match=r"a\.csv\.json: exists and is no description of runs; choose another name"):
        described(tmp_path / "a.csv", frame(1))
    assert (tmp_path / "a.csv.json").read_text() == text
