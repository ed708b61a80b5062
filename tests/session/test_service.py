"""The daemon as a whole, in this process: a film behind a scripted camera, a control socket, and faults at each edge.

Laws that hold in every test, checked at its end: nothing is sent in any state but tracking; what frames gave is what
was sent, was counted as unsent, or is still withheld; every frame was looked at or counted as skipped, and given back.
"""

import contextlib
import json
import re
import threading
import time

import cv2
import numpy as np
import pytest
from control_world import conversations, reply_to
from daemon_world import CLOSE, DT

from spheremouse.files.rig import rig_text
from spheremouse.session import config_reloader as loader_module
from spheremouse.session import service as run_module
from spheremouse.session.control.client import Client
from spheremouse.session.picture_feed import PictureFeed
from spheremouse.session.process.threads import as_future

PATIENCE = 60.0  # s


def test_what_is_answered_has_the_keys_that_the_page_shows(unstarted):
    """docs/control.md, whose examples another test plays with a server that says them."""
    world = unstarted
    world.saved = world.folder / "saved.yaml"
    world.saved.write_text("motion: {scale_y: 2}\n")
    world.start()
    world.reach("tracking")
    assert world.logged("saved.yaml: in place of the configuration file: motion.scale_y=2")
    assert world.ask("status")["saved"] == ["motion.scale_y=2"]
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
        "picture": {},
        "settings": {},
        "scene": {},
        "stop": {},
    }.items():
        with Client(world.socket) as client:  # after a picture come its pixels
            reply = client.ask(command.removesuffix("True"), **arguments)
        assert set(reply) - {"ok", "id"} == shown[command], (command, reply)
        parts = {"scene": ["camera"], "settings": ["settings", 0]}.get(command, [])
        page = reply_to({"command": command}) if parts else {}
        for part in parts:
            reply, page = reply[part], page[part]
        assert reply.keys() >= page.keys()


def test_nothing_is_sent_for_the_time_asleep(world, monkeypatch):
    """The ball turns while the computer sleeps. The stamps show no gap, since the monotonic clock stood."""
    asleep, clock = [0.0], time.clock_gettime
    monkeypatch.setattr(time, "clock_gettime", lambda which: clock(which) + asleep[0] * (which == time.CLOCK_BOOTTIME))
    world.turn()
    world.settle()
    world.check_counts()
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
    assert world.logged("the computer slept for 3600 s: motion meanwhile is not counted")
    since = world.stamp
    world.turn(20)
    true = world.true_counts(since=since)
    assert np.abs(world.counts - before - true).max() < CLOSE
    assert np.abs(true).max() > 100


def test_counts_are_the_integral_of_the_motion(world):
    world.check_counts()
    assert np.abs(world.counts).max() > 200
    world.turn(20)
    world.check_counts()
    status = world.ask("status")
    assert status["state"] == "tracking"
    assert (status["damaged"], status["unseen_s"], status["lost_count"]) == (0, 0.0, 0)
    assert status["outputs"][0] == {"spec": "sink:quiet", "failed": None, "reports": status["outputs"][0]["reports"],
                                "unsent": [0, 0, 0], "ahead": [0, 0, 0], "left_out": None, "dropped": 0,
                                    "latency_ms": status["latency_ms"]}  # fmt: skip
    world.until(lambda: set(world.ask("status")["stages_ms"]) == {"wait", "decode", "detect", "filter"})
    assert status["discs"] >= 4
    assert status["pose"]["position_m"][2] == pytest.approx(2.35, abs=0.01)
    assert "off" in status["scheduling"]


def test_a_camera_that_is_missing_at_the_start_is_waited_for(unstarted):
    world = unstarted
    world.missing = "no such device; plug it in"
    world.start()
    world.until(lambda: world.state == "no-camera", "no-camera")
    assert world.ask("status")["reason"] == world.missing
    assert "no picture" in world.refused("reinit")
    assert "no picture" in world.refused("snapshot")
    assert "camera's pose" in world.refused("record")
    world.missing = ""
    world.reach("tracking")
    world.turn()
    world.check_counts()
    assert len(world.logged("plug it in")) == 1  # once, however many attempts


def test_a_camera_is_unplugged_and_comes_back(world):
    in_thread = lambda work: threading.Thread(target=work).start()  # noqa: E731
    snapshots = as_future(lambda: [world.ask("snapshot") for _ in range(500)], in_thread)
    world.settle()
    world.missing = "unplugged"
    world.reach("no-camera")
    assert "no picture now" in str(snapshots.exception(PATIENCE))  # who waits for a frame is told
    before = world.counts
    world.place = 20  # the ball is turned meanwhile
    world.until(lambda: world.ask("status")["unseen_s"] > 0.02)
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
    status = world.ask("status")
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
    world.ask("set", assignments=["pointer.horizon=0.25"])
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
    assert reason in world.ask("status")["reason"]
    if fault == "size":
        assert cv2.imread(world.ask("snapshot")["file"]).shape == (960, 1280, 3)
    world.until(lambda: world.opened > opened, "opened anew")
    world.fault = ""
    world.reach("tracking")
    before = world.counts
    world.until(lambda: world.turn(5) or np.abs(world.counts - before).max() > 20)
    assert (world.ask("status")["damaged"] > 0) == (fault == "damaged")
    assert len(world.logged(reason)) <= 2  # not at every frame


def test_an_output_that_fails_is_opened_again_and_what_it_missed_is_counted(world):
    before = world.counts
    world.broken = "uinput is gone"
    world.turn(20)
    world.reach("failed-output")
    assert world.ask("status")["reason"] == "uinput is gone"
    unseen = world.ask("status")["unseen_s"]
    world.turn(10)
    assert world.ask("status")["unseen_s"] == unseen  # it was seen: the counts say what is missing
    world.broken = ""
    world.reach("tracking")
    world.settle()
    assert np.array_equal(world.counts, before)  # no jump
    assert any(world.ask("status")["outputs"][0]["unsent"])


def test_each_section_is_applied_between_two_frames(world, monkeypatch):
    monkeypatch.setattr(loader_module, "check_kinds", lambda *_: None)  # this world has kinds of its own
    frames = len(world.frames)
    assert world.ask("set", assignments=["motion.scale_y=3"])["changed"] == ["motion"]
    world.check_next_turn((1, 3, 1))
    assert world.ask("reload")["changed"] == ["motion"]  # and what was set is over
    assert world.ask("status")["changes"] == []
    before = world.counts
    assert world.ask("set", assignments=["tracker=ekf1"])["changed"] == ["tracker", "map"]
    world.turn()
    world.until(lambda: np.abs(world.counts - before).max() > 50)
    assert world.ask("set", assignments=["tracker=so3"])["changed"] == ["tracker", "map"]
    world.turn()
    assert world.ask("set", assignments=["pointer.rate=500"])["changed"] == ["pointer"]
    assert world.ask("set", assignments=["record.seconds=3"])["changed"] == ["record"]
    opened = world.opened
    assert world.ask("set", assignments=["source=synthetic:again"])["changed"] == ["source"]
    world.until(lambda: world.opened == opened + 1)
    assert world.ask("set", assignments=["output=sink:other"])["changed"] == ["output"]
    world.until(lambda: world.outputs == ["sink:quiet", "sink:other"])
    assert world.ask("set", assignments=[f"map={world.folder}/other.yaml"])["changed"] == ["map"]
    assert (world.folder / "rig.map.yaml").exists()
    assert world.refused("set", assignments=["motion.nothing=1"])
    assert world.ask("set", assignments=["tracker=so3"])["changed"] == []
    world.turn()
    assert len(world.ask("status")["changes"]) < 12  # the last of each
    assert len(world.frames) > frames
    assert not world.logged("internal error")
    assert not world.logged("output: ")  # the second was opened when the first was closed, and not before


def test_an_output_that_leaves_the_third_axis_out_says_so_when_it_is_taken(world, monkeypatch):
    monkeypatch.setattr(loader_module, "check_kinds", lambda *_: None)  # this world has kinds of its own
    words = "the third axis (the ball's spin) is not sent: output "
    assert world.ask("status")["outputs"][0]["left_out"] is None  # nobody knows of this world's outputs
    for spec, told in (("uinput", 1), ("uinput:third=wheel", 1), ("desktop", 2)):
        world.ask("set", assignments=[f"output={spec}"])
        left_out = world.ask("status")["outputs"][0]["left_out"]
        assert (left_out or "").startswith(words + spec) is ("third=" not in spec)
        assert world.times_logged(words) == told
    sent = sum(any(m.counts) for m in world.sent)
    world.until(lambda: world.ask("status")["outputs"][0]["reports"] == sent)  # those before are closed, and counted


def test_another_rig_is_taken_up_or_refused(world):
    rig = world.folder / "rig.yaml"
    good, frames, before = rig.read_text(), len(world.frames), world.counts
    rig.write_text(good.replace("radius:", "raduis:"))
    assert "rig.yaml:" in world.refused("reload")
    smaller = rig_text(world.film.rig).replace("radius: 0.6", "radius: 0.3", 1)
    assert smaller != good
    rig.write_text(smaller)  # its map, which is saved meanwhile, is of a ball of another size
    assert world.try_to_ask("reload").get("changed", []) in ([], ["rig"])
    rig.write_text(good)
    world.until(lambda: world.try_to_ask("reload"))
    world.reach("tracking")
    world.settle()
    assert np.abs(world.counts - before).max() < CLOSE
    assert len(world.frames) > frames
    assert not world.logged("internal error")


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
        world.ask("set", assignments=[f"motion.scale_y={1 + k % 2}"])
        time.sleep(rng.uniform(0.0, 2.0 * DT))
    assert np.median(gaps) < 0.1 * DT


def test_the_pose_is_estimated_anew_while_the_ball_turns_or_stays_if_targets_are_hidden_and_nothing_jumps(world):
    pose = world.ask("status")["pose"]["position_m"]
    for fault in ("hidden", ""):
        world.fault = fault
        world.settle()
        world.moves = 47
        if fault:
            assert re.search("0 of 4 targets.* stays", world.refused("reinit"))
            assert world.ask("status")["pose"]["position_m"] == pose
        else:
            assert world.ask("reinit")["message"].startswith("camera pose: x ")
        world.until(lambda: world.moves == 0)
        world.settle()
        world.check_counts()
    assert not world.logged("camera was moved")
