"""The list of recordings in folders, by their descriptions."""

import json
import os

import pytest

from spheremouse.files.listing import list_recordings


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
