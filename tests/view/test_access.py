"""Who may use the page, and what it shows of samples and recordings."""

import asyncio
import json
import socket
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pytest
from reporting import report

from spheremouse.errors import ControlError
from spheremouse.output import open_output
from spheremouse.session.process import child
from spheremouse.view.access import Access
from spheremouse.view.recordings import Recordings

TOKEN = "a-token-of-more-than-32-characters"
HERE, ELSEWHERE = "127.0.0.1", "192.168.1.20"
OWNER, STRANGER = "owner", "stranger"


@pytest.fixture
def access():
    return Access(TOKEN, 8765, ["cabinet.museum"])


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8765", "localhost:8765", "[::1]:8765", "10.0.0.7:8765", "Cabinet.Museum:8765"]
)
def test_our_hosts_pass_with_their_own_origin_and_no_other(access, host):
    assert access.visitor(HERE, host, None) == STRANGER
    assert access.visitor(HERE, host, f"http://{host}") == STRANGER
    for origin in ("null", "", f"http://{host}.evil", "http://evil.example", "http://127.0.0.1:1", f"HTTP://{host}x"):
        assert access.visitor(HERE, host, origin, given=TOKEN) is None


@pytest.mark.parametrize(
    "host", ["", "evil.example:8765", "127.0.0.1", "127.0.0.1:80", "localhost:8765.evil", "[::1]", "1.2.3:8765"]
)
def test_a_foreign_name_for_this_computer_is_refused_even_with_the_token(access, host):
    assert access.visitor(HERE, host, None, given=TOKEN) is None


@pytest.mark.parametrize("cookie", [None, "", "wrong", TOKEN[:-1], "\xe4"])
def test_without_the_token_this_computer_sees_and_others_do_not(access, cookie):
    for here in (HERE, "::1", "127.8.9.1", "::ffff:127.0.0.1"):
        assert access.visitor(here, "127.0.0.1:8765", None, cookie) == STRANGER
    for elsewhere in (ELSEWHERE, "fe80::1", "::ffff:192.168.1.20", "", "localhost"):
        assert access.visitor(elsewhere, "127.0.0.1:8765", None, cookie) is None


def test_the_token_makes_an_owner_in_the_address_or_in_a_cookie(access):
    assert access.visitor(ELSEWHERE, "10.0.0.7:8765", None, given=TOKEN) == OWNER
    assert access.visitor(ELSEWHERE, "10.0.0.7:8765", None, TOKEN) == OWNER


CONNECT = """port => new Promise(resolve => {
  const socket = new WebSocket(`ws://127.0.0.1:${port}`);
  window.samples = [];
  socket.onmessage = message => samples.push(JSON.parse(message.data));
  socket.onopen = resolve;
})"""


def test_a_page_gets_each_sample(browser):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with open_output(f"ws:{port},origin=null") as output, browser.new_page() as page:  # an empty page has no origin
        page.evaluate(CONNECT, port)
        for x in (3, 4):
            output.send(report(x, -2, 1))
        page.wait_for_function("samples.length == 2")
        assert [sample["counts"] for sample in page.evaluate("samples")] == [[3, -2, 1], [4, -2, 1]]


STATUS = {"tracker": "so3", "config": "/etc/c.yaml", "given": [], "changes": []}


def compared(monkeypatch, folder, status, values=None, wand=False, seconds=2):
    """The options of `evaluate` for saved and present settings, as sets of pairs."""
    (folder / "r").mkdir()
    scene = {"frames": 30 * seconds, "fps": 30} | ({"wand": {}} if wand else {})
    (folder / "r/scene.json").write_text(json.dumps(scene))
    asked = []

    async def answer(_, *words, timeout):
        assert timeout is None  # a visitor ends what takes too long
        asked.append(words[4:])  # after evaluate FOLDER --json -
        return {}

    monkeypatch.setattr(child, "answer", answer)

    daemon = SimpleNamespace(
        status=STATUS | {"recordings": str(folder)} | status, socket=None, values=lambda: {"values": values or {}}
    )
    with ThreadPoolExecutor() as pool:  # since Playwright may have a loop in this thread
        pool.submit(asyncio.run, Recordings(daemon).compare("r", 0.5, seconds - 0.5)).result()
    return [{*zip(words[::2], words[1::2], strict=True)} for words in asked]


SECTION = {("--begin", "0.5"), ("--end", "1.5")}
CONFIG = ("--config", "/etc/c.yaml")


def test_the_present_settings_are_the_saved_ones_and_what_was_changed(monkeypatch, tmp_path):
    saved, present = compared(monkeypatch, tmp_path, {"changes": ["discs.contrast=0.3"]})
    assert saved == SECTION | {CONFIG}
    assert present - saved == {("--set", "discs.contrast=0.3")}


def test_without_a_change_one_run_is_enough(monkeypatch, tmp_path):
    assert len(compared(monkeypatch, tmp_path, {})) == 1


def test_settings_of_the_daemons_command_line_hold_except_its_devices(monkeypatch, tmp_path):
    given = ["source", "rig", "control.socket", "tracker", "so3.acceleration_sigma"]
    values = {
        "source": "v4l2:x",
        "rig": "r.yaml",
        "control.socket": "/s",
        "tracker": "ekf1",
        "so3.acceleration_sigma": 3.5,
    }
    (words,) = compared(monkeypatch, tmp_path, {"tracker": "ekf1", "given": given}, values)
    assert words == SECTION | {CONFIG, ("--set", 'tracker="ekf1"'), ("--set", "so3.acceleration_sigma=3.5")}


def test_saved_settings_hold_and_those_of_the_command_line_come_after_them(monkeypatch, tmp_path):
    status = {"saved": ["motion.scale_x=2", "rig=r.yaml"], "given": ["motion.scale_y"], "changes": ["motion.scale_x=3"]}
    saved, present = compared(monkeypatch, tmp_path, status, {"motion.scale_y": 1.5})
    assert saved == SECTION | {CONFIG, ("--set", "motion.scale_x=2"), ("--set", "motion.scale_y=1.5")}
    assert present - saved == {("--set", "motion.scale_x=3")}


@pytest.mark.parametrize(("tracker", "wand", "other"), [("so3", True, "wand"), ("wand", False, "so3")])
def test_a_recording_of_the_other_kind_gets_its_own_tracker(monkeypatch, tmp_path, tracker, wand, other):
    (words,) = compared(monkeypatch, tmp_path, {"tracker": tracker}, wand=wand)
    assert ("--tracker", other) in words


@pytest.mark.parametrize(("tracker", "wand"), [("so3", False), ("wand", True)])
def test_a_recording_of_the_same_kind_keeps_the_tracker(monkeypatch, tmp_path, tracker, wand):
    (words,) = compared(
        monkeypatch, tmp_path, {"tracker": tracker, "given": ["tracker"]}, {"tracker": tracker}, wand=wand
    )
    assert ("--set", f'tracker="{tracker}"') in words
    assert not any(option == "--tracker" for option, _ in words)


def test_a_long_section_is_refused_but_not_of_a_ball_in_a_hand_which_has_none(monkeypatch, tmp_path):
    with pytest.raises(ControlError, match="at most 60 s"):
        compared(monkeypatch, tmp_path, {}, seconds=62)
    (tmp_path / "r/scene.json").unlink()
    (tmp_path / "r").rmdir()
    (words,) = compared(monkeypatch, tmp_path, {"tracker": "wand"}, wand=True, seconds=62)
    assert words == {CONFIG}
