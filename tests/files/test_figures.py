"""What a page shows of calibrations and recordings."""

import json
import os

import pytest

from spheremouse.errors import ConfigurationError
from spheremouse.files.figures import read_figures
from spheremouse.files.listing import list_recordings

DEVICE = {
    "targets": [{"id": 1, "code": "MCY", "position": [-0.1, 0.2, 0.0], "sigma": [1e-4, 2e-4, 3e-4]}],
    "ball": {"center": [0.0, 0.001, -0.2], "radius": 0.05, "sigma": {"X": 1e-5, "Y": 2e-5, "Z": 3e-5, "R": 4e-5}},
    "photos": [{"file": "a.jpg", "rms_px": 0.25, "points": 12}],
    "distances": [{"from": 1, "to": 2, "metres": 0.3, "adjusted": 0.3004, "residual": -4e-4, "adjusted_sigma": 2e-4}],
    "skipped": [{"file": "b.jpg", "why": "two targets"}],
    "rms_px": 0.3, "scale_free": False, "ring_scale": 1.0, "advice": [{"kind": "note", "text": "More photos."}],
}  # fmt: skip
ROLLING = {
    "ratio": 4.0, "ratio_sigma": 1e-5, "center_direction": [0, 0, 1], "center_direction_sigma_deg": 0.01,
    "sigma_angle_deg": [0.1, 0.2, 0.3], "axes": "gestures", "axes_sigma_deg": [1.0, 1.0, 0.5], "frames": 90,
    "frames_given": 100, "rms_px": 0.2, "scale": "metric",
    "T_obj_cam": [[1, 0, 0, 0.1], [0, 1, 0, 0.2], [0, 0, 1, 2.4]], "sigma_position": [0.001, 0.002, 0.003],
    "ball": {"radius": 0.6, "sigma": 0.001}, "readout_s": 0.01,
    "readout_sigma_s": 0.0001, "sightings": 900, "rejected": 3,
    "eccentricity": 0.002, "eccentricity_sigma": 0.0001, "eccentric": True,
}  # fmt: skip


def read(folder, data, name="rig"):
    text = data if isinstance(data, str) else json.dumps(data)
    (folder / f"{name}.json").write_text(text)
    return read_figures([folder])


@pytest.mark.parametrize(
    ("data", "kind", "rows"),
    [
        (DEVICE, "device", [("ball Z", "-200.00 mm", "0.03 mm"), ("ball's radius", "50.00 mm", "0.04 mm"),
                            ("target MCY", "-100.00, 200.00, 0.00 mm", "0.10, 0.20, 0.30 mm"),
                            ("1 to 2", "300.4 mm, -0.4 mm from the tape", "0.2 mm")]),
        (DEVICE | {"scale_free": True, "distances": []}, "device", [("ball Z", "-0.20 radii", "0.00 radii")]),
        (ROLLING, "rolling", [("distance over radius", "4.000000", "0.000010"),
                              ("ball off its pivot by", "2.00 mm", "0.10 mm"), ("frames used", "90 of 100", ""),
                              ("camera's place", "100.00 200.00 2400.00 mm", "1.00 2.00 3.00 mm")]),
        (ROLLING | {"ball": {"radius": 0.005, "sigma": 1e-6}}, "rolling", [("ball's radius", "5.0000 mm", "0.0010 mm")])
    ],
)  # fmt: skip
def test_figures_are_rows_with_their_units_and_standard_deviations(tmp_path, data, kind, rows):
    (report,) = read(tmp_path, data)
    assert report["kind"] == kind
    assert set(rows) <= set(report["rows"])


def test_photos_and_advice_are_listed(tmp_path):
    (report,) = read(tmp_path, DEVICE)
    assert report["photos"] == [
        {"file": "a.jpg", "rms_px": 0.25, "points": 12, "why": ""},
        {"file": "b.jpg", "rms_px": None, "points": None, "why": "two targets"},
    ]
    assert report["advice"] == ["More photos."]


@pytest.mark.parametrize(
    "nonsense",
    ["", "{", "[]", '"camera"', '{"ring_scale": NaN}', '{"ring_scale": 1}', '{"board_views": 3}', "[" * 100_000,
     json.dumps(DEVICE | {"photos": [3]}), json.dumps(DEVICE | {"rms_px": "small"}),
     json.dumps(DEVICE | {"advice": 1})],
)  # fmt: skip
def test_nonsense_beside_a_calibrated_file_is_refused_with_a_reason_in_one_line(tmp_path, nonsense):
    assert read(tmp_path, nonsense) == read_figures([tmp_path / "none"]) == []
    (tmp_path / "rig.yaml").touch()
    (report,) = read_figures([tmp_path])
    assert report.keys() == {"file", "problem"}
    assert report["problem"].endswith("; calibrate again, or remove the file")
    assert "\n" not in report["problem"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every folder")
def test_a_folder_that_may_not_be_read_is_an_error(tmp_path):
    folder = tmp_path / "closed"
    folder.mkdir(mode=0o300)
    with pytest.raises(ConfigurationError, match="closed: cannot be read"):
        read_figures([folder])


def recording(folder, name, age=0.0, scene=None, truth=False):
    path = folder / name
    path.mkdir(parents=True)
    (path / "scene.json").write_text(json.dumps({"frames": 60, "fps": 30} if scene is None else scene))
    if truth:
        (path / "truth.csv").touch()
    os.utime(path, (1e9 - age, 1e9 - age))
    return path


def test_the_newest_comes_first_with_length_and_kind(tmp_path):
    recording(tmp_path, "old", age=5.0, truth=True)
    recording(tmp_path, "new", scene={"frames": 10, "fps": 20, "wand": {}})
    (tmp_path / "no-recording").mkdir()
    (tmp_path / "file").touch()
    recording(tmp_path, ".unfinished")
    new, old = list_recordings([tmp_path])
    assert (new.path.name, new.frames, new.seconds, new.wand, new.truth) == ("new", 10, 0.5, True, False)
    assert (old.path.name, old.frames, old.seconds, old.wand, old.truth) == ("old", 60, 2.0, False, True)


def test_of_one_name_the_first_folder_counts_and_a_missing_folder_has_none(tmp_path):
    first = recording(tmp_path / "a", "same")
    recording(tmp_path / "b", "same")
    assert [each.path for each in list_recordings([tmp_path / "c", tmp_path / "a", tmp_path / "b"])] == [first]


@pytest.mark.parametrize("scene", [[], {}, {"frames": 1}, {"frames": "x", "fps": 1}, {"frames": 1, "fps": 0}, 3, None])
def test_nonsense_is_listed_with_its_reason(tmp_path, scene):
    path = recording(tmp_path, "odd", scene={})
    (path / "scene.json").write_text("{" if scene is None else json.dumps(scene))
    (each,) = list_recordings([tmp_path])
    assert each.problem == "scene.json: is no description of a recording"
