"""The page's server: settings, actions, visitors, and requests of a wrong form."""

import json
import socket
import subprocess
import sys
import time
from contextlib import ExitStack

import pytest
import simplejpeg
from daemon_world import World
from page_server import PATIENCE, TOKEN, Browser, act, get, serving
from reporting import free_port
from view_world import wait_for
from websockets.exceptions import ConnectionClosed, InvalidStatus

from spheremouse.commands.view import page_address
from spheremouse.errors import ControlError
from spheremouse.view import server as server_module


def test_a_browser_gets_settings_status_pictures_and_each_sample_once(world, page):
    with Browser(page) as browser:
        hello = browser.until("hello", lambda m: m["settings"])
        assert hello["owner"] is True
        assert {"motion.scale_x", "discs.contrast"} <= {about["key"] for about in hello["settings"]}
        assert browser.until("status", lambda m: m["status"])["status"]["state"] == "tracking"
        first = browser.picture()
        assert simplejpeg.decode_jpeg(first["jpeg"]).shape == (480, 640, 3)
        stamps = [row[0] for row in first["samples"]]
        while len(stamps) < 12:
            frame = browser.frame()
            assert not frame["jpeg"] or frame["stamp"] > first["stamp"]
            stamps += [row[0] for row in frame["samples"]]
        assert stamps == sorted(set(stamps))


def test_a_change_reaches_the_daemon_and_every_browser_and_a_gesture_is_one_step_of_undo(world, page):
    value = lambda: world.client.ask("status")["changes"]  # noqa: E731
    with Browser(page) as one, Browser(page) as other:
        other.until("hello", lambda m: m["settings"])
        for number in (2.0, 2.5, 3.0):
            assert one.ask("set", values={"motion.scale_x": number}, gesture="slide")["type"] == "done"
        assert value() == ["motion.scale_x=3.0"]
        message = other.until("values", lambda m: m["values"].get("motion.scale_x") == 3.0)
        assert message["undo"] == 1
        assert one.ask("set", values={"motion.scale_x": 3.0}, gesture="nothing new")["type"] == "done"
        other.until("values", lambda m: m["unsaved"] == ["motion.scale_x"])
        world.client.ask("set", assignments=["motion.scale_y=4"])
        other.until("values", lambda m: m["values"].get("motion.scale_y") == 4.0)
        assert one.ask("do", action="undo")["type"] == "done"
        undone = other.until("values", lambda m: m["values"]["motion.scale_x"] == 1.0)
        assert (undone["undo"], undone["unsaved"]) == (0, ["motion.scale_y"])  # the value of the file is back
        assert "nothing was changed" in one.ask("do", action="undo")["text"]


def test_a_wrong_value_is_refused_in_words(page):
    with Browser(page) as browser:
        for values, said in (
            ({"motion.scale_x": "two"}, "motion.scale_x: must be a number, is 'two'"),
            ({"motion.nothing": 1}, "motion.nothing"),
            ({"control.group": "x"}, "read at the start only"),
            ({"motion.scale_x": 1e9}, "motion.scale_x: must be"),
        ):
            answer = browser.ask("set", values=values, gesture="g")
            assert (answer["type"], said in answer["text"], "\n" in answer["text"]) == ("trouble", True, False)


def test_buttons_do_what_ctl_does(world, page):
    with Browser(page) as browser:
        assert act(browser, "pause")["message"] == "Paused."
        browser.until("status", lambda m: m["status"]["state"] == "paused")
        assert browser.ask("do", action="resume")["message"] == "Resumed."
        assert act(browser, "snapshot")["message"].endswith(".png")
        assert "recording" in act(browser, "record")["message"]
        assert "nothing" not in act(browser, "record", stop=True)["message"]
        assert act(browser, "reinit")["message"].startswith("camera pose")
        assert "no such action" in act(browser, "rm")["text"]


def test_save_keeps_the_comments_and_export_and_import_are_inverse(world, page):
    world.config.write_text(world.config.read_text() + "# a note\n")
    world.client.ask("reload")
    with Browser(page) as browser:
        browser.until("hello", lambda m: m["settings"])
        browser.ask("set", values={"motion.scale_x": 2.0, "discs.masks": [[1, 2, 3, 4]]}, gesture="g")
        text = act(browser, "export")["data"]["text"]
        assert "motion:\n  scale_x: 2.0" in text
        act(browser, "reset", keys=["motion.scale_x", "discs.masks"])
        assert world.client.ask("status")["changes"] != []
        done = act(browser, "import", text="motion: {scale_x: 2.0}")
        assert done["type"] == "done"
        saved = act(browser, "save")
        assert saved["type"] == "done", saved
        written = world.config.read_text()
        assert "# a note" in written
        assert "scale_x: 2.0" in written
        assert "the imported file:1" in act(browser, "import", text="motion: [")["text"]


def test_settings_that_cannot_be_saved_stay_with_the_reason_and_a_remedy(world, page):
    with Browser(page) as browser:
        browser.ask("set", values={"motion.scale_x": 2.0}, gesture="g")
        world.config.write_text("motion: [")
        assert "config.yaml:1: not YAML" in (text := act(browser, "save")["text"])
        assert "Export in Expert" in text
        assert world.config.read_text() == "motion: ["
        world.config.unlink()
        assert "config.yaml: there is no such file; put it back" in act(browser, "save")["text"]
        assert world.client.ask("status")["changes"] == ["motion.scale_x=2.0"]


def test_where_the_daemon_saves_itself_the_page_leaves_it_to_it(film, tmp_path, monkeypatch):
    world = World(film, tmp_path)
    monkeypatch.setattr("spheremouse.session.outputs.open_output", world.open_output)
    world.saved, before = tmp_path / "saved.yaml", world.config.read_text()
    world.start()
    world.reach("tracking")
    with serving(world.socket) as page, Browser(page) as browser:
        browser.until("hello", lambda m: m["settings"])
        browser.ask("set", values={"motion.scale_x": 2.0}, gesture="g")
        assert act(browser, "save")["message"] == f"{world.saved}: saved: motion.scale_x=2.0"
        browser.until("status", lambda m: m["status"]["saved"] and not m["status"]["changes"])
    assert world.config.read_text() == before
    world.stop()


def test_a_stranger_sees_a_masked_picture_and_changes_nothing(world, page):
    with Browser(page, owner=False) as stranger, Browser(page) as owner:
        assert stranger.until("hello")["owner"] is False
        refused = act(stranger, "pause"), stranger.ask("set", values={"motion.scale_x": 2}, gesture="g")
        assert all("`spheremouse view --url` prints" in answer["text"] for answer in refused)
        assert world.client.ask("status")["changes"] == []
        pictures = (simplejpeg.decode_jpeg(each.picture()["jpeg"]) for each in (stranger, owner))
        masked, whole = (float((picture.max(axis=2) < 20).mean()) for picture in pictures)  # black parts
        assert masked > 0.3
        assert whole < 0.2


def test_the_token_of_the_page_makes_an_owner_and_no_other_cookie_does(alone):
    name = f"spheremouse-{alone}"
    ours = f"{name}={TOKEN}"
    others = ("", f"{name}=wrong", f"{name}=", f"other={TOKEN}", f"spheremouse={TOKEN}", f"{name}1={TOKEN}")
    for owner, cookies in (
        (True, (f"a=b; {ours}", f"{ours}; other[1]=\xe4", f'=;; x="; {ours}')),
        (False, (*others, f"{name}=\xe4", "; ;=;")),
    ):
        for cookie in cookies:
            with Browser(alone, owner=False, additional_headers={"Cookie": cookie}) as browser:
                assert browser.until("hello")["owner"] is owner, cookie


@pytest.fixture
def token_files(tmp_path):
    """Of an own page and that of the service, each has its own token."""
    for name, token in (("own", "another-token-of-more-than-32-characters"), ("service", TOKEN)):
        (tmp_path / name).write_text(token)
    return [tmp_path / "own", tmp_path / "service"]


def test_the_owners_address_has_the_token_of_the_page_that_runs(alone, token_files):
    own, missing = token_files[0], token_files[0].with_name("missing")
    for address in ("127.0.0.1", "0.0.0.0"):
        assert page_address(address, alone, token_files).endswith(f":{alone}/?token={TOKEN}")
    for files, reason in (([own], "another token"), ([own, missing], "missing: cannot be read")):
        with pytest.raises(ControlError, match=reason):
            page_address("127.0.0.1", alone, files)
    assert page_address("127.0.0.1", free_port(), token_files).endswith("another-token-of-more-than-32-characters")


def test_the_owners_address_at_an_address_in_the_network_has_the_token_of_the_page_that_runs(tmp_path, token_files):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        try:
            link.connect(("192.0.2.1", 1))  # sends nothing
        except OSError:
            pytest.skip("this computer has no network")
        address = link.getsockname()[0]
    with serving(tmp_path / "s", address=address) as port:
        assert page_address(address, port, token_files) == f"http://{address}:{port}/?token={TOKEN}"


@pytest.mark.parametrize("origin", ["http://evil.example", None, "http://localhost:1"])
def test_a_foreign_page_gets_403(alone, origin):
    with pytest.raises(InvalidStatus) as e:
        Browser(alone, origin=origin)
    assert e.value.response.status_code == 403


def test_files_are_served_with_a_policy_and_no_other_path_is_opened(alone):
    status, headers, body = get(alone)
    assert status == 200
    assert b"<title>spheremouse</title>" in body
    assert "script-src 'self'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    for path in ("/static/../server.py", "/static/%2e%2e/server.py", "/etc/passwd", "//etc/passwd", "/server.py"):
        assert get(alone, path)[0] == 404
    assert get(alone, Host="evil.example")[0] == 403
    status, headers, _ = get(alone, f"/?token={TOKEN}")
    assert (status, headers["location"]) == (303, "/")
    assert headers["set-cookie"].startswith(f"spheremouse-{alone}={TOKEN};")  # browsers share cookies over ports
    assert "HttpOnly" in headers["set-cookie"]
    assert "SameSite=strict" in headers["set-cookie"]
    assert "set-cookie" not in get(alone, "/?token=wrong")[1]


def test_garbage_is_answered_in_one_line_and_the_connection_stays(page):
    with Browser(page) as browser:
        messages = ('{"type":"x"}', '{"type":[]}', '{"type":"set"}', '{"type":"do","id":"a"}')
        for garbage in ("", "{", "[]", "9" * 90_000, *messages):
            browser.socket.send(garbage)
            assert "\n" not in browser.until("trouble")["text"]
            assert browser.frame()


WRONG = [
    ({"type": "set"}, "values: missing"),
    ({"type": "set", "values": {}, "gesture": "g"}, "values: "),
    ({"type": "set", "values": {"motion.scale_x": 2}, "gesture": 1}, "gesture: must be text"),
    ({"type": "set", "values": {"motion.scale_x": 2}, "gesture": "g", "self": 1}, "self: unknown key"),
    ({"type": "do"}, "action: missing"),
    ({"type": "do", "action": "pause", "arguments": []}, "arguments: "),
    ({"type": "do", "action": "pause", "command": "stop"}, "command: unknown key"),
    *(
        ({"type": "do", "action": action, "arguments": {name: 1}}, f"{action}: {name}: unknown key")
        for action in ("pause", "record", "undo", "play", "compare", "guide", "leave", "stop", "save", "export")
        for name in ("command", "id", "self", "action", "arguments", "model", "x y")
    ),
    ({"type": "do", "action": "replay", "arguments": {"speed": "x"}}, "replay: speed: must be a number"),
    ({"type": "do", "action": "reset", "arguments": {"keys": 5}}, "reset: keys: must be a list"),
    ({"type": "do", "action": "reset", "arguments": {"keys": [[]]}}, "reset: keys[0]: must be text"),
    ({"type": "do", "action": "reset"}, "reset: keys: missing"),
    ({"type": "do", "action": "play", "arguments": {"name": {}}}, "play: name: must be text"),
    ({"type": "do", "action": "compare", "arguments": {"name": "x", "begin": True}}, "begin: must be a number"),
    ({"type": "do", "action": "compare", "arguments": {"name": "x", "end": -1}}, "end: must be at least 0"),
    ({"type": "do", "action": "guide", "arguments": {"do": "rm"}}, "guide: do: must be 'look'"),
    ({"type": "do", "action": "guide", "arguments": {"do": "run", "number": True}}, "number: must be a whole"),
    ({"type": "do", "action": "import", "arguments": {"text": 3}}, "import: text: must be text"),
    ({"type": "do", "action": "undo", "arguments": {"a": json.loads("[" * 20 + "]" * 20)}}, "nested deeper"),
]  # fmt: skip


def test_a_request_of_a_wrong_form_is_answered_at_once_in_words(page):
    with Browser(page) as browser:
        for id_, (message, said) in enumerate(WRONG):
            begun = time.monotonic()
            browser.socket.send(json.dumps({"id": id_, **message}))
            answer = browser.until("trouble")
            assert (said in answer["text"], "\n" in answer["text"]) == (True, False), answer
            assert answer["id"] == (None if said == "nested deeper" else id_)
            assert time.monotonic() - begun < 5.0


def test_an_error_of_the_program_is_answered_too(page, monkeypatch, capfd):
    def fail(*_):
        raise TypeError("a fault")

    monkeypatch.setattr("spheremouse.view.actions.export_settings", fail)
    with Browser(page) as browser:
        assert "internal error (TypeError: a fault)" in act(browser, "export")["text"]
    assert "a fault" in capfd.readouterr().err


def test_the_page_outlives_the_daemon_and_a_browser_the_page(world):
    with serving(world.socket) as port, Browser(port) as browser:
        browser.until("status", lambda m: m["status"])
        world.stop()
        world.client.close()
        assert browser.until("status", lambda m: not m["status"])["reason"]
        assert "no daemon" in act(browser, "pause")["text"]
        world.start()
        world.reach("tracking")
        begun = time.monotonic()
        browser.until("status", lambda m: m["status"])
        browser.picture()
        assert time.monotonic() - begun < 5.0


def test_a_browser_that_never_reads_holds_up_nobody(world, page):
    with Browser(page, close_timeout=0.1) as idle, Browser(page) as browser:
        for _ in range(400):
            idle.socket.send('{"type":"next"}')
        for _ in range(20):
            browser.frame()
        act(browser, "pause")
        act(browser, "resume")


def test_silent_connections_lose_their_places(alone, monkeypatch):
    monkeypatch.setattr(server_module, "_REQUEST_TIMEOUT", 2.0)
    with ExitStack() as stack:
        for k in range(120):
            silent = stack.enter_context(socket.create_connection(("127.0.0.1", alone), timeout=PATIENCE))
            silent.sendall(b"GET / HT" if k % 2 else b"")
        assert get(alone)[0] == 503
        wait_for("a place", lambda: get(alone)[0] == 200, PATIENCE)


def test_too_many_browsers_are_turned_away(alone, monkeypatch):
    monkeypatch.setattr(server_module, "_MAX_BROWSERS", 2)
    with Browser(alone), Browser(alone), pytest.raises((ConnectionClosed, InvalidStatus)):
        Browser(alone).until("hello")


def test_the_process_loads_no_heavy_package():
    code = (
        "import sys, spheremouse.view.server; "
        "heavy = 'scipy', 'cv2', 'matplotlib', 'PIL'; "
        "print(*(m for m in sys.modules if m.split('.')[0] in heavy or '.native.' in m))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "\n"
