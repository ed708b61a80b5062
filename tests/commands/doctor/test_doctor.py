"""`spheremouse doctor`: each fault is reported with its number and remedy, whatever else is wrong."""

import json
import os
import re
import resource
from dataclasses import replace
from io import BytesIO, TextIOWrapper
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from control_world import a_status
from rich.console import Console

from spheremouse.ball.detect.discs import DiscSettings
from spheremouse.ball.detect.projection import NEGATIVE
from spheremouse.ball.settings import Settings
from spheremouse.commands import findings as report
from spheremouse.commands.doctor import camera, computer, files, running
from spheremouse.commands.doctor import examine as doctor
from spheremouse.commands.doctor import sight as sights
from spheremouse.commands.doctor.camera import Controls, Footage, film
from spheremouse.commands.doctor.private import redactor
from spheremouse.commands.findings import Section
from spheremouse.commands.service import check
from spheremouse.commands.service import systemd as service
from spheremouse.commands.service.systemd import Place
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.rig import save_rig
from spheremouse.finding import Verdict, ok, warning, wrong
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import exp
from spheremouse.session.control.server import ControlServer
from spheremouse.session.control.status import StatusReport
from spheremouse.session.run_config import CommandLineOverrides, read_run_config
from spheremouse.session.settings import ControlSettings, RecordSettings

OK, WARNING, WRONG, UNCHECKED = Verdict.OK, Verdict.WARNING, Verdict.WRONG, Verdict.UNCHECKED
FAR26_RIG = "the source brings its own"


def examined(*assignments, file=None):
    """Findings by subject and name; names that occur twice in lists."""
    found = {}
    for section in doctor.examine(CommandLineOverrides(file, assignments), seconds=1.0):
        for f in section.findings:
            found.setdefault((section.subject, f.name), []).append(f)
    return found


def one(found, subject, name):
    (finding,) = found[subject, name]
    return finding


def filmed(source, seconds):
    """The film of a source, its rig, and the settings."""
    plan = read_run_config(CommandLineOverrides(None, (f"source='{source}'", "output=null")))
    footage = film(plan, seconds, None)
    return footage, footage.rig, plan.configuration


@pytest.fixture(scope="module")
def seen():
    """The ball of a simulated film, with the camera's pose from its targets."""
    footage, rig, settings = filmed("synthetic:seconds=0.2,size=[512,384],noise=2", 0.1)
    pose, _ = sights.targets(footage.views, rig, settings)
    return sights.sight(rig, pose, settings)[0]


def a_film(stamps, sequence=None, **changes):
    n = len(stamps)
    sequence = np.arange(n) if sequence is None else sequence
    return replace(Footage(stamps, stamps + 0.01, sequence, (), 30.0, live=True, stamped=True), **changes)


def test_the_reference_recording_is_well_and_the_discs_are_those_of_its_truth(far26):
    found = examined(f"source=dataset:{far26}")
    assert {f.verdict for (subject, _), all_ in found.items() if subject in ("camera", "picture") for f in all_} <= {
        OK,
        UNCHECKED,
    }
    targets = one(found, "picture", "targets")
    assert targets.values["seen"] == 4
    assert targets.values["residual_px"] < 0.1
    truth = open_dataset(far26).discs
    assert truth is not None
    whole = [np.count_nonzero(truth.state[truth.frame == k] == 3) for k in range(31)]
    partly = [np.count_nonzero(truth.state[truth.frame == k] >= 2) for k in range(31)]
    assert min(whole) - 1 <= one(found, "picture", "discs").values["seen"] <= max(partly) + 4  # bolts look like discs
    contrast = one(found, "picture", "discs").values["contrast"]
    assert 0.5 < contrast < 0.9
    assert f", contrast {contrast:.2f} (" in one(found, "picture", "discs").text
    assert one(found, "configuration", "rig").text == FAR26_RIG
    assert one(found, "picture", "blur").verdict is UNCHECKED  # this camera had no exposure


def test_before_there_is_a_rig_it_says_how_to_begin(tmp_path):
    """Nothing named; then a configuration as it is placed, whose rig comes later."""
    plan, _ = files.read(CommandLineOverrides(), None)
    said = files.rig_file(plan.rig_path, plan.rig, None)
    assert (said.verdict, said.text.partition(":")[0]) == (UNCHECKED, "no rig yet")
    assert "`spheremouse calibrate next`" in said.advice
    config = tmp_path / "config.yaml"
    config.write_text("schema: 2\nsource: synthetic\nrig: rig.yaml\n")
    plan, (said,) = files.read(CommandLineOverrides(config), None)
    assert (said.verdict, said.text) == (WRONG, f"{tmp_path}/rig.yaml: no such file")
    assert "`spheremouse calibrate next`" in said.advice


def test_one_thing_wrong_hides_nothing_else(tmp_path, far26, monkeypatch):
    """Not even a check that fails itself."""

    def broken(*_):
        raise ZeroDivisionError("of its own")

    monkeypatch.setattr(sights, "brightness", broken)
    config = tmp_path / "config.yaml"
    config.write_text(
        f"schema: 2\nsource: dataset:{far26}\nrig: gone.yaml\noutput: teleport\ndiscs: {{contrast: 0.3}}\n"
    )
    found = examined(file=config)
    for subject, name, words in (
        ("configuration", "configuration", "gone.yaml: no such file"),
        ("output", "output", "teleport"),
        ("picture", "brightness", "ZeroDivisionError: of its own"),
    ):
        said = one(found, subject, name)
        assert (said.verdict, words in said.text) == (WRONG, True), said
    assert one(found, "configuration", "rig").verdict is UNCHECKED  # another than the one that is named
    assert one(found, "picture", "targets").verdict is OK  # the recording brings a rig
    assert "0.3 is the least" in one(found, "picture", "discs").text  # the rest of the file holds
    assert ("computer", "disk") in found


def test_a_source_that_gives_nothing_leaves_the_other_subjects(tmp_path):
    found = examined(f"source=dataset:{tmp_path / 'gone'}", "output=text:-")
    assert one(found, "camera", "film").verdict is WRONG
    assert ("picture", "targets") not in found
    assert one(found, "output", "output").verdict is OK


def test_a_recording_that_breaks_off_is_used_as_far_as_it_goes(tmp_path, far26):
    folder = tmp_path / "cut"
    (folder / "frames").mkdir(parents=True)
    scene = json.loads((far26 / "scene.json").read_text())
    (folder / "scene.json").write_text(json.dumps({**scene, "frames": 60}))
    capture = cv2.VideoCapture(str(far26 / "video.mkv"))
    for k in range(12):
        cv2.imwrite(str(folder / "frames" / f"{k:06d}.png"), capture.read()[1])
    found = examined(f"source=dataset:{folder}")
    assert "ends after 12 of 60 frames" in one(found, "camera", "stamps").text
    assert one(found, "picture", "targets").verdict is OK


def test_the_command_says_words_beside_every_sign_and_ends_with_1_where_something_is_wrong(
    spheremouse, tmp_path, far26
):
    out, _ = spheremouse.succeed("doctor", "--source", f"dataset:{far26}", "--output", "text:-")
    assert "✓ ok" in out
    assert out.rstrip().endswith("for a bug report: spheremouse doctor --json")
    code, out, _ = spheremouse("doctor", "--source", f"dataset:{tmp_path}/gone", "--output", "text:-")
    assert (code, "✗ wrong" in out, "1 wrong" in out) == (1, True, True)


def test_the_report_for_others_is_json_without_the_home_folder(spheremouse, tmp_path, far26):
    config = tmp_path / "home" / "cabinet" / "config.yaml"
    config.parent.mkdir(parents=True)
    config.write_text(f"schema: 2\nsource: dataset:{far26}\nrecord: {{folder: {tmp_path}/home/films}}\n")
    code, out, _ = spheremouse("doctor", "--config", config, "--json")
    told = json.loads(out)
    assert told["format"] == report.FORMAT
    assert str(tmp_path / "home") not in out
    texts = {(c["subject"], c["name"]): c for c in told["checks"]}
    assert texts["configuration", "configuration"]["text"] == "~/cabinet/config.yaml"
    assert texts["computer", "disk"]["text"].endswith("~/films")
    assert told["wrong"] == sum(c["verdict"] == "wrong" for c in told["checks"])
    assert texts["picture", "targets"]["values"]["seen"] == 4
    assert code == (1 if told["wrong"] else 0)


def test_a_terminal_without_colour_or_unicode_is_told_the_same_words():
    section = Section("light", (ok("a", "fine"), warning("b", "poor \x1b[31m", "mend it"), wrong("c", "bad")))
    file = TextIOWrapper(BytesIO(), "ascii", errors="replace")
    report.show(section, Console(file=file, width=60))
    file.seek(0)
    text = file.read()
    assert ("\x1b" in text, text.count("?")) == (False, 1)  # that of the steering character
    for words in ("+ ok", "! warning", "X wrong", "-> mend it"):
        assert words in text
    assert str(report.summary([section])) == "1 wrong, 1 warning: mend the faults first, from the top"


def test_a_disc_of_the_least_contrast_stands_out_of_the_noise_from_the_limit_on():
    """The limit is the detector's own: half of the contrast must exceed four standard deviations and a grey value."""
    settings, mask = DiscSettings(), np.full((50, 50), 255, np.uint8)

    def brightness(grey, noise, *projection):
        return sights.brightness([np.full((50, 50), grey, np.uint8)], mask, settings, noise, *projection)

    for noise in (1.0, 4.0):
        least = (4.0 * noise + 1.0) / (0.5 * settings.contrast)
        assert brightness(round(least + 2), noise).verdict is OK
        below = brightness(round(least - 2), noise)
        assert (below.verdict, "more light" in below.advice) == (WARNING, True)
    blown_out = brightness(255, 1.0)
    assert (blown_out.verdict, "shorter exposure" in blown_out.advice) == (WRONG, True)
    dark = np.full((50, 50), 8)
    assert brightness(dark, 1.0).verdict is brightness(dark, 1.0, NEGATIVE).verdict is WRONG
    dark[20:30, 20:30] = 200  # light discs: of theirs the contrast is a part
    assert (brightness(dark, 1.0).verdict, brightness(dark, 1.0, NEGATIVE).verdict) == (WRONG, OK)


def test_blur_is_how_far_the_nearest_point_of_the_ball_goes_while_the_shutter_is_open(seen):
    """By turning that point and projecting it, the exposure in the middle."""
    rig, pose = seen.rig, seen.pose
    towards = pose.position - rig.ball.centre
    towards /= np.linalg.norm(towards)
    exposure = 0.004
    told = sights.blur(seen, exposure, DiscSettings(), known=False)
    turn = np.radians(told.values["at_deg_s"]) * exposure
    assert np.degrees(turn) == pytest.approx(told.values["blur_deg"], abs=1e-3)
    axis = np.cross(towards, pose.rotation[:, 0])
    axis /= np.linalg.norm(axis)
    ends = [rig.ball.centre + rig.ball.radius * exp(s * 0.5 * turn * axis) @ towards for s in (-1.0, 1.0)]
    uv, _ = project(pose.to_cam(np.array(ends)), rig.camera)
    assert np.linalg.norm(uv[1] - uv[0]) == pytest.approx(told.values["blur_px"], rel=0.02)


def test_blur_is_a_matter_of_how_long_the_shutter_is_open(seen):
    settings = DiscSettings()
    longest = 1e-3 * sights.blur(seen, 0.001, settings, known=False).values["longest_ms"]
    assert sights.blur(seen, 0.95 * longest, settings, known=False).verdict is OK
    too_long = sights.blur(seen, 1.1 * longest, settings, known=False)
    assert too_long.verdict is WARNING
    assert sights.blur(seen, 1.1 * longest, settings, known=True).verdict is OK  # it is expected then
    assert sights.blur(seen, 2.2 * longest, settings, known=True).verdict is WARNING
    hopeless = sights.blur(seen, 1.1 * longest / settings.size_tolerance, settings, known=True)
    assert hopeless.verdict is WRONG
    assert "more light" in hopeless.advice
    assert sights.blur(seen, None, settings, known=False).verdict is UNCHECKED


def test_targets_that_moved_against_the_rig_are_told(far26):
    footage, rig, settings = filmed(f"dataset:{far26}", 0.5)

    def targets(change=lambda image: image, rig=rig):
        return sights.targets(tuple(replace(v, image=change(v.image)) for v in footage.views), rig, settings)

    assert targets()[1].verdict is OK
    moved = rig.targets.position.copy()
    moved[0] += (0.03, -0.02, 0.0)
    assert targets(rig=replace(rig, targets=replace(rig.targets, position=moved)))[1].verdict is not OK
    pose, told = targets(sights.grey)
    assert (pose, told.verdict) == (None, UNCHECKED)
    left = np.arange(640)[:, None] < 320
    pose, told = targets(lambda image: np.where(left, np.uint8(90), image))
    assert (pose, told.verdict) == (None, WRONG)
    assert "at least 3 are needed" in told.text


def test_discs_that_are_too_small_or_a_covered_ball_are_told(far26):
    footage, rig, settings = filmed(f"dataset:{far26}", 0.2)
    pose, _ = sights.targets(footage.views, rig, settings)
    small = replace(rig, disc_radius=0.2 * rig.disc_radius)
    assert sights.sight(small, pose, settings)[1].verdict is WRONG
    seen, told = sights.sight(rig, pose, settings)
    assert told.verdict is OK
    covered = tuple(replace(v, image=np.full_like(v.image, 128)) for v in footage.views)
    assert sights.discs(covered, seen, settings.discs).verdict is WRONG
    cause = sights.discs(covered, seen, settings.discs).values["cause"]
    passed = (footage.views[0], *covered[:2])  # the cause is that of a view without discs
    assert sights.discs(passed, seen, settings.discs).values["cause"] == cause
    away = replace(pose, rotation=pose.rotation @ exp(np.array([0.0, np.pi, 0.0])))
    seen, told = sights.sight(rig, away, settings)
    assert (seen, told.verdict) == (None, WRONG)
    wide = files.size(rig.camera, 1280, 720)
    assert (wide.verdict, "camera.size: [640, 480]" in wide.advice) == (WRONG, True)


def test_the_rate_is_the_cameras_own_and_what_was_lost_is_counted():
    every = np.arange(60)
    kept = np.delete(every, [10, 11, 30])
    good = camera.rate(a_film(every / 30.0))
    assert (good.verdict, good.values["fps"], good.values["lost"]) == (OK, 30.0, 0)
    gaps = camera.rate(a_film(kept / 30.0, sequence=kept))
    assert (gaps.verdict, gaps.values["fps"], gaps.values["lost"]) == (WARNING, 30.0, 3)
    slow = camera.rate(a_film(every[:30] / 15.0))
    assert (slow.verdict, slow.values["fps"]) == (WARNING, 15.0)
    assert "exposure" in slow.advice
    assert camera.rate(a_film(every / 30.0, damaged=5)).verdict is WARNING
    few = a_film(every[:3] / 30.0)
    assert camera.rate(few).verdict is WRONG
    assert camera.rate(replace(few, live=False)).verdict is UNCHECKED  # a short recording is no fault of the camera


def test_jitter_is_measured_whatever_frames_are_missing():
    rng = np.random.default_rng(3)
    kept = np.delete(np.arange(200), [5, 50, 51, 52])
    jitter = rng.normal(0.0, 0.8e-3, len(kept))
    for sequence in (kept, np.arange(len(kept))):  # counted by the driver, or by us
        interval, sigma = camera.steadiness(kept / 50.0 + jitter, sequence)
        assert interval == pytest.approx(0.02, rel=1e-3)
        assert sigma == pytest.approx(0.8e-3, rel=0.2)


def test_stamps_that_lie():
    t = np.arange(60) / 30.0
    assert camera.stamps(a_film(t)).verdict is OK
    back = t.copy()
    back[20] = back[18]
    assert camera.stamps(a_film(back)).verdict is WRONG
    rough = t + np.random.default_rng(4).normal(0.0, 4e-3, 60)
    assert camera.stamps(a_film(rough)).verdict is WARNING
    told = camera.stamps(a_film(t, notes=("the driver's stamps lie ahead of the clock",)))
    assert (told.verdict, "ahead of the clock" in told.text) == (WARNING, True)


def test_what_a_camera_does_by_itself_is_a_warning():
    fixed = Controls(0.01, False, False, False, False, 1, False, 30, 100, 0)
    assert {f.verdict for f in camera.controls(fixed)} == {OK}
    for change, name in (
        ({"automatic_exposure": True}, "exposure"),
        ({"automatic_gain": True}, "exposure"),
        ({"automatic_focus": True}, "focus"),
        ({"automatic_white_balance": True}, "white balance"),
        ({"dynamic_rate": True, "automatic_exposure": None}, "frame rate"),
        ({"sharpness": 3}, "sharpening"),
    ):
        (told,) = [f for f in camera.controls(replace(fixed, **change)) if f.verdict is not OK]
        assert (told.name, told.verdict) == (name, WARNING)
        assert "set camera." in told.advice
    flickering = camera.controls(replace(fixed, automatic_exposure=True, mains=0))
    assert {f.name for f in flickering if f.verdict is WARNING} == {"exposure", "mains"}
    words = {f.name: f.text for f in camera.controls(fixed)}
    assert (words["focus"], words["mains"]) == ("fixed, at 30", "filter 50 Hz")
    assert "camera.zoom: 100" in words["zoom"]
    assert camera.controls(Controls())[0].verdict is UNCHECKED


def test_the_rig_and_its_age(tmp_path, far26):
    rig, path = open_dataset(far26).rig, tmp_path / "rig.yaml"
    save_rig(path, rig, {"date": "2020-01-31"})
    told = files.rig_file(path, rig, None)
    assert (told.verdict, told.values["age_days"] > 1000, "calibrated" in told.text) == (OK, True, True)
    save_rig(path, rig)
    assert "written just now" in files.rig_file(path, rig, None).text
    os.utime(path, (4e9, 4e9))
    told = files.rig_file(path, rig, None)
    assert "set this computer's clock" in told.advice
    assert re.search(r": written \d+ days from now; 4 targets", told.text)
    assert "just now" not in told.text
    assert files.rig_file(None, None, None).verdict is UNCHECKED
    map_file = tmp_path / "rig.map.yaml"
    assert files.map_of(map_file, rig, Settings()).verdict is OK  # made as the ball turns
    map_file.write_text("schema: 1\nnonsense: 2\n")
    assert files.map_of(map_file, rig, Settings()).verdict is WARNING


def test_without_a_word_the_daemons_or_the_services_configuration_is_looked_at(tmp_path):
    """What the daemon was told on its command line comes before the service's file."""
    config = Place(tmp_path).configuration / "config.yaml"
    assert files.usual(CommandLineOverrides(), None) == CommandLineOverrides()
    config.parent.mkdir(parents=True)
    config.write_text("schema: 2\n")
    assert files.usual(CommandLineOverrides(), None).file == config
    other = tmp_path / "other.yaml"
    other.write_text("schema: 2\n")
    status = StatusReport.read(a_status(config=str(other)))
    assert files.usual(CommandLineOverrides(), status).file == other
    assert files.usual(CommandLineOverrides(None, ("source=video:a",)), status).file is None
    for kept in (None, "/m.yaml"):
        settings = (
            "source='v4l2:/dev/video0'",
            "output=['uinput:third=wheel']",
            "rig='/r.yaml'",
            *([f"map='{kept}'"] if kept else []),
        )
        usual = files.usual(CommandLineOverrides(), StatusReport.read(a_status(config=None, rig="/r.yaml", map=kept)))
        assert usual == CommandLineOverrides(None, settings, no_map=kept is None)


def test_map_and_recordings_of_the_service_are_where_the_service_keeps_them(tmp_path, far26):
    place = Place(tmp_path)
    rig, config = place.configuration / "rig.yaml", place.configuration / "config.yaml"
    config.parent.mkdir(parents=True)
    save_rig(rig, open_dataset(far26).rig)
    for file, more, expected in (
        (config, "", place.state / "rig.map.yaml"),
        (config, "map: mine.yaml\n", place.configuration / "mine.yaml"),
        (config.with_name("own.yaml"), "", place.configuration / "rig.map.yaml"),
    ):
        file.write_text(f"schema: 2\nsource: v4l2:0\noutput: uinput\nrig: rig.yaml\n{more}")
        plan, found = files.read(CommandLineOverrides(file), None)
        assert ([f.verdict for f in found], plan.map_path) == ([OK], expected)
    assert f"in {place.state}/recordings" in computer.disk(RecordSettings(), place.state).text
    assert str(place.state) not in computer.disk(RecordSettings(folder=str(tmp_path)), place.state).text


@pytest.mark.parametrize(
    ("change", "name", "verdict"),
    [
        ({}, None, OK),
        ({"state": "lost"}, "state", WARNING),
        ({"state": "paused"}, "state", WARNING),
        ({"state": "no-camera"}, "state", WRONG),
        ({"skipped": 50000}, "frames", WARNING),
        ({"dropped": 50000}, "frames", WARNING),
        ({"latency_ms": {"p50": 9.0, "p99": 40.0, "max": 50.0}}, "latency", WARNING),
        ({"discs": 2}, "points", WARNING),
        ({"outputs": [{**a_status()["outputs"][0], "failed": "gone; plug it in"}]}, "sending", WRONG),
    ],
)
def test_what_the_daemon_says_of_itself(change, name, verdict):
    found = running.check(StatusReport.read(a_status(**change)))
    assert {f.name for f in found if f.verdict is not OK} == ({name} if name else set())
    assert all(f.verdict is verdict for f in found if f.name == name)


def test_a_daemon_that_runs_keeps_its_camera(tmp_path_factory, monkeypatch):
    path = Path(tmp_path_factory.mktemp("s")) / "c"
    monkeypatch.setattr(doctor.capture, "probe", lambda spec: [])
    monkeypatch.setattr(camera, "film", lambda *_: pytest.fail("the camera was opened"))
    status = a_status(source={"spec": "v4l2:/dev/video7", "description": ""}, version=running.__version__)
    with ControlServer(path, ControlSettings(), lambda pending: pending.answer(status)):
        sections = {
            s.subject: s.findings
            for s in doctor.examine(CommandLineOverrides(None, ("source=v4l2:7", "output=null")), socket=path)
        }
    (told,) = [f for f in sections["camera"] if f.name == "film"]
    assert told.verdict is UNCHECKED
    assert "stop" in told.advice
    assert [f.verdict for f in sections["daemon"] if f.name in ("daemon", "state", "frames")] == [OK, OK, OK]


def test_a_daemon_of_another_version_is_to_be_started_anew(tmp_path_factory):
    path = Path(tmp_path_factory.mktemp("s")) / "c"
    with ControlServer(path, ControlSettings(), lambda pending: pending.answer(a_status(version="0.0.1"))):
        status, told = running.ask(path)
    assert (status.version, told.verdict) == ("0.0.1", WARNING)
    status, told = running.ask(path)
    assert (status, told.verdict) == (None, OK)


def test_the_service_and_what_is_missing_of_it(tmp_path, monkeypatch):
    place = Place(tmp_path)
    assert check.installed(None, tmp_path)[0].text.startswith("not installed")
    for action in list(service.install(place, service.executable(place)[0])):
        action.do()
    told = {"ActiveState": "active", "SubState": "running", "Result": "success", "NRestarts": "0"}
    shown = lambda: SimpleNamespace(stdout="\n".join(f"{key}={value}" for key, value in told.items()))  # noqa: E731
    monkeypatch.setattr(check.subprocess, "run", lambda *_, **__: shown())
    assert {f.verdict for f in check.installed(None, tmp_path)} == {OK}
    told["NRestarts"] = "4"
    assert WARNING in {f.verdict for f in check.installed(None, tmp_path)}
    told |= {"ActiveState": "failed", "Result": "watchdog"}
    (failed,) = [f for f in check.installed(None, tmp_path) if f.verdict is WRONG]
    assert "watchdog" in failed.text
    assert "journalctl -u spheremouse.service" in failed.advice
    told.clear()
    place.link.unlink()
    found = {f.name: f for f in check.installed(None, tmp_path)}
    assert "enable" in found["service files"].advice
    assert found["service"].verdict is UNCHECKED
    node = tmp_path / "video0"
    node.write_text("")
    monkeypatch.setattr(check, "USER", "nobody-has-this-name")
    assert WRONG in {f.verdict for f in check.installed(node, tmp_path)}


def test_room_memory_and_rights(tmp_path, monkeypatch):
    assert computer.disk(RecordSettings(folder=str(tmp_path), megabytes=1.0, free_megabytes=0.0)).verdict is OK
    full = computer.disk(RecordSettings(folder=str(tmp_path / "not" / "yet"), megabytes=1e12))
    assert full.verdict is WARNING
    info = tmp_path / "meminfo"
    info.write_text("MemTotal: 4000000 kB\nMemAvailable: 100000 kB\n")
    assert computer.memory(info).verdict is WARNING
    info.write_text("MemTotal: 4000000 kB\nMemAvailable: 3000000 kB\n")
    assert computer.memory(info).values == {"free_mb": 3072}
    assert computer.memory(tmp_path / "none").verdict is UNCHECKED
    status = tmp_path / "status"
    status.write_text("CapEff:\t0000000000000000\n")
    monkeypatch.setattr(resource, "getrlimit", lambda which: (0, 0))
    assert computer.scheduling(False, status).verdict is WARNING
    assert computer.scheduling(True, status).verdict is OK
    monkeypatch.setattr(resource, "getrlimit", lambda which: (10, 10))
    assert computer.scheduling(False, status).verdict is OK


USB = "usb-046d_HD_Pro_Webcam_C920_8F2A77BF-video-index0"


@pytest.mark.parametrize(
    ("told", "kept"),
    [
        ("/home/ada/rig.yaml: no such file", "~/rig.yaml: no such file"),
        ("/home/adam/rig.yaml", "~/rig.yaml"),
        ("/data/home/ada2", "/data/home/ada2"),
        ("ada may use /dev/video0 (ada)", "USER may use /dev/video0 (USER)"),
        ("cabinet7 and cabinet7.example.org", "HOST and HOST"),
        (
            f"v4l2:/dev/v4l/by-id/{USB.replace('8F2A77BF', 'B83C11AA')}",
            "v4l2:/dev/v4l/by-id/usb-046d_HD_Pro_Webcam_C920_B8…-video-index0",
        ),  # a number that nobody told
        (f"v4l2:/dev/v4l/by-id/{USB}", "v4l2:/dev/v4l/by-id/usb-046d_HD_Pro_Webcam_C920_8F…-video-index0"),
        ("serial:auto,id=E6614C311B", "serial:auto,id=E6…"),
        ("adapter of the adaptive kind", "adapter of the adaptive kind"),
    ],
)
def test_names_and_numbers_of_the_computer_are_taken_out(told, kept):
    clean = redactor("/home/ada", "ada", "cabinet7.example.org", ["E6614C311B", "8F2A77BF"])
    assert clean(told) == kept
    assert clean(clean(told)) == kept
    assert clean({"a": [told, 3, None]}) == {"a": [kept, 3, None]}


def test_who_called_sudo_is_taken_out_too(monkeypatch):
    monkeypatch.setenv("SUDO_USER", "ada")
    assert redactor("/root", None, "cabinet7", [])("/run/media/ada/rig.yaml") == "/run/media/USER/rig.yaml"
