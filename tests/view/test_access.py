"""Who may use the page, and what it shows of samples and recordings."""

import asyncio
import json
import socket
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
from reporting import report

from spheremouse.errors import ControlError
from spheremouse.files.listing import Listed
from spheremouse.output import open_output
from spheremouse.session.process import child
from spheremouse.session.replay import options_of
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
CONFIG = ("--config", "/etc/c.yaml")
GIVEN = ["source", "rig", "control.socket", "tracker", "so3.acceleration_sigma"]
VALUES = {"source": "v4l2:x", "rig": "r.yaml", "control.socket": "/s", "tracker": "ekf1", "so3.acceleration_sigma": 3.5}
SAVED = {"saved": ["motion.scale_x=2", "rig=r.yaml"], "given": ["motion.scale_y"]}


@pytest.mark.parametrize(
    ("status", "values", "wand", "options"),
    [
        ({"changes": ["discs.contrast=0.3"]}, {}, False, []),
        # those of the daemon's command line hold, except its devices
        (
            {"tracker": "ekf1", "given": GIVEN},
            VALUES,
            False,
            ["--set", 'tracker="ekf1"', "--set", "so3.acceleration_sigma=3.5"],
        ),
        # and come after those that were saved
        (SAVED, {"motion.scale_y": 1.5}, False, ["--set", "motion.scale_x=2", "--set", "motion.scale_y=1.5"]),
        # a recording of the other kind gets its own tracker
        ({}, {}, True, ["--tracker", "wand"]),
        ({"tracker": "wand"}, {}, False, ["--tracker", "so3"]),
        ({"tracker": "wand", "given": ["tracker"]}, {"tracker": "wand"}, True, ["--set", 'tracker="wand"']),
    ],
)
def test_a_recording_is_tracked_by_the_settings_of_the_daemon_except_its_devices(status, values, wand, options):
    assert options_of(STATUS | status, values, Listed(Path("r"), wand=wand)) == [*CONFIG, *options]


def compared(monkeypatch, folder, seconds, changes=(), **scene):
    """The options of `evaluate` for saved and present settings."""
    (folder / "r").mkdir(exist_ok=True)
    (folder / "r/scene.json").write_text(json.dumps({"frames": 30 * seconds, "fps": 30, **scene}))
    asked = []

    async def answer(_, *words, timeout):
        assert timeout is None  # a visitor ends what takes too long
        asked.append(words[4:])  # after evaluate FOLDER --json -
        return {}

    monkeypatch.setattr(child, "answer", answer)
    status = STATUS | {"recordings": str(folder), "changes": ["discs.contrast=0.1"]}  # before the last change

    async def ask(command):
        assert command == "status"
        return status | {"changes": changes}

    daemon = SimpleNamespace(status=status, socket=None, values=lambda: {"values": {}}, ask=ask)
    with ThreadPoolExecutor() as pool:  # since Playwright may have a loop in this thread
        pool.submit(asyncio.run, Recordings(daemon).compare("r", 0.5, seconds - 0.5)).result()
    return asked


def test_a_section_is_tracked_by_the_saved_settings_and_by_those_that_were_changed(monkeypatch, tmp_path):
    section = ("--begin", "0.5", "--end", "1.5")
    assert compared(monkeypatch, tmp_path, 2) == [(*CONFIG, *section)]  # without a change one run is enough
    changed = (*CONFIG, *section, "--set", "discs.contrast=0.3")
    assert compared(monkeypatch, tmp_path, 2, ["discs.contrast=0.3"]) == [(*CONFIG, *section), changed]
    with pytest.raises(ControlError, match="at most 60 s"):
        compared(monkeypatch, tmp_path, 62)
    assert compared(monkeypatch, tmp_path, 62, wand={}) == [(*CONFIG, "--tracker", "wand")]  # which has no section


def test_a_command_that_is_refused_ends_those_beside_it(monkeypatch):
    ended = []

    async def answer(_, word, timeout):
        try:
            await asyncio.sleep(0.0 if word == "refused" else 60.0)
        finally:
            ended.append(word)
        raise ControlError(word)

    async def both():
        with pytest.raises(ControlError, match="refused"):
            await child.answers(None, ["long"], ["refused"])
        await asyncio.sleep(0.0)
        assert ended == ["refused", "long"]

    monkeypatch.setattr(child, "answer", answer)
    with ThreadPoolExecutor() as pool:
        pool.submit(asyncio.run, both()).result()
