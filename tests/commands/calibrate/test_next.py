"""`calibrate init` and `next`: from the empty folder to the running mouse, left and continued at any point."""

import json
import shlex
import shutil
from functools import partial

import cv2
import numpy as np
import pytest
from invoking import fail, succeed

from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.calibrate.board import Pattern, save_board
from spheremouse.calibrate.guide import checklist as checklist_module
from spheremouse.calibrate.guide.checklist import checklist
from spheremouse.calibrate.outputs import sha256
from spheremouse.calibrate.photos import BOARD_ENOUGH, DEVICE_ENOUGH, read_photos
from spheremouse.commands import app
from spheremouse.files.device import UNTOUCHED, device_template, load_device
from spheremouse.files.rig import save_camera, save_rig
from spheremouse.geometry.camera import InteriorOrientation

SIZE = (64, 48)
CAMERA = InteriorOrientation(*SIZE, 60.0, 60.0, 31.5, 23.5)
NAMES = [
    "folder", "print", "photos of the board", "camera.yaml", "device.yaml", "photos of the device", "rig.yaml", "axes",
    "service"
]  # fmt: skip
run, refused = partial(succeed, app, "calibrate"), partial(fail, app, "calibrate")


def printed(folder):
    (folder / "print").mkdir()
    save_board(folder / "print" / "board.yaml", Pattern())


def photograph(folder, n, first=0, size=SIZE):
    for k in range(first, first + n):
        pixels = np.random.default_rng(k).integers(0, 256, (size[1] // 8, size[0] // 8, 3)).astype(np.uint8)
        cv2.imwrite(str(folder / f"{k}.png"), cv2.resize(pixels, size))


def provenance(folder):
    found = {"photos": [{"file": str(p.path), "sha256": p.sha256} for p in read_photos([folder], note=lambda _: None)]}
    sources = [p for p in (folder.parent / "camera.yaml", folder.parent / "device.yaml") if folder.name == "device"]
    return found | {p.stem: {"sha256": sha256(p)} for p in sources}


def make_camera(folder, **more):
    save_camera(folder / "camera.yaml", CAMERA, {**provenance(folder / "board"), **more})


def make_rig(folder, made=None):
    targets = Targets((1, 2, 3), ("MCY", "CYM", "YMC"), np.eye(3), np.zeros((9, 9)), np.array([0.01, 0.02, 0.03]))
    save_rig(folder / "rig.yaml", Rig(CAMERA, Ball(0.6), targets, 0.02), made)


def fill_in(folder):
    path = folder / "device.yaml"
    path.write_text(path.read_text(encoding="utf-8").replace(UNTOUCHED + "\n", ""), encoding="utf-8")


def next_of(folder):
    steps = checklist(folder, [folder.parent / "service"])
    states = [s.state for s in steps]
    k = states.index("next")
    assert set(states[:k]) <= {"done", "too few", "not needed"}
    assert states.count("next") == 1
    assert all(not s.todo and not s.command for s in steps if s.state in {"done", "too few", "not needed"})
    return steps[k]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A working folder without printed pages."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def cabinet(tmp_path):
    folder = tmp_path / "my cabinet"
    run("init", folder)
    printed(folder)
    return folder


@pytest.fixture
def finished(cabinet):
    photograph(cabinet / "board", BOARD_ENOUGH)
    make_camera(cabinet)
    fill_in(cabinet)
    photograph(cabinet / "device", DEVICE_ENOUGH, 100)
    make_rig(cabinet, provenance(cabinet / "device"))
    (cabinet / "config.yaml").write_text("schema: 2\nmotion: {player: left}\n")
    assert next_of(cabinet).name == "service"
    return cabinet


def test_a_calibration_from_nothing_to_the_mouse(tmp_path, monkeypatch):
    """Each step is done as its own words say, and leads to the next one."""
    folder = tmp_path / "my cabinet"
    step = next_of(folder)
    assert shlex.split(step.command) == ["spheremouse", "calibrate", "init", str(folder)]
    run(*shlex.split(step.command)[2:])

    step = next_of(folder)
    assert step.name == "print"
    monkeypatch.setattr("spheremouse.calibrate.prints.page.pdf", lambda *_: b"the slow part")
    run(*shlex.split(step.command)[2:], "--only", "boards")
    assert (folder / "print" / "board.yaml").exists()

    step = next_of(folder)
    assert step.name == "photos of the board"
    assert shlex.split(step.command) == ["spheremouse", "calibrate", "photos", str(folder), "--for", "camera"]
    photograph(folder / "board", BOARD_ENOUGH)

    step = next_of(folder)
    words = shlex.split(step.command)
    assert words[2:4] == ["camera", str(folder / "board")]
    assert words[4:] == ["--board", "11x8", "--square", "20mm", "--out", str(folder / "camera.yaml")]
    assert "--for camera" in step.otherwise[0][1]  # more photos, if these do not suffice
    make_camera(folder)

    step = next_of(folder)
    assert (step.name, step.found) == ("device.yaml", "not filled in yet")
    assert "rolling" in step.otherwise[0][1]
    fill_in(folder)

    step = next_of(folder)
    assert (step.name, step.found) == ("photos of the device", "none yet")
    assert shlex.split(step.command) == ["spheremouse", "calibrate", "photos", str(folder), "--for", "device"]
    assert "rolling" in step.otherwise[1][1]
    assert ",width=64,height=48" in step.otherwise[1][1]  # the mode that was calibrated
    photograph(folder / "device", DEVICE_ENOUGH, 100)

    words = shlex.split(next_of(folder).command)
    assert words[2:4] == ["device", str(folder / "device")]
    files = [str(folder / f"{name}.yaml") for name in ("device", "camera", "rig")]
    assert words[4:] == ["--device", files[0], "--camera", files[1], "--out", files[2]]
    make_rig(folder, provenance(folder / "device"))

    step = next_of(folder)
    assert (step.name, step.found) == ("axes", "not asked yet")
    configuration = folder / "config.yaml"
    config, rig = str(configuration), str(folder / "rig.yaml")
    assert shlex.split(step.command)[:6] == ["spheremouse", "axes", "--config", config, "--rig", rig]
    configuration.write_text("schema: 2\n# rig: other.yaml\n")
    step = next_of(folder)
    assert (step.name, step.found) == ("axes", "config.yaml does not have the player's place")
    assert shlex.split(step.command)[:6] == ["spheremouse", "axes", "--config", config, "--rig", rig]
    configuration.write_text("schema: 2\nsource: v4l2:/dev/video7\n")  # as `photos` leaves it
    assert shlex.split(next_of(folder).command) == ["spheremouse", "axes", "--config", config, "--rig", rig]
    configuration.write_text("schema: 2\nsource: v4l2:/dev/video7\nrig: rig.yaml\n")
    assert shlex.split(next_of(folder).command) == ["spheremouse", "axes", "--config", config]
    for wrong in ("schema: 2\nmotion: 3\n", "schema: [\n"):
        configuration.write_text(wrong)
        assert next_of(folder).found == "config.yaml cannot be used"
    configuration.write_text("schema: 2\nmotion: {player: left}\n")

    step = next_of(folder)
    assert [s.name for s in checklist(folder)] == NAMES
    assert step.name == "service"
    assert shlex.split(step.command) == ["spheremouse", "run", "--config", config, "--output", "auto"]
    install, copy, start = (shlex.split(command) for _, command in step.otherwise)
    assert install == ["sudo", "spheremouse", "service", "install"]
    assert copy == ["sudo", "cp", rig, str(tmp_path / "service" / "rig.yaml")]
    assert start[:2] == ["sudo", "systemctl"]
    (tmp_path / "service").mkdir()
    shutil.copy(*copy[2:])
    unreadable = tmp_path / ("x" * 300)  # as a folder of another account: the system refuses to look into it
    steps = checklist(folder, [unreadable, tmp_path / "service"])
    assert [s.name for s in steps if s.state not in ("done", "not needed")] == []
    monkeypatch.setattr(checklist_module, "SERVICES", [tmp_path / "service"])
    assert run("next", folder).splitlines()[-1].startswith("The calibration is complete")


def test_a_practice_set_ends_with_its_truth_and_your_own_cabinet(finished, tmp_path):
    (finished / "film").mkdir()
    (finished / "film" / "scene.json").touch()
    targets = [{"code": c, "position": p} for c, p in zip(("MCY", "CYM", "YMC"), np.eye(3).tolist(), strict=True)]
    targets[1]["position"][2] = 0.002
    truth = {"camera": {"fx": 60.3}, "ball": {"radius": 0.6003}, "targets": targets}
    (finished / "truth.json").write_text(json.dumps(truth))
    source = ["--source", f"dataset:{finished / 'film'}"]
    config = finished / "config.yaml"

    step = next_of(finished)
    assert shlex.split(step.command) == ["spheremouse", "calibrate", "init", "cabinet"]
    watched = ["spheremouse", "run", "--config", str(config), *source, "--output", "null", "--status"]
    assert shlex.split(step.otherwise[0][1]) == watched
    compared = next(s.found for s in checklist(finished) if s.name == "truth")
    for figure in ("focal length -0.498 %", "ball's radius -0.30", "targets at most 2.00 mm"):
        assert figure in compared
    (tmp_path / "cabinet").mkdir()
    assert shlex.split(next_of(finished).command) == ["spheremouse", "calibrate", "next"]
    config.unlink()
    rig = str(finished / "rig.yaml")
    assert shlex.split(next_of(finished).command) == [
        "spheremouse", "axes", "--config", str(config), "--rig", rig, *source
    ]  # fmt: skip
    (finished / "rig.yaml").unlink()
    assert [s.state for s in checklist(finished) if s.name in ("truth", "your cabinet")] == ["later", "later"]


def test_some_photos_are_counted_and_may_do(cabinet):
    photograph(cabinet / "board", 2)
    assert "calibrate camera" not in str(next_of(cabinet).otherwise)  # two views of a plane are too few
    photograph(cabinet / "board", 5)
    step = next_of(cabinet)
    assert (step.name, step.found) == ("photos of the board", f"5 photos of 64x48 in {cabinet / 'board'}")
    assert step.todo[0].startswith("5 so far")
    assert "calibrate photos" in step.command
    assert "calibrate camera" in step.otherwise[0][1]
    make_camera(cabinet)
    assert next_of(cabinet).name == "device.yaml"  # whoever went on may go on
    board = checklist(cabinet)[2]
    assert board.state == "too few"
    assert board.found.startswith(f"5 photos of 64x48 in {cabinet / 'board'}; 10 to 20 ")


def test_photos_that_the_camera_did_not_use_do_not_count(cabinet):
    photograph(cabinet / "board", BOARD_ENOUGH + 1)
    every = provenance(cabinet / "board")["photos"]
    for left, state in ((1, "done"), (2, "too few")):
        save_camera(cabinet / "camera.yaml", CAMERA, {"photos": every[left:], "left_out": every[:left]})
        assert checklist(cabinet)[2].state == state
    assert f"{BOARD_ENOUGH - 1} of use" in checklist(cabinet)[2].found


def retake(folder):
    for photo in folder.iterdir():
        photo.unlink()
    photograph(folder, DEVICE_ENOUGH, 200)


@pytest.mark.parametrize(
    ("change", "name", "found"),
    [
        (lambda folder: photograph(folder / "board", 2, 50), "camera.yaml", "2 photos came later"),
        (lambda folder: retake(folder / "device"), "rig.yaml", f"{DEVICE_ENOUGH} photos came later"),
        (lambda folder: (folder / "camera.yaml").write_text("# new\n" + (folder / "camera.yaml").read_text()),
         "rig.yaml", "camera.yaml has changed"),
        (lambda folder: (folder / "device.yaml").write_text("# new\n" + (folder / "device.yaml").read_text()),
         "rig.yaml", "device.yaml has changed"),
        (lambda folder: (folder / "device" / "100.png").unlink(), "rig.yaml", "1 photo it was made from is gone"),
    ],
)  # fmt: skip
def test_a_change_asks_for_another_run(finished, change, name, found):
    change(finished)
    step = next_of(finished)
    assert (step.name, step.found) == (name, found)
    assert step.command.endswith("--force")


def test_photos_that_are_all_gone_are_no_change(finished):
    for photo in [*(finished / "device").iterdir(), *(finished / "board").iterdir()]:
        photo.unlink()
    assert next_of(finished).name == "service"


def test_a_rig_from_rolling_needs_no_photos_of_the_device(cabinet):
    photograph(cabinet / "board", 4)
    make_camera(cabinet)
    make_rig(cabinet, {"camera": {"sha256": sha256(cabinet / "camera.yaml")}})
    states = {s.name: s.state for s in checklist(cabinet)}
    assert states["device.yaml"] == states["photos of the device"] == "not needed"
    assert next_of(cabinet).name == "axes"
    make_camera(cabinet, rms_px=0.2)
    assert "calibrate rolling" in next_of(cabinet).command


@pytest.mark.parametrize(
    ("board", "square", "options"),
    [("9x6", 0.03, "--board 9x6 --square 30mm"), ("rubbish", 0.03, "--board 11x8 --square 20mm")],
)
def test_another_run_takes_the_board_of_the_first(cabinet, board, square, options):
    photograph(cabinet / "board", 3)
    make_camera(cabinet, board=board, square=square)
    photograph(cabinet / "board", 1, 9)
    assert options in next_of(cabinet).command


def test_photos_that_cannot_be_used_are_the_next_thing(finished):
    (finished / "rig.yaml").unlink()
    photograph(finished / "device", DEVICE_ENOUGH, 100, (128, 96))
    step = next_of(finished)
    assert step.name == "photos of the device"
    said = f"is 128x96, and {finished / 'camera.yaml'} is for the mode 64x48"
    assert said in step.todo[0]
    assert "take originals in that mode" in step.todo[0]
    (finished / "camera.yaml").unlink()
    photograph(finished / "board", 1, BOARD_ENOUGH, (32, 24))
    step = next_of(finished)
    assert step.name == "photos of the board"
    assert "32x24, and the others 64x48" in step.todo[0]


@pytest.mark.parametrize("name", ["camera.yaml", "rig.yaml", "device.yaml"])
def test_a_damaged_file_is_the_next_thing_with_its_line(finished, name):
    (finished / name).write_text("schema: 1\ncamera: {width: no}\n")
    step = next_of(finished)
    assert step.name == name
    assert f"{name}:" in step.todo[0]
    assert "--force" in step.command or name == "device.yaml"  # what a person wrote is theirs to mend


def test_it_goes_on_in_the_folder_itself_and_in_the_usual_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("next").splitlines()[-1].strip() == "spheremouse calibrate init cabinet"
    assert "spheremouse calibrate next" in run("init").splitlines()[-1]
    assert "Next: print" in run("next")
    printed(tmp_path / "cabinet")
    assert "cabinet/board" in run("next")
    monkeypatch.chdir(tmp_path / "cabinet")
    assert "into board." in run("next")


def test_the_terminal_shows_the_list_and_one_thing(cabinet):
    photograph(cabinet / "board", BOARD_ENOUGH)
    lines = run("next", cabinet).splitlines()
    states = [line.split()[0] for line in lines[: len(NAMES)]]
    assert states == ["done", "done", "done", "next", *["later"] * 5]
    assert "Next: camera.yaml" in lines
    commands = [shlex.split(line) for line in lines if "spheremouse calibrate" in line]
    assert [words[2] for words in commands] == ["camera", "photos"]  # the step, and its alternative
    command = commands[0]  # one line, to copy, whatever is in the folder's name
    assert str(cabinet / "board") in command


def test_json_is_the_same_list(cabinet, tmp_path):
    printed = json.loads(run("next", cabinet, "--json", "-"))
    assert "Next: photos of the board" in run("next", cabinet, "--json", tmp_path / "steps.json")
    assert json.loads((tmp_path / "steps.json").read_text()) == printed
    assert printed["folder"] == str(cabinet)
    assert [s["name"] for s in printed["steps"]] == NAMES
    assert "there is no folder" in refused("next", cabinet, "--json", tmp_path / "nowhere" / "x.json")


def test_init_keeps_what_is_there(cabinet):
    path = cabinet / "device.yaml"
    assert path.read_text(encoding="utf-8") == device_template()
    assert load_device(path).ids == (1, 2, 3, 4)
    photograph(cabinet / "board", 1)
    path.write_text("mine")
    assert "kept as it is" in run("init", cabinet)
    assert path.read_text() == "mine"
    run("init", cabinet, "--force")
    assert path.read_text(encoding="utf-8") == device_template()
    assert (cabinet / "board" / "0.png").exists()


def test_a_file_where_the_folder_should_be(tmp_path):
    (tmp_path / "f").write_text("")
    assert "f/board: cannot be made: Not a directory; choose another place" in refused("init", tmp_path / "f")
    assert "is a file" in refused("next", tmp_path / "f")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "board").write_text("")
    assert "d/board: cannot be made: File exists" in refused("init", tmp_path / "d")
