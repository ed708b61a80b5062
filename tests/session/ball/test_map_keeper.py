"""The map over a run: what is loaded, what replaces what, what is kept aside, and what is said of it."""

import os
import threading
from contextlib import closing

import numpy as np
import pytest
from conftest import directions
from scipy.spatial.transform import Rotation

from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.errors import ConfigurationError
from spheremouse.files.ball_map import load_map, save_map, saved_now
from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.session.ball import map_keeper as session_map
from spheremouse.session.ball.map_keeper import MapKeeper, Newest

CAMERA = InteriorOrientation(640, 480, 600.0, 600.0, 320.0, 240.0)
RIG = Rig(CAMERA, Ball(0.6), Targets((), (), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(3)), 0.02)
BALL, OTHER_BALL = directions(26, 1), directions(24, 2)
R = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix()


def known(d, sigma=1e-3):
    return DiscMap(d, sigma**2 * np.eye(2 * len(d)), np.full(len(d), 50, dtype=np.intp))


def a_frame(found, extends_saved=False):
    """What the keeper takes of a frame."""
    return Newest(lambda: found, extends_saved)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "rig.map.yaml"


def run(path, *states, every=1e9):
    said = []
    with closing(MapKeeper(path, RIG, DiscMap.kind, said.append, every)) as keeper:
        for state in states:
            keeper.keep(state)
    assert all(line.startswith("map: ") for line in said)
    return [line.removeprefix(f"map: {path}: ") for line in said]


def in_file(path):
    return load_map(path).map.directions


# ---- a first run, and the next ----


def test_a_first_run_saves_and_the_next_begins_with_it(path):
    assert run(path, a_frame(None), a_frame(known(BALL[:20]))) == ["20 discs saved"]
    np.testing.assert_allclose(in_file(path), BALL[:20], atol=1e-8)
    with closing(MapKeeper(path, RIG, DiscMap.kind, lambda _: None)) as keeper:
        assert keeper.known is not None
        np.testing.assert_array_equal(keeper.known.directions, in_file(path))
        assert keeper.known.sightings.tolist() == [50] * 20


@pytest.mark.parametrize(
    ("now", "said"),
    [
        (np.delete(BALL, [3, 7], axis=0), "24 discs saved: 23 discs stayed, 2 gone, 1 new"),
        (BALL[:9], "9 discs saved: 9 discs stayed, 16 gone"),  # the tracker has looked for them
    ],
)
def test_a_map_that_the_run_grew_from_it_is_said_in_numbers_and_may_lose_most_of_its_discs(path, now, said):
    save_map(path, saved_now(known(BALL[:25]), RIG))
    assert run(path, a_frame(known(now), extends_saved=True)) == ["25 discs, saved just now", said]
    assert len(in_file(path)) == len(now)
    assert os.listdir(path.parent) == ["rig.map.yaml"]


def test_nothing_known_is_nothing_saved(path):
    assert run(path, a_frame(None)) == ["nothing saved: too little of the ball is known for good"]
    assert run(path) == []  # no frame came
    assert run(path, a_frame(known(BALL, np.nan)))[-1].startswith("nothing saved")
    assert os.listdir(path.parent) == []
    save_map(path, saved_now(known(BALL), RIG))
    before = path.read_bytes()
    assert run(path, a_frame(None)) == ["26 discs, saved just now"]
    assert path.read_bytes() == before


# ---- a map that was not recognised ----


@pytest.mark.parametrize("extends_saved", [False, True])
def test_another_balls_map_takes_its_place_and_the_old_one_is_kept(path, extends_saved):
    """Also if the tracker calls an attitude absolute whose map has nothing in common with the one in the file."""
    save_map(path, saved_now(known(BALL), RIG))
    before = path.read_bytes()
    old = path.with_name("rig.map.old.yaml")
    assert run(path, a_frame(known(OTHER_BALL), extends_saved))[1:] == [
        "another ball, or its discs were moved: a new map of 24 discs saved; the map before is kept in " + str(old)
    ]
    assert old.read_bytes() == before
    np.testing.assert_allclose(in_file(path), OTHER_BALL, atol=1e-8)


def test_the_same_ball_in_another_frame_is_brought_into_the_frame_it_had(path):
    save_map(path, saved_now(known(BALL), RIG))
    old = path.with_name("rig.map.old.yaml")
    said = run(path, a_frame(known(BALL[1:] @ R.T)))
    assert said[1:] == [
        "the same ball with a new map, turned into its earlier axes, 25 discs stayed, 1 gone; "
        f"the map before is kept in {old}"
    ]
    np.testing.assert_allclose(in_file(path), BALL[1:], atol=1e-6)
    assert len(in_file(old)) == 26


def test_a_file_that_was_moved_away_meanwhile_is_not_missed(path):
    save_map(path, saved_now(known(BALL), RIG))
    said = []
    with closing(MapKeeper(path, RIG, DiscMap.kind, said.append)) as keeper:
        path.unlink()
        keeper.keep(a_frame(known(OTHER_BALL)))
    assert said[-1].endswith("a new map of 24 discs saved")
    assert os.listdir(path.parent) == ["rig.map.yaml"]


@pytest.mark.parametrize("few", [BALL[:9] @ R.T, BALL[:9], OTHER_BALL[:6]], ids=["turned", "in place", "another"])
def test_a_poor_map_never_replaces_a_good_one_that_it_did_not_grow_from(path, few):
    save_map(path, saved_now(known(BALL), RIG))
    before = path.read_bytes()
    (text,) = run(path, a_frame(known(few)), every=0.0)[1:]
    assert text == f"stays unchanged, with 26 discs; this run did not recognise it, and knew {len(few)} discs"
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["rig.map.yaml"]


def test_a_run_that_begins_its_map_anew_half_way_keeps_the_frame_of_its_first_half(path):
    """Without a map at the start: 26 discs, lost, and a new map in another frame that grows."""
    states = [a_frame(known(BALL)), a_frame(known(BALL[:8] @ R.T)), a_frame(known(BALL @ R.T))]
    said = run(path, *states, every=0.0)
    np.testing.assert_allclose(in_file(path), BALL, atol=1e-6)
    assert said[-1].startswith("the same ball with a new map, turned into its earlier axes, 26 discs stayed; ")


def test_a_new_balls_map_grows_in_its_own_frame_and_the_old_map_is_set_aside_once(path):
    save_map(path, saved_now(known(BALL), RIG))
    states = [a_frame(known(OTHER_BALL[:n])) for n in (5, 14, 20, 24)]
    said = run(path, *states, every=0.0)
    assert [line for line in said if "another ball" in line] == [said[1]]
    assert said[-1] == "24 discs saved: 14 discs stayed, 10 new"
    np.testing.assert_allclose(in_file(path), OTHER_BALL, atol=1e-8)
    np.testing.assert_allclose(in_file(path.with_name("rig.map.old.yaml")), BALL, atol=1e-8)


# ---- when ----


def test_worth_saving_is_another_disc_or_one_known_twice_as_well():
    a = known(BALL)
    assert not known(BALL, 0.6e-3).improves(a)
    assert known(BALL, 0.4e-3).improves(a)
    assert known(BALL[1:]).improves(a)
    assert a.improves(known(BALL[1:]))
    swapped = BALL.copy()
    swapped[4] = -swapped[4]
    assert known(swapped).improves(a)


def test_it_is_saved_while_the_run_goes_once_it_is_time_and_only_what_has_changed(path):
    said = []
    with closing(MapKeeper(path, RIG, DiscMap.kind, said.append, check_interval_s=0.0)) as keeper:
        keep = keeper.keep
        keep(a_frame(None))
        assert not path.exists()
        keep(a_frame(known(BALL[:10])))
        first = path.stat().st_ino  # a file is replaced, never written over
        keep(a_frame(known(BALL[:10], 0.9e-3)))
        assert path.stat().st_ino == first
        keep(a_frame(known(BALL[:11])))
        assert len(in_file(path)) == 11
    assert said == [f"map: {path}: 11 discs saved"]
    with closing(MapKeeper(path, RIG, DiscMap.kind, said.append, check_interval_s=1e9)) as keeper:
        keeper.keep(a_frame(known(BALL), extends_saved=True))
        assert len(in_file(path)) == 11  # not yet
    assert len(in_file(path)) == 26


def test_a_slow_disk_does_not_hold_up_the_frames(path, monkeypatch):
    """While the first save hangs, states are taken; the last one is what is in the file at the end."""
    slow, go_on = [], threading.Event()

    def hang(*words):
        slow.append(words)
        go_on.wait(60.0)
        save_map(*words)

    def elsewhere(work):
        threading.Thread(target=work).start()

    monkeypatch.setattr(session_map, "save_map", hang)
    with closing(
        MapKeeper(path, RIG, DiscMap.kind, lambda _: None, check_interval_s=0.0, elsewhere=elsewhere)
    ) as keeper:
        for n in range(5, 26):
            keeper.keep(a_frame(known(BALL[:n])))
        assert len(slow) == 1
        assert not path.exists()
        go_on.set()
    assert len(slow) == 2
    assert len(in_file(path)) == 25


# ---- what can go wrong ----


def test_a_disk_that_is_full_is_told_once_and_again_after_a_save_and_the_run_goes_on(path, monkeypatch):
    full, synced, said = False, os.fsync, []

    def sync(file):
        if full:
            raise OSError(28, "No space left on device")
        synced(file)

    monkeypatch.setattr(os, "fsync", sync)
    with closing(MapKeeper(path, RIG, DiscMap.kind, said.append, check_interval_s=0.0)) as keeper:
        for n, full in ((10, True), (12, True), (14, False), (16, True)):  # noqa: B007  `sync` reads it
            keeper.keep(a_frame(known(BALL[:n])))
            assert os.listdir(path.parent) == ([path.name] if n > 12 else [])
    assert said == 2 * [f"map: {path}: not saved: {path}: cannot be written: No space left on device"]


def test_a_folder_that_cannot_be_written_is_told_at_the_start(path, monkeypatch):
    save_map(path, saved_now(known(BALL), RIG))
    monkeypatch.setattr(session_map.os, "access", lambda *_: False)
    before = path.read_bytes()
    said = run(path, a_frame(known(BALL[1:]), extends_saved=True), every=0.0)
    assert said == [
        "26 discs, saved just now",
        f"map: {path.parent}: not writable: the daemon cannot save this run's map",
    ]
    assert path.read_bytes() == before


def test_what_cannot_be_used_is_refused_at_the_start(path, tmp_path):
    with pytest.raises(
        ConfigurationError, match="no such folder; name a place for the map with --map, or give --no-map"
    ):
        MapKeeper(tmp_path / "nowhere" / "m.yaml", RIG, DiscMap.kind, print)
    path.write_text("schema: 1\n")
    with pytest.raises(ConfigurationError, match="move the file away: a new map is made as the ball turns"):
        MapKeeper(path, RIG, DiscMap.kind, print)
    save_map(path, saved_now(known(BALL), RIG))
    other = Rig(CAMERA, Ball(0.03), RIG.targets, 0.002)
    with pytest.raises(ConfigurationError, match=r"was made with a ball of radius 0\.6 m"):
        MapKeeper(path, other, DiscMap.kind, print)
