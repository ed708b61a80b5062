"""Options with which a recording is tracked as the page shows it."""

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest

from spheremouse.view.recordings import Recordings

STATUS = {"tracker": "so3", "config": "/etc/c.yaml", "given": [], "changes": []}


def compared(folder, status, values=None, wand=False):
    """The options of `evaluate` for saved and present settings, as sets of pairs."""
    (folder / "r").mkdir()
    scene = {"frames": 60, "fps": 30} | ({"wand": {}} if wand else {})
    (folder / "r/scene.json").write_text(json.dumps(scene))
    asked = []

    async def run(*words):
        asked.append(words[4:])  # after evaluate FOLDER --json -
        return {}

    daemon = SimpleNamespace(
        status=STATUS | {"recordings": str(folder)} | status, socket=None, values=lambda: {"values": values or {}}
    )
    with ThreadPoolExecutor() as pool:  # since Playwright may have a loop in this thread
        pool.submit(asyncio.run, Recordings(daemon, run).compare("r", 0.5, 1.5)).result()
    return [{*zip(words[::2], words[1::2], strict=True)} for words in asked]


SECTION = {("--begin", "0.5"), ("--end", "1.5")}
CONFIG = ("--config", "/etc/c.yaml")


def test_the_present_settings_are_the_saved_ones_and_what_was_changed(tmp_path):
    saved, present = compared(tmp_path, {"changes": ["discs.contrast=0.3"]})
    assert saved == SECTION | {CONFIG}
    assert present - saved == {("--set", "discs.contrast=0.3")}


def test_without_a_change_one_run_is_enough(tmp_path):
    assert len(compared(tmp_path, {})) == 1


def test_settings_of_the_daemons_command_line_hold_except_its_devices(tmp_path):
    given = ["source", "rig", "control.socket", "tracker", "so3.acceleration_sigma"]
    values = {
        "source": "v4l2:x",
        "rig": "r.yaml",
        "control.socket": "/s",
        "tracker": "ekf1",
        "so3.acceleration_sigma": 3.5,
    }
    (words,) = compared(tmp_path, {"tracker": "ekf1", "given": given}, values)
    assert words == SECTION | {CONFIG, ("--set", 'tracker="ekf1"'), ("--set", "so3.acceleration_sigma=3.5")}


def test_saved_settings_hold_and_those_of_the_command_line_come_after_them(tmp_path):
    status = {"saved": ["motion.scale_x=2", "rig=r.yaml"], "given": ["motion.scale_y"], "changes": ["motion.scale_x=3"]}
    saved, present = compared(tmp_path, status, {"motion.scale_y": 1.5})
    assert saved == SECTION | {CONFIG, ("--set", "motion.scale_x=2"), ("--set", "motion.scale_y=1.5")}
    assert present - saved == {("--set", "motion.scale_x=3")}


@pytest.mark.parametrize(("tracker", "wand", "other"), [("so3", True, "wand"), ("wand", False, "so3")])
def test_a_recording_of_the_other_kind_gets_its_own_tracker(tmp_path, tracker, wand, other):
    (words,) = compared(tmp_path, {"tracker": tracker}, wand=wand)
    assert ("--tracker", other) in words


@pytest.mark.parametrize(("tracker", "wand"), [("so3", False), ("wand", True)])
def test_a_recording_of_the_same_kind_keeps_the_tracker(tmp_path, tracker, wand):
    (words,) = compared(tmp_path, {"tracker": tracker, "given": ["tracker"]}, {"tracker": tracker}, wand=wand)
    assert ("--set", f'tracker="{tracker}"') in words
    assert not any(option == "--tracker" for option, _ in words)
