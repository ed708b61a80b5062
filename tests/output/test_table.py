"""Tables of both kinds: continued, written by one run, and whole after a full disk or a kill."""

import json

import pandas as pd
import pytest
from reporting import refused
from tables import frame, full_disk, write_and_be_killed

from spheremouse.errors import OutputError
from spheremouse.output import open_output, parquet, table


@pytest.fixture(params=["csv", "parquet"])
def kind(request, monkeypatch):
    """Write each row at once, and two to a row group."""
    monkeypatch.setattr(table, "_PERIOD", 0.0)
    if request.param == "parquet":
        pytest.importorskip("pyarrow")
        monkeypatch.setattr(parquet, "_GROUP_BATCHES", 2)
    return request.param


def sequences(kind, path):
    read = pd.read_csv(path, comment="#") if kind == "csv" else pd.read_parquet(path)
    return read["sequence"].tolist()


def written(kind, path, *frames):
    with open_output(f"{kind}:{path}") as output:
        for report in frames:
            output.send(report)
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


@pytest.mark.parametrize("size", [100, 20_000, 30_001])
def test_a_full_disk_is_one_line_and_leaves_whole_rows(kind, tmp_path, size):
    with full_disk(size), pytest.raises(OutputError, match=r"a\.\w+: cannot be written: File too large$"):
        written(kind, tmp_path / f"a.{kind}", *(frame(k) for k in range(1, 100)))
    found = written(kind, tmp_path / f"a.{kind}", frame(999))
    assert found == [*range(1, len(found)), 999]
    assert (len(found) > 5) == (size > 10_000)


def test_a_run_that_is_killed_loses_at_most_a_second_and_is_finished_by_the_next(kind, tmp_path):
    path = tmp_path / "a"
    write_and_be_killed(f"{kind}:{path}", pause=1.1)
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
