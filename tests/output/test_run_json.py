"""The description of a run beside its table."""

import json
from datetime import datetime

import pytest
from tables import frame

from spheremouse.errors import OutputError
from spheremouse.output import open_output
from spheremouse.tracker import Status


def described(path, *frames, run=dict):
    with open_output(f"csv:{path}") as output:
        output.begin(run)
        for report in frames:
            output.send(report)
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
