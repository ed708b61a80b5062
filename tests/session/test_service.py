"""The daemon as a whole, in this process: a film behind a scripted camera, a control socket, and faults at each edge.

Laws that hold in every test, checked at its end: nothing is sent in any state but tracking; what frames gave is what
was sent, was counted as unsent, or is still withheld; every frame was looked at or counted as skipped, and given back.
"""

import contextlib
import dataclasses
import fcntl
import json
import os
import re
import shutil
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import cv2
import daemon_process
import numpy as np
import pytest
from control_world import conversations, page_reply
from daemon_world import DT, Film, World, check_samples
from view_world import start

from spheremouse.ball.detect.rings import RingSettings, detect_targets
from spheremouse.commands.service.systemd import under_umask
from spheremouse.errors import ControlError
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.rig import rig_text
from spheremouse.session import config_reloader as loader_module
from spheremouse.session import service as run_module
from spheremouse.session import timing
from spheremouse.session.control.client import Client
from spheremouse.session.control.request_queue import RequestQueue
from spheremouse.session.live_run import LiveRun
from spheremouse.session.picture_feed import PictureFeed
from spheremouse.session.process import realtime
from spheremouse.session.process.threads import as_future
from spheremouse.session.run_config import CommandLineOverrides, read_run_config
from spheremouse.session.setup import Setup

PATIENCE = 60.0  # s
OTHER = 54321  # a uid that nobody has
CLOSE = 3.0  # counts: the estimate at either end, and rounding


@pytest.fixture(scope="module")
def film():
    return Film.render()


@pytest.fixture
def unstarted(film, tmp_path, quick_daemon):
    """A world whose daemon a test starts."""
    yield from quick_daemon(World(film, tmp_path), "spheremouse.session.outputs.open_output")


@pytest.fixture
def world(unstarted):
    unstarted.start()
    unstarted.reach("tracking")
    unstarted.turn()
    return unstarted


def ask(world, command, **arguments):
    return world.client.ask(command, **arguments)


def refused(world, command, **arguments):
    with pytest.raises(ControlError) as e:
        world.client.ask(command, **arguments)
    return str(e.value)


def test_what_is_answered_has_the_keys_that_the_page_shows(unstarted):
    """docs/control.md, whose examples another test plays with a server that says them."""
    world = unstarted
    world.saved = world.folder / "saved.yaml"
    world.saved.write_text("motion: {scale_y: 2}\n")
    world.start()
    world.reach("tracking")
    assert said(world, "saved.yaml: in place of the configuration file: motion.scale_y=2")
    assert ask(world, "status")["saved"] == ["motion.scale_y=2"]
    shown = {}
    for conversation in conversations():
        for asked, (reply, *_) in conversation:
            with contextlib.suppress(ValueError):
                request = json.loads(asked)
                if reply.get("ok") and isinstance(request, dict):
                    shown.setdefault(request["command"] + str(request.get("stop", "")), set(reply) - {"ok", "id"})
    for command, arguments in {
        "pause": {},
        "resume": {},
        "set": {"assignments": ["motion.scale_x=2"]},
        "save": {},
        "record": {"seconds": 60, "folder": "bug-1"},
        "recordTrue": {"stop": True},
        "snapshot": {"file": "bug-1.png"},
        "pictures": {"interval": 0.1},
        "settings": {},
        "scene": {},
        "stop": {},
    }.items():
        reply = ask(world, command.removesuffix("True"), **arguments)
        assert set(reply) - {"ok", "id"} == shown[command], (command, reply)
        parts = {"scene": ["camera"], "settings": ["settings", 0]}.get(command, [])
        page = page_reply(command) if parts else {}
        for part in parts:
            reply, page = reply[part], page[part]
        assert reply.keys() >= page.keys()


def test_nothing_is_sent_for_the_time_asleep(world, monkeypatch):
    """The ball turns while the computer sleeps. The stamps show no gap, since the monotonic clock stood."""
    asleep = [timing.time_asleep()]
    monkeypatch.setattr(timing, "time_asleep", lambda: asleep[0])
    world.turn()
    world.settle()
    near(world)
    before = world.counts
    for place in [15, 47, 30, 0] * 2:
        world.hang = threading.Event()
        time.sleep(0.05)
        world.place, asleep[0] = place, asleep[0] + 3600.0
        go_on, world.hang = world.hang, None
        go_on.set()
        world.settle()
        world.reach("tracking")
        world.settle()
        assert np.abs(world.counts - before).max() < CLOSE
    assert said(world, "the computer slept for 3600 s: motion meanwhile is not counted")
    since = world.stamp
    world.turn(20)
    true = world.true_counts(since=since)
    assert np.abs(world.counts - before - true).max() < CLOSE
    assert np.abs(true).max() > 100


def said(world, text):
    return [line for line in world.said if text in line]


def times(world, text):
    return sum(1 + sum(map(int, re.findall(r"\((\d+) more like it\)", line))) for line in said(world, text))


def near(world, since=-np.inf):
    assert np.abs(world.counts - world.true_counts(since)).max() < CLOSE


def follows(world, scale=(1, 1, 1)):
    """What a turn sends from now on is its motion, times the scale."""
    before, since = world.counts, world.stamp
    world.turn()
    assert np.abs(world.counts - before - world.true_counts(since) * scale).max() < max(scale) * CLOSE


# ---- all is well ----


def test_counts_are_the_integral_of_the_motion(world):
    near(world)
    assert np.abs(world.counts).max() > 200
    world.turn(20)
    near(world)
    status = ask(world, "status")
    assert status["state"] == "tracking"
    assert (status["damaged"], status["unseen_s"], status["lost_count"]) == (0, 0.0, 0)
    assert status["outputs"][0] == {"spec": "sink:quiet", "failed": None, "reports": status["outputs"][0]["reports"],
                                "unsent": [0, 0, 0], "ahead": [0, 0, 0], "left_out": None, "dropped": 0,
                                    "latency_ms": status["latency_ms"]}  # fmt: skip
    world.until(lambda: set(ask(world, "status")["stages_ms"]) == {"wait", "decode", "detect", "filter"})
    assert status["discs"] >= 4
    assert status["pose"]["position_m"][2] == pytest.approx(2.35, abs=0.01)
    assert "off" in status["scheduling"]


# ---- the camera ----


def test_a_camera_that_is_missing_at_the_start_is_waited_for(unstarted):
    world = unstarted
    world.missing = "no such device; plug it in"
    world.start()
    world.until(lambda: world.state == "no-camera", "no-camera")
    assert ask(world, "status")["reason"] == world.missing
    assert "no picture" in refused(world, "reinit")
    assert "no picture" in refused(world, "snapshot")
    assert "camera's pose" in refused(world, "record")
    world.missing = ""
    world.reach("tracking")
    world.turn()
    near(world)
    assert len(said(world, "plug it in")) == 1  # once, however many attempts


def test_a_camera_is_unplugged_and_comes_back(world):
    in_thread = lambda work: threading.Thread(target=work).start()  # noqa: E731
    snapshots = as_future(lambda: [ask(world, "snapshot") for _ in range(500)], in_thread)
    world.settle()
    world.missing = "unplugged"
    world.reach("no-camera")
    assert "no picture now" in str(snapshots.exception(PATIENCE))  # who waits for a frame is told
    before = world.counts
    world.place = 20  # the ball is turned meanwhile
    world.until(lambda: ask(world, "status")["unseen_s"] > 0.02)
    world.stamp += 2.0
    back = world.stamp
    world.missing = ""
    world.reach("tracking")
    world.settle(10)
    # what was not seen is not made up for: the reset attitude keeps the pointer where it was
    assert np.abs(world.counts - before).max() < CLOSE
    world.turn(20)
    near_since = world.true_counts(back)
    assert np.abs(world.counts - before - near_since).max() < CLOSE
    status = ask(world, "status")
    assert status["camera_restarts"] == 1
    assert status["unseen_s"] > 0.02
    assert world.outputs == ["sink:quiet"]  # the device outlives it all


def test_the_state_says_tracking_before_the_first_count_is_sent(world):
    """A camera that is away for two frames, with a ball that turns on: the filter bridges the gap."""
    world.place = 20
    world.settle(60)
    before = world.counts
    world.missing = "unplugged"
    world.reach("no-camera")
    world.place += 1
    world.stamp += 2.0 * DT
    world.missing = ""
    world.reach("tracking")
    world.settle()
    assert np.abs(world.counts - before).max() > 5  # and `check_laws` has seen when they went


def test_a_camera_that_goes_stops_the_pointer_at_once(world):
    """Whatever was predicted: in no state but tracking is anything sent."""
    world.carried = True
    ask(world, "set", assignments=["pointer.horizon=0.25"])
    world.moves = 40
    world.until(lambda: world.moves < 20)
    world.missing = "unplugged"
    world.reach("no-camera")
    time.sleep(0.03)  # what was under way
    before = world.counts
    time.sleep(0.3)
    assert np.array_equal(world.counts, before)
    world.missing = ""
    world.reach("tracking")


@pytest.mark.parametrize(
    ("fault", "reason"), [("damaged", "nothing but damaged frames"), ("size", "calibrated at 640x480")]
)
def test_frames_that_cannot_be_used_are_told_and_the_camera_is_opened_anew(world, monkeypatch, fault, reason):
    monkeypatch.setattr(run_module, "_MAX_UNUSABLE_S", 0.2)
    monkeypatch.setattr("spheremouse.session.worker._MAX_DAMAGED_S", 0.05)
    opened = world.opened
    world.fault = fault
    world.reach("no-camera")
    assert reason in ask(world, "status")["reason"]
    if fault == "size":
        assert cv2.imread(ask(world, "snapshot")["file"]).shape == (960, 1280, 3)
    world.until(lambda: world.opened > opened, "opened anew")
    world.fault = ""
    world.reach("tracking")
    before = world.counts
    world.until(lambda: world.turn(5) or np.abs(world.counts - before).max() > 20)
    assert (ask(world, "status")["damaged"] > 0) == (fault == "damaged")
    assert len(said(world, reason)) <= 2  # not at every frame


# ---- the output ----


def test_an_output_that_fails_is_opened_again_and_what_it_missed_is_counted(world):
    before = world.counts
    world.broken = "uinput is gone"
    world.turn(20)
    world.reach("failed-output")
    assert ask(world, "status")["reason"] == "uinput is gone"
    unseen = ask(world, "status")["unseen_s"]
    world.turn(10)
    assert ask(world, "status")["unseen_s"] == unseen  # it was seen: the counts say what is missing
    world.broken = ""
    world.reach("tracking")
    world.settle()
    assert np.array_equal(world.counts, before)  # no jump
    assert any(ask(world, "status")["outputs"][0]["unsent"])


# ---- the configuration ----


def test_a_change_on_disk_is_picked_up(world):
    world.config.write_text(world.config.read_text() + "motion: {scale_x: 2}\n")
    world.until(lambda: said(world, "configuration applied: motion"))
    follows(world, (2, 1, 1))


def test_each_section_is_applied_between_two_frames(world, monkeypatch):
    monkeypatch.setattr(loader_module, "check_kinds", lambda *_: None)  # this world has kinds of its own
    frames = len(world.frames)
    assert ask(world, "set", assignments=["motion.scale_y=3"])["changed"] == ["motion"]
    follows(world, (1, 3, 1))
    assert ask(world, "reload")["changed"] == ["motion"]  # and what was set is over
    assert ask(world, "status")["changes"] == []
    assert ask(world, "set", assignments=["pointer.rate=500"])["changed"] == ["pointer"]
    assert ask(world, "set", assignments=["record.seconds=3"])["changed"] == ["record"]
    opened = world.opened
    assert ask(world, "set", assignments=["source=synthetic:again"])["changed"] == ["source"]
    world.until(lambda: world.opened == opened + 1)
    assert ask(world, "set", assignments=["output=sink:other"])["changed"] == ["output"]
    world.until(lambda: world.outputs == ["sink:quiet", "sink:other"])
    assert ask(world, "set", assignments=[f"map={world.folder}/other.yaml"])["changed"] == ["map"]
    assert (world.folder / "rig.map.yaml").exists()
    assert refused(world, "set", assignments=["motion.nothing=1"])
    assert ask(world, "set", assignments=["tracker=so3"])["changed"] == []
    world.turn()
    assert len(ask(world, "status")["changes"]) < 12  # the last of each
    assert len(world.frames) > frames
    assert not said(world, "internal error")
    assert not said(world, "output: ")  # the second was opened when the first was closed, and not before


def test_an_output_that_leaves_the_third_axis_out_says_so_when_it_is_taken(world, monkeypatch):
    monkeypatch.setattr(loader_module, "check_kinds", lambda *_: None)  # this world has kinds of its own
    words = "the third axis (the ball's spin) is not sent: output "
    assert ask(world, "status")["outputs"][0]["left_out"] is None  # nobody knows of this world's outputs
    for spec, told in (("uinput", 1), ("uinput:third=wheel", 1), ("desktop", 2)):
        ask(world, "set", assignments=[f"output={spec}"])
        left_out = ask(world, "status")["outputs"][0]["left_out"]
        assert (left_out or "").startswith(words + spec) is ("third=" not in spec)
        assert times(world, words) == told
    sent = sum(any(m.counts) for m in world.sent)
    world.until(lambda: ask(world, "status")["outputs"][0]["reports"] == sent)  # those before are closed, and counted


def test_the_tracker_itself_is_exchanged(world):
    before = world.counts
    assert ask(world, "set", assignments=["tracker=ekf1"])["changed"] == ["tracker", "map"]
    world.turn()
    world.until(lambda: np.abs(world.counts - before).max() > 50)
    assert ask(world, "set", assignments=["tracker=so3"])["changed"] == ["tracker", "map"]
    world.turn()
    assert not said(world, "internal error")


def test_another_rig_is_taken_up_or_refused(world):
    rig = world.folder / "rig.yaml"
    good, frames, before = rig.read_text(), len(world.frames), world.counts
    rig.write_text(good.replace("radius:", "raduis:"))
    assert "rig.yaml:" in refused(world, "reload")
    smaller = rig_text(world.film.rig).replace("radius: 0.6", "radius: 0.3", 1)
    assert smaller != good
    rig.write_text(smaller)  # its map, which is saved meanwhile, is of a ball of another size
    assert _try(world, "reload").get("changed", []) in ([], ["rig"])
    rig.write_text(good)
    world.until(lambda: _try(world, "reload"))
    world.reach("tracking")
    world.settle()
    assert np.abs(world.counts - before).max() < CLOSE
    assert len(world.frames) > frames
    assert not said(world, "internal error")


def test_a_request_is_handled_directly_after_a_frame_so_that_none_waits_for_it(world, monkeypatch):
    """At whatever moment it comes."""
    done, gaps, rng = [time.monotonic()], [], np.random.default_rng(2)
    change, show = loader_module.ConfigReloader.set, PictureFeed.show

    def changed(*arguments):
        gaps.append(time.monotonic() - done[-1])
        change(*arguments)

    def shown(*arguments, **options):
        show(*arguments, **options)
        done.append(time.monotonic())

    monkeypatch.setattr(loader_module.ConfigReloader, "set", changed)
    monkeypatch.setattr(PictureFeed, "show", shown)
    world.paced = True
    world.settle()
    for k in range(25):
        ask(world, "set", assignments=[f"motion.scale_y={1 + k % 2}"])
        time.sleep(rng.uniform(0.0, 2.0 * DT))
    assert np.median(gaps) < 0.1 * DT


# ---- the camera's pose ----


def test_the_pose_is_estimated_anew_while_the_ball_turns_and_nothing_jumps(world):
    world.moves = 47
    age = ask(world, "status")["pose"]["age_s"]
    text = ask(world, "reinit")["message"]
    assert text.startswith("camera pose: x ")
    world.until(lambda: world.moves == 0)
    world.settle()
    near(world)
    assert ask(world, "status")["pose"]["age_s"] < age + PATIENCE
    assert not said(world, "camera was moved")


def test_with_hidden_targets_the_pose_stays_and_the_answer_says_why(world):
    pose = ask(world, "status")["pose"]["position_m"]
    world.fault = "hidden"
    world.settle()
    world.moves = 47
    text = refused(world, "reinit")
    assert "0 of 4 targets" in text
    assert "stays" in text
    world.until(lambda: world.moves == 0)
    world.settle()
    near(world)
    assert ask(world, "status")["pose"]["position_m"] == pose
    world.fault = ""
    world.settle()
    assert ask(world, "reinit")["message"]  # and again, now that they are there


# ---- pause, pictures, recordings ----


def test_while_paused_nothing_moves_and_nothing_is_made_up_for(world):
    assert ask(world, "pause")["state"] == "paused"
    before = world.counts
    world.turn()
    assert np.array_equal(world.counts, before)
    assert ask(world, "pause")["state"] == "paused"
    assert ask(world, "resume")["state"] == "tracking"
    world.settle(5)
    assert np.abs(world.counts - before).max() < CLOSE
    follows(world)
    assert np.abs(ask(world, "status")["outputs"][0]["unsent"]).max() > 100


def test_a_snapshot_while_targets_are_sought(unstarted):
    """Targets as they are, the rest in blocks that nobody is recognised in; all of it only where that is asked for."""
    world = unstarted
    rig = world.film.rig
    assert rig.targets.codes == ("MCY", "CYM", "YMC", "CMY")
    others = dataclasses.replace(rig, targets=dataclasses.replace(rig.targets, codes=("YCM", "CYM", "MYC", "CMY")))
    (world.folder / "rig.yaml").write_text(rig_text(others))
    world.start()
    world.until(lambda: said(world, "which the rig does not have"))
    status = ask(world, "status")
    assert status["state"] == "searching-targets"
    assert status["targets"] == {"seen": ["CYM", "CMY"], "missing": ["YCM", "MYC"], "strangers": ["MCY", "YMC"]}
    coarse, whole = (cv2.imread(ask(world, "snapshot", everything=e)["file"])[::2, ::2] for e in (False, True))
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
        path = Path(ask(world, "snapshot")["file"])
    assert path.parent == world.folder / "recordings"
    assert path.read_bytes().startswith(b"\x89PNG")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert "there already" in refused(world, "snapshot", file=path.name)
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o750
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=499e6))
    assert "less than 500 MB are free on the disk: remove recordings" in refused(world, "snapshot", file="b.png")
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_live_pictures_are_the_frames_with_their_marks_until_the_client_dies(unstarted, monkeypatch):
    """Whether a frame is tracked or not; then the memory is given back."""
    monkeypatch.setattr("spheremouse.session.picture_feed.LEASE", 0.3)
    world = unstarted
    world.start()
    for fault, state, status in (("hidden", "searching-targets", "searching"), ("", "tracking", "tracking")):
        world.fault = fault
        world.reach(state)
        with Client(world.socket) as client:
            last = client.pictures(0.05).latest()
            world.settle()
            number = last.number if last else 0
            world.until(lambda client=client, n=number: client.pictures(0.05).latest(n), "pictures")
            picture = client.pictures(0.05).latest()
            assert "spheremouse-pictures" in Path("/proc/self/maps").read_text()
        place = world.shown[picture.stamp]
        assert picture.pixels == world.film.grey[place].tobytes()
        assert picture.annotations["status"] == status
        assert (picture.annotations["sequence"] is None) == (status == "searching")
        assert (len(picture.annotations["outline"]) > 50) == (status == "tracking")
    assert [len(picture.annotations[key]) for key in ("targets", "strangers")] == [4, 0]
    assert sum(disc["used"] for disc in picture.annotations["detected"]) >= 3
    world.until(lambda: "spheremouse-pictures" not in Path("/proc/self/maps").read_text(), "the memory is given back")


# ---- clients that disconnect or send too much ----


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
    world.until(lambda: answer.update(_try(world, command)) or answer, "a client is answered")
    if command == "record":
        world.until(lambda: (ask(world, "status")["recording"] or {}).get("frames", 0) > 3)
        ask(world, "record", stop=True)
    folder = world.folder / "recordings"
    left = list(folder.iterdir()) if folder.exists() else []
    assert len(left) == (command != "reinit")
    world.until(lambda: threading.active_count() <= threads, "threads end")
    assert not said(world, "internal error")


def _still(world):
    before = ask(world, "status")["frames"]
    time.sleep(0.3)
    return ask(world, "status")["frames"] == before


def _try(world, command):
    try:
        return ask(world, command)
    except ControlError:
        return {}


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
    folder = ask(world, "record", folder="first")["folder"]
    assert "already" in refused(world, "record")
    world.until(lambda: (ask(world, "status")["recording"] or {}).get("frames", 0) > 10, "frames recorded")
    ended = ask(world, "record", stop=True)
    assert ended["folder"] == folder
    assert ended["frames"] > 10
    assert "nothing is being recorded" in refused(world, "record", stop=True)
    assert ask(world, "status")["recording"] is None
    assert [f.image.ndim for f in read_frames(open_dataset(Path(folder)))] == [3, *(ended["frames"] - 1) * [2]]
    monkeypatch.setattr(loader_module, "read_run_config", read.append)
    ask(world, "record", folder="second")
    world.until(lambda: (ask(world, "status")["recording"] or {}).get("frames", 0) > 3)
    assert ask(world, "set", assignments=["motion.scale_x=2", "pointer.rate=500"])["changed"] == ["motion", "pointer"]
    assert ask(world, "status")["recording"] is not None
    message = ask(world, "set", assignments=["so3.acceleration_sigma=30"])["message"]
    assert message.endswith("; the recording has ended, since it holds one tracker configuration")
    world.until((world.folder / "recordings" / "second" / "scene.json").exists)
    assert ask(world, "status")["recording"] is None
    assert read == []


def test_a_disk_that_is_full_ends_a_recording_and_nothing_else(world, monkeypatch):

    def refuse(*_, **__):
        raise OSError(28, "No space left on device")

    ask(world, "record", folder="first")
    world.until(lambda: (ask(world, "status")["recording"] or {}).get("frames", 0) > 3)
    monkeypatch.setattr("spheremouse.files.dataset.write.FilmWriter.add", refuse)
    world.until(lambda: said(world, "No space left"), "said")
    assert ask(world, "status")["recording"] is None
    world.turn()
    near(world)
    assert world.state == "tracking"


# ---- the service manager ----


@pytest.mark.slow
def test_systemd_hears_of_readiness_and_of_progress_and_of_nothing_else(unstarted, monkeypatch):
    """READY when the control socket answers; WATCHDOG after frames or attempts; a driver that hangs starves it."""
    world = unstarted
    heard = []
    monkeypatch.setattr("sdnotify.SystemdNotifier.notify", lambda _, text: heard.append(text))
    monkeypatch.setenv("WATCHDOG_USEC", "40000")
    monkeypatch.setattr("spheremouse.session.live_run.MAX_FRAME_GAP_S", 0.3)

    def fed():
        heard.clear()
        time.sleep(0.3)
        return heard.count("WATCHDOG=1")

    world.start()
    world.until(lambda: "READY=1" in heard)
    assert ask(world, "status")["pid"] == os.getpid()
    world.reach("tracking")
    world.until(lambda: any(line.startswith("STATUS=tracking: ") for line in heard))
    assert fed() > 0
    world.missing = "unplugged"
    world.reach("no-camera")
    assert fed() > 0  # it is looked for again and again
    world.missing, world.hang = "", threading.Event()
    world.until(lambda: fed() == 0, "starved")
    assert fed() == 0
    world.hang.set()
    world.hang = None
    world.reach("tracking")
    assert fed() > 0
    world.stop()
    assert "STOPPING=1" in heard
    assert not said(world, "internal error")


# ---- errors of our own ----


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
            assert "internal error (ZeroDivisionError: as if)" in refused(world, command)
        world.until(lambda: said(world, "internal error") or said(world, "Traceback"))
        world.settle()
        assert world.state == "tracking"
        assert ask(world, command)


# ---- the process ----


class Process:
    """`spheremouse run` on a film, in a process of its own."""

    def __init__(self, folder, stderr=None, uid=""):
        self.folder, self.ask, self._log = folder, Client(folder / "s").ask, folder / f"{time.monotonic_ns()}.log"
        code = "import sys, daemon_process; daemon_process.main(*sys.argv[1:])"
        with self._log.open("w") as log:
            self.process = start("-c", code, folder, uid, stderr=log if stderr is None else stderr)

    @property
    def said(self):
        return self._log.read_text()

    def until(self, condition):
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"it never came to be: {self.said}"
            assert self.process.poll() is None, f"ended: {self.said}"
            time.sleep(0.02)

    def until_tracking(self):
        def tracks():
            with contextlib.suppress(ControlError):
                return self.ask("status")["state"] == "tracking"

        self.until(tracks)

    def until_frames(self, more):
        frames = self.ask("status")["frames"] + more
        self.until(lambda: self.ask("status")["frames"] >= frames)

    def terminated(self):
        """It ends as it should, with the map saved."""
        self.process.terminate()
        assert self.process.wait(PATIENCE) == 0
        assert (self.folder / "rig.map.yaml").exists()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait(PATIENCE)


@pytest.fixture
def prepared(film):
    """A folder that another user may enter, with the film and what a daemon needs."""
    with tempfile.TemporaryDirectory() as folder:
        daemon_process.prepare(Path(folder), film)
        yield Path(folder)


@pytest.mark.slow
def test_signals_a_second_instance_and_kill_9(prepared):
    """A file stands for the camera's node: SIGHUP reloads, a second daemon is refused, kill -9 leaves nothing stuck,
    SIGTERM ends it with the map saved."""
    with Process(prepared) as first:
        first.until_tracking()
        first.process.send_signal(signal.SIGHUP)
        first.process.send_signal(signal.SIGHUP)
        first.until(lambda: "configuration applied: nothing has changed" in first.said)
        second = Process(prepared)
        assert second.process.wait(PATIENCE) == 2
        assert f"in use by another spheremouse (process {first.process.pid})" in second.said
        assert first.ask("status")["pid"] == first.process.pid
    assert (prepared / "s").exists()  # stale, after kill -9: nobody could remove it
    with Process(prepared) as third:
        third.until_tracking()
        assert third.ask("status")["pid"] == third.process.pid
        third.until_frames(100)  # enough to know some discs for good
        third.terminated()
        assert not (prepared / "s").exists()


@pytest.fixture(params=["closed pipe", "full disk", "pipe that nobody reads"])
def broken_stderr(request):
    reads, writes = os.pipe()
    with os.fdopen(writes, "wb"), os.fdopen(reads, "rb") as reader, open("/dev/full", "wb") as full:
        fcntl.fcntl(writes, fcntl.F_SETPIPE_SZ, 4096)
        if request.param == "closed pipe":
            reader.close()
        yield full if request.param == "full disk" else writes


@pytest.mark.slow
def test_nothing_that_happens_to_standard_error_stops_tracking(prepared, broken_stderr):
    """However much there is to say; and the end is an end like any other."""
    with Process(prepared, broken_stderr) as daemon:
        daemon.until_tracking()
        for _ in range(60):  # lines of 60 letters: more than the pipe takes
            daemon.ask("pause")
            daemon.ask("resume")
        daemon.until_frames(50)
        daemon.terminated()


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become a user whose tasks are limited")
def test_without_another_thread_to_be_had_only_what_needs_one_fails(prepared):
    """The task limit is the kernel's, reached when the daemon tracks: its own threads are there, and no other comes."""
    with Process(prepared, uid=str(OTHER)) as daemon:
        daemon.until_tracking()
        assert Path(daemon.ask("snapshot")["file"]).exists()
        assert daemon.ask("record")["folder"]
        with pytest.raises(ControlError, match="refuses a new thread, as its limit of tasks"):
            daemon.ask("set", assignments=["output=text:/dev/null"])
        assert daemon.ask("status")["outputs"][0]["spec"] == "null"
        assert daemon.ask("reload")["changed"] == []
        assert daemon.ask("set", assignments=["motion.scale_x=2"])["changed"] == ["motion"]
        assert daemon.ask("reinit")["message"]
        daemon.until_frames(100)
        daemon.terminated()
        assert "Traceback" not in daemon.said
        assert "internal error" not in daemon.said


def test_a_client_gets_the_samples_that_a_text_output_writes(unstarted, tmp_path):
    check_samples(unstarted, tmp_path / "run.jsonl", 40)


def test_who_is_refused_has_emptied_no_file(world, tmp_path):
    """A second run with the same configuration finds the socket taken before it opens its output."""
    path = tmp_path / "out.txt"
    path.write_text("what the first run has written\n")
    overrides = CommandLineOverrides(world.config, (f"output=text:{path}",))
    parts = LiveRun(overrides, read_run_config(overrides), Setup(), lambda _: world.open_camera, lambda _: None)
    with pytest.raises(ControlError, match="another daemon listens there"):
        run_module.Daemon(parts).run(world)
    assert path.read_text() == "what the first run has written\n"
