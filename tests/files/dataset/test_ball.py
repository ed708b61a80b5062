"""Datasets: what is written comes back, and what is wrong with a folder is said in one line that names the file."""

import csv
import json
import shutil

import numpy as np
import pytest
from invoking import refusal

from spheremouse.ball.rig import UNKNOWN_READOUT
from spheremouse.ball.truth import HIDDEN, VISIBLE, DiscTruth
from spheremouse.errors import DatasetError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.dataset.write import TruthWriter, dataset_folder
from spheremouse.geometry.rotation import exp, from_euler
from spheremouse.simulate.ball.film import SimulationOptions, prepare, simulate
from spheremouse.simulate.to_dataset import write_simulation
from spheremouse.tracker import Frame

FRAMES = 6
SIZE = (64, 48)


def scene_of(size=SIZE, **more):
    return {
        "name": "made up", "made_by": "a test", "width": size[0], "height": size[1], "fps": 25, "exposure_s": 0.004,
        "camera": {"fx": 60.0, "fy": 61.0, "cx": 31.5, "cy": 24, "dist": [0.1, -0.2, 0.001, 0.002, 0.03]},
        "ball": {"radius": 0.6}, "disc_radius": 0.02,
        "targets": [{"id": 4, "code": "MCY", "position": [0.1, 0.2, 0.3]}], "target_radii": [0.012, 0.024, 0.036],
        "truth_disc_directions": [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
        "truth_T_obj_cam": [[1, 0, 0, 0.5], [0, -1, 0, 0], [0, 0, -1, 2.0], [0, 0, 0, 1]], **more
    }  # fmt: skip


def picture(index, size=SIZE):
    return np.random.default_rng(index).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)


def motion(index):
    return exp(np.array([0.1, 0.2, 0.3]) * index), np.array([2.5, 5.0, 7.5]) + index


def discs_of(index):
    return DiscTruth(
        np.full(2, index), np.array([0, 1]), np.array([[10.25, 20.5], [30.0, 7.125]]) + index,
        np.array([[10.5, 20.5], [np.nan, np.nan]]), np.array([81.5, np.nan]), np.array([VISIBLE, HIDDEN])
    )  # fmt: skip


def write(path, frames=FRAMES, size=SIZE, replace=False, **more):
    with dataset_folder(path, scene_of(size, **more), replace=replace) as made:
        writer = TruthWriter(made)
        for i in range(frames):
            writer.add(Frame(picture(i, size), 0.04 * i + 0.001, i), *motion(i), discs_of(i))
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return write(tmp_path_factory.mktemp("datasets") / "made")


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made, tmp_path / "copy")


def spoil_scene(folder, key, value):
    """Set a dotted key of scene.json, or remove it with value None."""
    scene = json.loads((folder / "scene.json").read_text())
    *parents, last = key.split(".")
    place = scene
    for name in parents:
        place = place[name] if isinstance(place, dict) else place[int(name)]
    if value is None:
        del place[last]
    else:
        place[last] = value
    (folder / "scene.json").write_text(json.dumps(scene))


@pytest.mark.parametrize(("size", "kept_in"), [((64, 48), "video.mkv"), ((63, 47), "frames")])
def test_what_is_written_comes_back_bit_for_bit(tmp_path, size, kept_in):
    """OpenCV's video writer cuts odd sizes: those go to PNG files."""
    path = write(tmp_path / "there" / "set", size=size)
    assert sorted(p.name for p in path.iterdir()) == sorted(["scene.json", kept_in, "truth.csv", "discs.csv"])
    recording = open_dataset(path)
    frames = list(read_frames(recording))
    assert [f.sequence for f in frames] == list(range(FRAMES))
    assert [f.stamp for f in frames] == recording.seconds.tolist()
    for i, frame in enumerate(frames):
        assert np.array_equal(frame.image, picture(i, size))
        assert frame.stamp == 0.04 * i + 0.001
        attitude, rate = motion(i)
        assert np.array_equal(recording.truth.attitude[i], attitude)
        assert np.array_equal(recording.truth.rate[i], rate)
        discs, expected = recording.discs.of_frame(i), discs_of(i)
        for name in ("disc", "centre", "blob_centre", "area", "state"):
            assert np.array_equal(
                getattr(discs, name), getattr(expected, name), equal_nan=name in {"blob_centre", "area"}
            )


def test_euler_angles_are_written_as_well(made):
    with (made / "truth.csv").open() as file:
        rows = list(csv.DictReader(file))
    angles = np.array([[float(r[k]) for k in ("omega", "phi", "kappa")] for r in rows])
    assert np.allclose(from_euler(angles), [motion(i)[0] for i in range(FRAMES)], atol=1e-12)


def test_the_rig_comes_from_what_is_known_beforehand(made, folder):
    recording = open_dataset(made)
    rig = recording.rig
    assert (recording.name, recording.fps, recording.frames, recording.exposure_s) == ("made up", 25.0, FRAMES, 0.004)
    assert (rig.camera.width, rig.camera.height, *rig.camera.intrinsic) == (64, 48, 60.0, 61.0, 31.5, 24.0)
    assert rig.camera.distortion.tolist() == [0.1, -0.2, 0.001, 0.002, 0.03]
    assert (rig.ball.radius, rig.disc_radius, rig.exposure_s) == (0.6, 0.02, 0.004)
    assert (rig.targets.ids, rig.targets.codes, rig.targets.position.tolist()) == ((4,), ("MCY",), [[0.1, 0.2, 0.3]])
    assert rig.pose is None
    assert rig.disc_directions is None
    assert np.allclose(recording.pose.position, [0.5, 0.0, 2.0])
    assert recording.truth_directions.shape == (2, 3)
    spoil_scene(folder, "T_obj_cam", [[1, 0, 0, 0.25], [0, -1, 0, 0], [0, 0, -1, 2.0], [0, 0, 0, 1]])
    spoil_scene(folder, "readout_s", 0.02)
    for key in ("truth_T_obj_cam", "truth_disc_directions", "targets", "target_radii"):
        spoil_scene(folder, key, None)
    known = open_dataset(folder)
    assert np.allclose(known.rig.pose.position, [0.25, 0.0, 2.0])
    assert (known.rig.readout_s, known.rig.readout_sigma_s) == (0.02, 0.0)
    assert known.pose is None
    assert known.truth_directions is None
    assert known.rig.targets.position.shape == (0, 3)


@pytest.mark.parametrize(
    ("more", "readout", "sigma"),
    [
        ({}, 0.0, UNKNOWN_READOUT),
        ({"readout_s": None}, 0.0, UNKNOWN_READOUT),
        ({"readout_s": 0}, 0.0, 0.0),
        ({"readout_s": 0.02}, 0.02, 0.0),
    ],
)
def test_a_readout_that_a_scene_does_not_tell_is_unknown(tmp_path, more, readout, sigma):
    rig = open_dataset(write(tmp_path / "made", **more)).rig
    assert (rig.readout_s, rig.readout_sigma_s) == (readout, sigma)


def test_a_recording_without_truth_is_stamped_by_its_rate(folder):
    (folder / "truth.csv").unlink()
    (folder / "discs.csv").unlink()
    recording = open_dataset(folder)
    assert recording.truth is None
    assert recording.discs is None
    assert [f.stamp for f in read_frames(recording)] == [i / 25.0 for i in range(FRAMES)]


def test_a_simulation_is_written_whole(tmp_path):
    simulation = prepare(SimulationOptions(size=(160, 120), seconds=0.2, noise=2.0, readout=0.01, seed=3))
    assert list(write_simulation(tmp_path / "sim", simulation)) == [1, 2, 3, 4, 5, 6]
    recording = open_dataset(tmp_path / "sim")
    assert recording.name == "sim"
    assert np.allclose(recording.pose.matrix(), simulation.scene.pose.matrix())
    assert np.allclose(recording.truth_directions, simulation.scene.disc_directions)
    rig, expected = recording.rig, simulation.scene.rig()
    assert rig.readout_s == expected.readout_s == 0.01
    assert rig.targets.codes == expected.targets.codes
    assert np.array_equal(rig.targets.position, expected.targets.position)
    assert np.array_equal(rig.camera.matrix, expected.camera.matrix)
    for k, filmed in enumerate(simulate(simulation)):
        assert recording.seconds[k] == filmed.frame.stamp
        assert np.allclose(recording.discs.of_frame(k).centre, filmed.discs.centre, atol=5.1e-5)


@pytest.mark.parametrize("name", ["scene.json", "video.mkv"])
def test_a_missing_file_is_named(folder, name):
    (folder / name).unlink()
    assert name in refusal(DatasetError, open_dataset, folder)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("width", None, "width: missing"),
        ("width", "64", "width: must be a whole number, is '64'"),
        ("fps", 0, "fps: must be greater than 0, is 0"),
        ("fps", True, "fps: must be a number, is true"),
        ("camera.fx", np.inf, "camera.fx: must be a finite number, is inf"),
        ("ball", None, "ball: missing"),
        ("readout_s", -0.001, "readout_s: must be at least 0, is -0.001"),
        ("target_radii", None, "target_radii: missing; targets need it"),
        ("targets.0.code", "MMY", "targets[0].code: must be 'CMY', 'CYM', 'MCY', 'MYC', 'YCM' or 'YMC', is 'MMY'"),
        ("truth_T_obj_cam", np.diag([2.0, 1.0, 1.0, 1.0]).tolist(), "truth_T_obj_cam: not a rotation"),
        ("T_obj_cam", np.diag([-1.0, 1.0, 1.0, 1.0]).tolist(), "T_obj_cam: not a rotation"),
        ("truth_disc_directions", [[0.0, 1.0]], "truth_disc_directions[0][2]: missing"),
        ("name", "\x1b[31mred", "name: has a control character; write it in letters, digits and signs"),
    ],
)
def test_a_wrong_key_is_named(folder, key, value, words):
    spoil_scene(folder, key, value)
    assert f"scene.json: {words}" in refusal(DatasetError, open_dataset, folder)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "\xff"], ids=repr)
def test_a_scene_that_is_none(folder, text):
    (folder / "scene.json").write_bytes(text.encode("latin-1"))
    assert "scene.json" in refusal(DatasetError, open_dataset, folder)


def lines(file):
    return file.read_text().splitlines()


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("truth.csv", lambda t: [t[0].replace("r22", "q22"), *t[1:]], ["line 1", "r22"]),
        ("truth.csv", lambda t: [*t[:3], t[3].replace("2,", "2,x", 1), *t[4:]], ["line 4", "t", "'x"]),
        ("truth.csv", lambda t: [*t[:2], t[2] + ",5", *t[3:]], ["line 3"]),
        ("truth.csv", lambda t: t[:-1], ["5 rows", "6 frames"]),
        ("truth.csv", lambda t: [], ["line 1"]),
        ("truth.csv", lambda t: [t[0], t[2], t[1], *t[3:]], ["frame 1 where 0 is due"]),
        ("truth.csv", lambda t: [*t[:2], t[2].replace("0.041", "0.001"), *t[3:]], ["t does not increase"]),
        ("truth.csv", lambda t: [t[0], t[1].replace(",1.0,", ",1.5,", 1), *t[2:]], ["not a rotation"]),
        ("truth.csv", lambda t: [t[0], t[1].replace(",1.0,", ",nan,", 1), *t[2:]], ["line 2", "r11"]),
        ("discs.csv", lambda t: [t[0].replace("area_px", "area"), *t[1:]], ["line 1", "area_px"]),
        ("discs.csv", lambda t: [*t[:5], t[5].replace("22.5000", ""), *t[6:]], ["line 6", "v_center"]),
        ("discs.csv", lambda t: [*t[:5], t[5].replace("2,", "9,", 1), *t[6:]], ["frame from 0 to 5"]),
    ],
)
def test_a_wrong_table_is_named_with_its_line(folder, name, change, words):
    before = lines(folder / name)
    after = change(before)
    assert after != before
    (folder / name).write_text("\n".join(after) + "\n")
    text = refusal(DatasetError, open_dataset, folder)
    assert all(word in text for word in (name, *words))


def test_more_columns_and_empty_lines_do_no_harm(folder):
    t = lines(folder / "truth.csv")
    (folder / "truth.csv").write_text("\n".join([t[0] + ",dim", *(row + "," for row in t[1:]), ""]) + "\n")
    assert len(open_dataset(folder).truth) == FRAMES


def read_one_by_one(folder):
    """What can be read before the error that must come, and its line."""
    seen = []

    def read():
        seen.extend(frame.sequence for frame in read_frames(open_dataset(folder)))

    return seen, refusal(DatasetError, read)


def test_a_video_cut_short_gives_what_there_is_and_says_so(folder):
    data = (folder / "video.mkv").read_bytes()
    (folder / "video.mkv").write_bytes(data[: int(0.6 * len(data))])
    seen, error = read_one_by_one(folder)
    assert 1 <= len(seen) < FRAMES
    assert seen == list(range(len(seen)))
    assert f"{len(seen)} of {FRAMES}" in error


@pytest.mark.parametrize("content", [b"", b"no video at all" * 100])
def test_a_video_without_frames_is_an_error(folder, content):
    (folder / "video.mkv").write_bytes(content)
    seen, error = read_one_by_one(folder)
    assert seen == []
    assert "no frame" in error


def test_a_missing_or_a_spoilt_picture_ends_a_folder_of_pictures(tmp_path):
    path = write(tmp_path / "odd", size=(63, 47))
    (path / "frames" / "000003.png").unlink()
    seen, error = read_one_by_one(path)
    assert seen == [0, 1, 2]
    assert "3 of 6" in error
    (path / "frames" / "000002.png").write_bytes(b"not a picture")
    seen, error = read_one_by_one(path)
    assert seen == [0, 1]
    assert "000002.png" in error


def test_an_exception_or_no_frame_leaves_nothing_behind(tmp_path):
    def break_off():
        with dataset_folder(tmp_path / "out", scene_of()) as made:
            TruthWriter(made).add(Frame(picture(0), 0.0, 0), *motion(0), discs_of(0))
            assert len(list(tmp_path.iterdir())) == 1
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        break_off()
    assert "no frame" in refusal(DatasetError, write, tmp_path / "out", frames=0)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_something_in_it_is_refused(tmp_path):
    path = write(tmp_path / "out")
    text = refusal(DatasetError, write, path, frames=2)
    assert all(word in text for word in ("out", "not empty", "--force"))
    assert open_dataset(path).frames == FRAMES
    write(path, frames=2, replace=True)
    assert open_dataset(path).frames == 2
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_what_is_no_dataset_is_never_replaced(tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "letters.txt").write_text("dear")
    assert "letters.txt" in refusal(DatasetError, write, tmp_path / "home", replace=True)
    assert (tmp_path / "home" / "letters.txt").read_text() == "dear"
    (tmp_path / "file").write_text("")
    assert "is a file" in refusal(DatasetError, write, tmp_path / "file", replace=True)
