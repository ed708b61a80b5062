"""Experiments as a user runs them: whole, cut off and taken up again, with jobs that fail."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import tiny_experiment
import typer
from experiments import NAMES
from experiments import __main__ as cli_experiments
from experiments.kit import run as run_module
from experiments.kit.job import Job, Request
from experiments.kit.run import work_all
from invoking import invoke

app = typer.Typer()
app.command()(cli_experiments.experiments)


@pytest.fixture
def made(tmp_path, monkeypatch):
    folder = tmp_path / "made"
    folder.mkdir()
    monkeypatch.setenv("TINY_MADE", str(folder))
    monkeypatch.setitem(sys.modules, "experiments.tiny", tiny_experiment)
    monkeypatch.setattr(cli_experiments, "NAMES", ("tiny", "poses"))
    return folder


@pytest.fixture
def run(made, tmp_path):
    return partial(invoke, app, "tiny", "--out", tmp_path / "out", "--cores", 2)


def done(made):
    return sorted(int(p.name.partition("-")[0]) for p in made.iterdir())


def test_a_run_that_was_cut_off_goes_on_where_it_stopped(run, made, tmp_path):
    code, said = run("--quick")
    assert code == 0, said
    assert done(made) == [0, 1, 2]
    out = tmp_path / "out"
    text = (out / "experiments.md").read_text()
    assert "`python docs/experiments tiny --quick --out DIR`" in text
    assert "not to be quoted" in text
    assert "## Squares | and more" in text
    assert "| square-2 | 4 | – |" in text
    assert "experiments/squares.svg" in text
    assert "**Other workers**\n\n| others |\n| --- |\n| 3 |" in text  # it ran when all had ended
    jobs = out / "experiments" / "jobs" / "tiny"
    (jobs / "square-1.json").write_text("{")  # cut short
    (jobs / "square-2.json").unlink()
    assert run("--quick") == (code, said)
    assert done(made) == [0, 1, 1, 2, 2]
    run("--quick", "--again")
    assert len(done(made)) == 8


def test_a_run_keeps_the_sections_of_earlier_runs_and_replaces_its_own(run, tmp_path):
    folder = tmp_path / "out" / "experiments"
    folder.mkdir(parents=True)
    (folder / "poses.md").write_text("## Poses of an earlier run\n")
    for options in (["--quick"], []):
        run(*options)
        text = (tmp_path / "out" / "experiments.md").read_text()
        assert text.count("## Squares") == text.count("## Poses of an earlier run") == 1
        assert text.index("## Squares") < text.index("## Poses")
        assert ("--quick" in text) == bool(options)


def test_what_fails_is_told_and_is_tried_again(run, made, tmp_path):
    code, said = run()
    assert code == 1
    assert "failed: tiny/square-3: ValueError: three is too many" in said
    assert "Failed:\n\n- square-3: ValueError: three is too many" in (tmp_path / "out" / "experiments.md").read_text()
    run()
    assert done(made) == [0, 1, 2, 3, 3]


def test_a_process_that_dies_is_said(tmp_path):
    job = Job("gone", tiny_experiment.die)
    assert "process ended" in work_all([job], tmp_path, 1)["gone"]["error"]


LONG = """
import sys
from pathlib import Path
import tiny_experiment
from experiments.kit.job import Job
from experiments.kit.run import work_all
if __name__ == "__main__":
    import signal
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(3))
    jobs = [Job(f"last-{k}", tiny_experiment.last, {"made": sys.argv[1]}) for k in range(2)]
    work_all(jobs, Path(sys.argv[1], "kept"), 2)
"""


def _lives(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def _within(seconds, holds):
    end = time.monotonic() + seconds
    while not holds() and time.monotonic() < end:
        time.sleep(0.05)
    return holds()


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nothing_goes_on_after_a_run_that_was_ended(number, tmp_path):
    script, made = tmp_path / "long.py", tmp_path / "made"
    made.mkdir()
    script.write_text(LONG, encoding="utf-8")
    root = Path(__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (root, root / "tests", root / "docs")))}
    run = subprocess.Popen([sys.executable, script, made], env=environment, stderr=subprocess.DEVNULL)
    workers = []
    try:
        assert _within(60.0, lambda: len(list(made.iterdir())) == 2)
        workers = [int(path.name) for path in made.iterdir()]
        run.send_signal(number)
        assert run.wait(20.0) == (3 if number == signal.SIGTERM else -number)
        assert _within(20.0, lambda: not any(map(_lives, workers)))
    finally:
        run.kill()
        for process in filter(_lives, workers):
            os.kill(process, signal.SIGKILL)


def test_other_parameters_or_another_program_are_another_result(made, tmp_path, monkeypatch):
    job = Job("a", tiny_experiment.square, {"n": 2, "made": str(made)})
    for wanted in (job, job, replace(job, parameters={"n": 5, "made": str(made)})):
        results = work_all([wanted], tmp_path, 1)
    assert results["a"]["n"] == 5
    assert done(made) == [2, 5]
    monkeypatch.setattr(run_module, "program", lambda: "another")
    work_all([replace(job, parameters={"n": 5, "made": str(made)})], tmp_path, 1)
    assert done(made) == [2, 5, 5]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["posse"], "unknown experiment 'posse'; there are tiny, poses"),
        (["--cores", "0"], "--cores: must be 1 or more, is 0"),
        (["--datasets", "/nowhere"], "--datasets: /nowhere: no such folder"),
        (["--out", "/dev/null/x"], "--out /dev/null/x: cannot be made a folder"),
    ],
)
def test_slips_are_refused(run, words, expected):
    code, said = run(*words)
    assert code == 2
    assert said.startswith(expected)


@pytest.mark.parametrize("name", NAMES)
def test_every_experiment_has_jobs_with_keys_of_their_own(name):
    module = cli_experiments.import_module(f"experiments.{name}")
    for quick in (True, False):
        jobs = module.jobs(Request(quick, None))
        keys = [job.key for job in jobs]
        assert len(set(keys)) == len(keys)
        assert all(re.fullmatch(r"[\w.+-]+", key) for key in keys), keys
        assert all(json.loads(json.dumps(job.parameters)) == job.parameters for job in jobs)
    assert len(module.jobs(Request(True, None))) <= len(jobs)
