"""Recordings, replays, comparisons and the guide behind the page's server."""

import asyncio
import base64
import json
import os
import shutil
import signal
import threading
from pathlib import Path

import pytest
import simplejpeg
from page_server import PATIENCE, Browser, act, serving
from view_world import wait_for

from spheremouse.view import server as server_module

CLIP = Path(__file__).parents[2] / "data/far26_clip"


@pytest.mark.slow
def test_the_guide_looks_through_the_camera_and_runs_the_command_of_the_next_step_alone(tmp_path):
    cabinet = tmp_path / "cabinet"
    with serving(tmp_path / "s", cabinet=cabinet, source=f"dataset:{CLIP}") as port, Browser(port) as browser:
        act(browser, "guide", do="look")
        seen = browser.until("guide", lambda m: m["picture"])
        assert simplejpeg.decode_jpeg(base64.b64decode(seen["picture"])).shape == (960, 1280, 3)
        assert any(line.startswith("targets") for line in seen["check"]["lines"])
        step = next(step for step in act(browser, "guide", do="steps")["data"]["steps"] if step["state"] == "next")
        assert step["command"] == f"spheremouse calibrate init {cabinet}"
        for wrong in ({"step": "rig.yaml", "number": 0}, {"step": "folder", "number": 1}, {"step": "folder"}):
            assert "the steps have changed" in act(browser, "guide", do="run", **wrong)["text"]
        assert "mm" in act(browser, "guide", do="run", step="folder", number=0, square="2; rm")["text"]
        assert "the steps have changed" in act(browser, "guide", do="describe", text="targets: []")["text"]
        assert not cabinet.exists()
        act(browser, "guide", do="run", step="folder", number=0)
        ended = browser.until("guide", lambda m: not m["running"] and m["lines"])
        assert (ended["problem"], "device.yaml: written" in ended["lines"][0]) == ("", True)
        steps = act(browser, "guide", do="steps")["data"]["steps"]
        assert [steps[0]["state"], steps[2]["state"]] == ["done", "next"]


@pytest.mark.slow
def test_the_guide_gives_the_reason_why_a_camera_shows_nothing_to_the_owner_alone(tmp_path):
    with (
        serving(tmp_path / "s", cabinet=tmp_path, source="v4l2:/dev/no-camera") as port,
        Browser(port, owner=False) as stranger,
        Browser(port) as browser,
    ):
        assert "only the owner" in act(stranger, "guide", do="look")["text"]
        act(browser, "guide", do="look")
        assert "/dev/no-camera: no such device" in browser.until("guide", lambda m: m["problem"])["problem"]
        assert "only the owner" in act(stranger, "guide", do="look")["text"]
        assert not [m for m in stranger.seen if m["type"] == "guide"]


@pytest.fixture
def clip(world):
    """A recording with truth in the daemon's folder, and one that is none."""
    folder = Path(world.client.ask("status")["recordings"])
    folder.mkdir(parents=True)
    shutil.copytree(CLIP, folder / "clip")
    (folder / "nonsense").mkdir()
    (folder / "nonsense/scene.json").write_text("{}")
    return "clip"


def replayed(browser, name):
    """The process of a replay, which is begun."""
    assert act(browser, "play", name=name)["type"] == "done"
    return browser.until("status", lambda m: m["status"] and "replay" in m["status"]["source"])["status"]["pid"]


def wait_for_end(process):
    wait_for("its end", lambda: not Path(f"/proc/{process}").exists(), PATIENCE)


def test_recordings_of_the_daemons_folder_are_listed_and_no_other_is_opened(world, page, clip):
    with Browser(page) as browser:
        browser.until("status", lambda m: m["status"])
        found = {each["name"]: each for each in act(browser, "recordings")["data"]["recordings"]}
        assert found["clip"]["frames"] == 50
        assert found["clip"]["seconds"] == pytest.approx(50 / 30)
        assert found["clip"]["truth"]
        assert "no description" in found["nonsense"]["problem"]
        for name in ("nonsense", "..", str(CLIP), f"../{clip}"):
            for action in ("play", "compare"):
                assert act(browser, action, name=name)["text"].startswith(f"{name}: ")
        assert "must be a number" in act(browser, "compare", name=clip, begin="x")["text"]


def test_a_replay_takes_the_cameras_place_with_the_changed_settings_and_gives_them_back(world, page, clip):
    with Browser(page) as browser:
        browser.until("hello", lambda m: m["settings"])
        browser.ask("set", values={"motion.scale_x": 2.0}, gesture="g")
        browser.until("status", lambda m: m["status"] and m["status"]["changes"])
        assert act(browser, "play", name=clip)["type"] == "done"
        status = browser.until("status", lambda m: m["status"])["status"]
        assert status["source"]["replay"]["frames"] == 50
        assert status["changes"] == ["motion.scale_x=2.0"]
        assert simplejpeg.decode_jpeg(browser.picture()["jpeg"]).shape == (480, 640, 3)
        assert browser.ask("set", values={"so3.acceleration_sigma": 20.0}, gesture="h")["type"] == "done"
        assert act(browser, "replay", speed=0.5, step=True)["type"] == "done"
        browser.until("status", lambda m: m["status"] and m["status"]["state"] == "paused")
        assert "replay: speed: " in act(browser, "replay", speed=-1)["text"]
        assert "scale_x" in world.client.ask("status")["changes"][0]
        assert act(browser, "leave")["type"] == "done"
        assert world.client.ask("status")["changes"] == ["motion.scale_x=2.0", "so3.acceleration_sigma=20.0"]
        assert act(browser, "undo")["type"] == "done"
        assert world.client.ask("status")["changes"] == ["motion.scale_x=2.0", "so3.acceleration_sigma=0.1"]
        live = browser.until("status", lambda m: m["status"] and m["status"]["pid"] != status["pid"])
        assert live["status"]["source"]["spec"] == "film:played"
        wait_for_end(status["pid"])


@pytest.mark.slow
def test_a_replay_ends_with_the_last_browser(world, page, clip, monkeypatch):
    monkeypatch.setattr(server_module, "_LINK_KEPT_S", 0.1)
    with Browser(page) as browser:
        browser.until("status", lambda m: m["status"])
        replay = replayed(browser, clip)
    wait_for_end(replay)


@pytest.mark.slow
def test_the_end_of_a_replay_is_reported(world, page, clip):
    with Browser(page) as browser:
        browser.until("status", lambda m: m["status"])
        os.kill(replayed(browser, clip), signal.SIGKILL)
        assert "the replay has ended" in browser.until("trouble")["text"]
        browser.until("status", lambda m: m["status"] and "replay" not in m["status"]["source"])


@pytest.mark.slow
def test_a_replay_that_ends_at_its_start_is_reported_once(world, page, clip):
    (Path(world.client.ask("status")["recordings"]) / clip / "video.mkv").write_bytes(b"")
    with Browser(page) as browser:
        browser.until("status", lambda m: m["status"])
        assert "video.mkv: no frame" in act(browser, "play", name=clip)["text"]
        browser.until("status")
        assert [m["id"] for m in browser.seen if m["type"] == "trouble"] == [1]  # the answer


@pytest.mark.parametrize("by", ["stop", "leave"])
def test_a_long_comparison_reports_its_time_and_can_be_ended(page, clip, monkeypatch, by):
    async def answer(*_, **__):
        running.set()
        try:
            await asyncio.sleep(PATIENCE)
        finally:
            ended.set()

    running, ended = threading.Event(), threading.Event()
    monkeypatch.setattr("spheremouse.view.recordings.child.answer", answer)
    monkeypatch.setattr(server_module, "_PROGRESS_INTERVAL_S", 0.05)
    with Browser(page) as browser, Browser(page) as other:
        browser.until("status", lambda m: m["status"])
        for action, arguments in (("compare", {"name": clip}), ("stop", {})):  # before anything runs
            browser.socket.send(json.dumps({"type": "do", "id": 8, "action": action, "arguments": arguments}))
        assert "was ended" in browser.until("trouble", lambda m: m["id"] == 8)["text"]
        running.clear()
        ended.clear()
        browser.socket.send(json.dumps({"type": "do", "id": 9, "action": "compare", "arguments": {"name": clip}}))
        assert browser.until("progress")["id"] == 9
        assert running.wait(PATIENCE)
        assert "another comparison is under way" in act(other, "compare", name=clip)["text"]
        assert not ended.is_set()
        assert act(other, by)["type"] == "done"
        assert "was ended" in browser.until("trouble", lambda m: m["id"] == 9)["text"]
        assert ended.is_set()
