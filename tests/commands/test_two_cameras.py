"""Two cameras of one ball as a person meets them: rigs that are tied, a run of both, status and doctor."""

import csv
import io
import json

import numpy as np
import pytest
from control_world import a_status
from invoking import fail, succeed
from rich.console import Console

from spheremouse.commands import app
from spheremouse.commands.ctl.words import status_table
from spheremouse.commands.doctor import examine, running
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.rig import load_rig, save_rig
from spheremouse.finding import Verdict
from spheremouse.geometry.rotation import align, log
from spheremouse.session.control.status import StatusReport
from spheremouse.session.run_config import CommandLineOverrides


@pytest.mark.slow
def test_two_recordings_are_tied_and_tracked_as_one(tmp_path):
    front, side, tied = (tmp_path / name for name in ("front", "side", "tied.yaml"))
    for film, more in ((front, ()), (side, ("--azimuth", 90, "--late", 0.0167))):
        succeed(app, "simulate", film, "--motion", "play", "--seconds", 8, "--seed", 3, *more)
        save_rig(film.with_suffix(".yaml"), open_dataset(film).rig)
    succeed(app, "calibrate", "tie", "--source", f"dataset:{front}", "--source", f"dataset:{side}", "--out", tied)
    rig, turn = load_rig(tied), open_dataset(side).turn
    found = align(load_rig(tmp_path / "side.yaml").targets.position, rig.targets.position)
    assert np.degrees(np.linalg.norm(log(found @ turn.T))) < 0.05
    table = tmp_path / "motion.csv"
    rigs = ("--rig", f"{front}.yaml", "--rig", tied)
    succeed(app, "track", front, "--beside", side, *rigs, "--output", f"csv:{table}")
    rows = [line for line in table.read_text().splitlines() if not line.startswith("#")]
    stamps = [float(row["stamp"]) for row in csv.DictReader(rows)]
    assert len(stamps) > 1.9 * 8 * 30
    assert stamps == sorted(stamps)
    # each by its own rig; the truth is that of both, in the axes of the first
    succeed(app, "evaluate", front, "--beside", side, "--json", tmp_path / "figures.json")
    result = json.loads((tmp_path / "figures.json").read_text())
    assert (result["dataset"], result["frames"], result["tracked"]) == ("front and side", 480, 480)
    assert result["attitude_rmse_deg"]["combined"] < 0.03
    assert result["nees"]["attitude"] < 3.0
    assert "more than one camera" in fail(app, "evaluate", front, "--beside", side, "--tracker", "ekf1")


@pytest.mark.slow
@pytest.mark.parametrize(("error", "late"), [("sway", 0.0167), ("radius", 0.0167), ("radius", 0.15)])
def test_two_cameras_measure_the_outline_of_a_ball_with_worn_bearings_or_a_wrong_radius(tmp_path, error, late):
    """By discs alone the attitude is 0.1 to 0.3 degrees off. The second camera may begin some frames later."""
    front, side = tmp_path / "front", tmp_path / "side"
    for film, more in ((front, ()), (side, ("--azimuth", 90, "--late", late))):
        swaying = ("--sway", 5) if error == "sway" else ()
        options = ("--motion", "play", "--seconds", 8, "--noise", 4, "--seed", 21, *swaying, *more)
        succeed(app, "simulate", film, *options)
        if error == "radius":
            scene = json.loads((film / "scene.json").read_text())
            scene["ball"]["radius"] += 0.01
            (film / "scene.json").write_text(json.dumps(scene))
    succeed(app, "evaluate", front, "--beside", side, "--json", tmp_path / "figures.json")
    result = json.loads((tmp_path / "figures.json").read_text())
    assert result["tracked"] == 480
    assert result["attitude_rmse_deg"]["combined"] < 0.07


def test_status_and_doctor_name_the_camera_that_takes_no_part():
    part = {"rig": "/rig.yaml", "frames": 7, "restarts": 1, "pose": None}
    both = [
        {**part, "spec": "v4l2:/dev/video0", "description": "/dev/video0: MJPG", "trouble": ""},
        {**part, "spec": "v4l2:/dev/video2", "description": "", "trouble": "no such device"},
    ]
    status = StatusReport.read({**a_status(), "cameras": both})
    out = io.StringIO()
    Console(file=out, width=100).print(status_table(status))
    assert "camera 1  /dev/video0: MJPG, 7 frames " in out.getvalue()
    assert "camera 2  v4l2:/dev/video2, 7 frames: no such device " in out.getvalue()
    found = {f.name: f for f in running.check(status)}
    assert [found[f"camera {k}"].verdict for k in (1, 2)] == [Verdict.OK, Verdict.WARNING]
    assert "no such device" in found["camera 2"].text


@pytest.mark.slow
def test_the_doctor_examines_both_cameras():
    sources = "source=['synthetic:seconds=1', 'synthetic:seconds=1,azimuth=90']"
    found = {
        (section.subject, f.name): f
        for section in examine.examine(CommandLineOverrides(None, (sources, "output=null")), seconds=0.3)
        for f in section.findings
    }
    for subject in ("picture", "picture 2"):
        assert found[subject, "targets"].text.startswith("4 of 4 found")
        assert "seen" in found[subject, "discs"].text
