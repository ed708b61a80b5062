"""Requests to a daemon in this process: pictures, recordings, and clients that disconnect or send too much."""

import contextlib
import dataclasses
import json
import shutil
import socket
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from daemon_world import CLOSE, DT

from spheremouse.ball.detect.rings import RingSettings, detect_targets
from spheremouse.commands.service.systemd import under_umask
from spheremouse.errors import ControlError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.rig import rig_text
from spheremouse.session import config_reloader as loader_module
from spheremouse.session.control.client import Client
from spheremouse.session.control.request_queue import RequestQueue
from spheremouse.session.live_run import LiveRun
from spheremouse.session.process import realtime
from spheremouse.session.run_config import CommandLineOverrides, read_run_config
from spheremouse.session.service import Daemon
from spheremouse.session.setup import Setup


def test_while_paused_nothing_moves_and_nothing_is_made_up_for(world):
    assert world.ask("pause")["state"] == "paused"
    before = world.counts
    world.turn()
    assert np.array_equal(world.counts, before)
    assert world.ask("pause")["state"] == "paused"
    assert world.ask("resume")["state"] == "tracking"
    world.settle(5)
    assert np.abs(world.counts - before).max() < CLOSE
    world.check_next_turn()
    assert np.abs(world.ask("status")["outputs"][0]["unsent"]).max() > 100


def test_a_snapshot_while_targets_are_sought(unstarted):
    """Targets as they are, the rest in blocks that nobody is recognised in; all of it only where that is asked for."""
    world = unstarted
    rig = world.film.rig
    assert rig.targets.codes == ("MCY", "CYM", "YMC", "CMY")
    others = dataclasses.replace(rig, targets=dataclasses.replace(rig.targets, codes=("YCM", "CYM", "MYC", "CMY")))
    (world.folder / "rig.yaml").write_text(rig_text(others))
    world.start()
    world.until(lambda: world.logged("which the rig does not have"))
    status = world.ask("status")
    assert status["state"] == "searching-targets"
    assert status["targets"] == {"seen": ["CYM", "CMY"], "missing": ["YCM", "MYC"], "strangers": ["MCY", "YMC"]}
    coarse, whole = (cv2.imread(world.ask("snapshot", everything=e)["file"])[::2, ::2] for e in (False, True))
    ball = slice(150, 330), slice(170, 430)  # without a target; nothing is written there
    still = [(np.abs(np.diff(p[ball].astype(int), axis=1)).max(axis=2) == 0).mean() for p in (coarse, whole)]
    assert still[0] > 0.8
    assert still[1] < 0.6  # blocks of 27 px, enlarged
    truth = world.film.colour[0]
    for u, v in detect_targets(truth, rig.targets.radii, RingSettings()).centre:
        inner = slice(int(v) - 8, int(v) + 9), slice(int(u) - 8, int(u) + 9)
        assert np.array_equal(coarse[inner], whole[inner])
        assert np.median(np.abs(coarse[inner].astype(int) - truth[inner])) < 15  # but for cross and rings


def test_a_snapshot_is_for_owner_and_group_and_leaves_room_on_the_disk(world, monkeypatch):
    """As a recording is, whatever the umask."""
    with under_umask(0):
        path = Path(world.ask("snapshot")["file"])
    assert path.parent == world.folder / "recordings"
    assert path.read_bytes().startswith(b"\x89PNG")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert "there already" in world.refused("snapshot", file=path.name)
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o750
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=499e6))
    assert "less than 500 MB are free on the disk: remove recordings" in world.refused("snapshot", file="b.png")
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_live_pictures_are_the_frames_with_their_marks_and_refused_if_no_frame_comes(unstarted, monkeypatch):
    """Whether a frame is tracked or not."""
    monkeypatch.setattr("spheremouse.session.picture_feed._MAX_WAIT_S", 0.3)
    world = unstarted
    world.start()
    for fault, state, status in (("hidden", "searching-targets", "searching"), ("", "tracking", "tracking")):
        world.fault = fault
        world.reach(state)
        world.settle()
        with Client(world.socket) as client:
            picture = client.picture()
        place = world.shown[picture.stamp]
        assert picture.pixels == world.film.grey[place].tobytes()
        assert picture.annotations["status"] == status
        assert (picture.annotations["sequence"] is None) == (status == "searching")
        assert (len(picture.annotations["outline"]) > 50) == (status == "tracking")
    assert [len(picture.annotations[key]) for key in ("targets", "strangers")] == [4, 0]
    assert sum(disc["used"] for disc in picture.annotations["detected"]) >= 3
    world.missing = "unplugged"
    world.reach("no-camera")
    assert world.refused("picture") == "there is no picture now: unplugged"


@pytest.mark.slow
@pytest.mark.parametrize("command", ["record", "snapshot", "reinit"])
def test_a_request_whose_client_disconnects_before_a_frame_leaves_nothing(world, monkeypatch, command):
    """The camera gives no frames meanwhile, so that no request can be completed."""
    requests, answered, put = [], set(), RequestQueue.put

    def hear(queue, pending):
        send = pending.answer
        pending.answer = lambda message: (answered.add(pending), send(message))
        requests.append(pending)
        put(queue, pending)

    monkeypatch.setattr(RequestQueue, "put", hear)
    threads = threading.active_count()
    world.silent = True
    world.until(lambda: _still(world), "no frame left")
    for _ in range(20):
        requests.clear()
        with contextlib.closing(socket.socket(socket.AF_UNIX)) as s:
            s.connect(str(world.socket))
            s.sendall(json.dumps({"command": command}).encode() + b"\n")
            world.until(lambda: requests, "received")
        world.until(lambda: requests[-1].cancelled or requests[-1] in answered, "cancelled")
        assert threading.active_count() <= threads + 2  # a recording's writer, and a test's
    world.silent = False
    answer = {}
    world.until(lambda: answer.update(world.try_to_ask(command)) or answer, "a client is answered")
    if command == "record":
        world.until_recorded(3)
        world.ask("record", stop=True)
    folder = world.folder / "recordings"
    left = list(folder.iterdir()) if folder.exists() else []
    assert len(left) == (command != "reinit")
    world.until(lambda: threading.active_count() <= threads, "threads end")
    assert not world.logged("internal error")


def _still(world):
    before = world.ask("status")["frames"]
    time.sleep(0.3)
    return world.ask("status")["frames"] == before


LOOP = """
import json, socket, sys, time
path, seconds = sys.argv[1:]
done = dict.fromkeys(("record", "snapshot", "reload"), 0)
with socket.socket(socket.AF_UNIX) as s:
    s.connect(path)
    lines, end = s.makefile("rb"), time.monotonic() + float(seconds)
    while time.monotonic() < end:
        for command in done:
            s.sendall(json.dumps({"command": command}).encode() + b"\\n")
            done[command] += json.loads(lines.readline())["ok"]
            if command == "record":
                s.sendall(b'{"command": "record", "stop": true}\\n')
                lines.readline()
print(json.dumps(done))
"""


@pytest.mark.slow
def test_a_client_that_loops_requests_costs_no_frame(unstarted, monkeypatch):
    """`record`, `snapshot` and `reload` for ten seconds; the camera does not wait for the daemon.

    If other programs of this machine take both processors, the daemon loses as many frames without the client.
    """
    world = unstarted
    monkeypatch.setattr(realtime, "_lock_memory", lambda: "")
    world.config.write_text(world.config.read_text().replace('"off"', "auto"))
    world.start()
    world.reach("tracking")
    world.paced = True
    world.settle()
    lost = []
    for _ in range(3):
        with_client, alone = _lost_frames(world, _loop), 0
        if with_client:
            alone = _lost_frames(world, lambda _: time.sleep(10.0))
        lost.append((with_client, alone))
        if with_client <= alone:
            break
    world.paced = False
    assert any(with_client <= alone for with_client, alone in lost), lost


def _lost_frames(world, action):
    before, begun = world.daemon.status(), time.monotonic()
    action(world)
    after, seconds = world.daemon.status(), time.monotonic() - begun
    lost = sum(getattr(after, name) - getattr(before, name) for name in ("skipped", "dropped", "damaged"))
    assert after.frames - before.frames + lost == pytest.approx(seconds / DT, abs=10)
    return lost


def _loop(world):
    words = [sys.executable, "-I", "-c", LOOP, str(world.socket), "10"]
    done = json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
    assert min(done.values()) > 5, done


def test_a_recording_is_begun_once_and_ended_by_request_or_by_another_tracker(world, monkeypatch):
    """A `set` reads no file, and other settings do not end a recording."""
    read = []
    folder = world.ask("record", folder="first")["folder"]
    assert "already" in world.refused("record")
    world.until_recorded(10)
    ended = world.ask("record", stop=True)
    assert ended["folder"] == folder
    assert ended["frames"] > 10
    assert "nothing is being recorded" in world.refused("record", stop=True)
    assert world.ask("status")["recording"] is None
    assert [f.image.ndim for f in read_frames(open_dataset(Path(folder)))] == [3, *(ended["frames"] - 1) * [2]]
    monkeypatch.setattr(loader_module, "read_run_config", read.append)
    world.ask("record", folder="second")
    world.until_recorded(3)
    assert world.ask("set", assignments=["motion.scale_x=2", "pointer.rate=500"])["changed"] == ["motion", "pointer"]
    assert world.ask("status")["recording"] is not None
    message = world.ask("set", assignments=["so3.acceleration_sigma=30"])["message"]
    assert message.endswith("; the recording has ended, since it holds one tracker configuration")
    world.until((world.folder / "recordings" / "second" / "scene.json").exists)
    assert world.ask("status")["recording"] is None
    assert read == []


def test_a_disk_that_is_full_ends_a_recording_and_nothing_else(world, monkeypatch):

    def refuse(*_, **__):
        raise OSError(28, "No space left on device")

    world.ask("record", folder="first")
    world.until_recorded(3)
    monkeypatch.setattr("spheremouse.files.dataset.write.FilmWriter.add", refuse)
    world.until(lambda: world.logged("No space left"), "said")
    assert world.ask("status")["recording"] is None
    world.turn()
    world.check_counts()
    assert world.state == "tracking"


def test_an_internal_error_in_a_request_is_answered_and_the_next_one_works(world, monkeypatch):
    def wrong(*_, **__):
        raise ZeroDivisionError("as if")

    for function, command in (
        ("config_reloader.read_run_config", "reload"),
        ("ball.search.find_pose", "reinit"),
        ("record.archive.Archive.want_snapshot", "snapshot"),
    ):
        world.said.clear()
        with monkeypatch.context() as patch:
            patch.setattr(f"spheremouse.session.{function}", wrong)
            assert "internal error (ZeroDivisionError: as if)" in world.refused(command)
        world.until(lambda: world.logged("internal error") or world.logged("Traceback"))
        world.settle()
        assert world.state == "tracking"
        assert world.ask(command)


def test_who_is_refused_has_emptied_no_file(world, tmp_path):
    """A second run with the same configuration finds the socket taken before it opens its output."""
    path = tmp_path / "out.txt"
    path.write_text("what the first run has written\n")
    overrides = CommandLineOverrides(world.config, (f"output=text:{path}",))
    parts = LiveRun(overrides, read_run_config(overrides), Setup(), lambda _: world.open_camera, lambda _: None)
    with pytest.raises(ControlError, match="another daemon listens there"):
        Daemon(parts).run(world)
    assert path.read_text() == "what the first run has written\n"
