"""The tray without a desktop: icons differ without colour, laws of the menu, notices, the link to the daemon."""

import sys
from itertools import combinations

import numpy as np
import pytest
from control_world import a_status
from hypothesis import given, settings
from hypothesis import strategies as st
from reporting import until

from spheremouse.commands.tray import icon as tray_live
from spheremouse.commands.tray import view as tray
from spheremouse.commands.tray.link import Link
from spheremouse.commands.tray.view import NO_DAEMON, SEPARATOR, STATES, Notices, View
from spheremouse.files.token import own_token, token_path
from spheremouse.session.control.protocol import refused
from spheremouse.session.control.server import ControlServer
from spheremouse.session.control.status import StatusReport
from spheremouse.session.settings import ControlSettings

ACTIONS = {"reinit", "pause", "resume", "record", "end-record", "page", "quit", None}


def grey(state, size, ground):
    """The icon on a panel, seen without colours, levels."""
    picture = np.asarray(tray.icon(state, size), dtype=float)
    alpha = picture[..., 3:] / 255.0
    flat = alpha * picture[..., :3] + (1.0 - alpha) * ground
    return flat @ (0.299, 0.587, 0.114)


@pytest.mark.parametrize("size", [16, 22, 24, 32])
@pytest.mark.parametrize("ground", [40, 240], ids=["dark", "light"])
def test_icons_are_seen_on_every_panel_and_differ_without_their_colours(size, ground):
    """Even where all grey values are stretched alike, a tenth of the pixels differs by a third of the range."""
    greys = {state: grey(state, size, ground) for state in (*STATES, "of a later version")}
    for a, b in combinations(greys, 2):
        first, second = ((greys[state] - greys[state].min()) / np.ptp(greys[state]) for state in (a, b))
        assert np.mean(np.abs(first - second) > 0.33) > 0.10, (a, b)
    for state in STATES:
        assert np.mean(np.abs(greys[state] - ground) > 60) > 0.25, state


statuses = st.fixed_dictionaries(
    {},
    optional={
        "state": st.sampled_from(STATES[:-1]) | st.text("a\n\x1b", min_size=1, max_size=200).map(lambda s: f"{s}a"),
        "reason": st.text(max_size=200),
        "fps": st.floats(0.0, 1e6),
        "paused": st.booleans(),
        "recording": st.text(max_size=200).map(
            lambda folder: {"folder": folder, "frames": 1, "seconds": 1.0, "bytes": 1, "dropped": 0}
        ),
    },
)


@settings(max_examples=40)
@given(statuses, st.text(max_size=300))
def test_tooltip_and_menu_are_short_printable_lines_for_any_status(status, note):
    v = tray.view(StatusReport.read(a_status(**status)))
    assert v.connected
    tip, items = tray.tooltip(v), tray.menu(v, note)
    assert len(tip) <= 127
    assert all(c.isprintable() or c == "\n" for c in tip)
    assert tip.startswith("spheremouse: ")
    assert tip.count("\n") <= 1
    assert all(i.text.isprintable() and 0 < len(i.text) <= 90 for i in items)
    assert {i.action for i in items} <= ACTIONS
    assert [i.action for i in items].count("quit") == 1
    assert sum(i.default for i in items) == 1
    assert tray.icon(v.state, 16).size == (16, 16)


@pytest.mark.parametrize(
    ("view", "actions"),
    [
        (View("tracking"), ["reinit", "pause", "record", "page", "quit"]),
        (View("no-camera", paused=True), ["reinit", "resume", "record", "page", "quit"]),
        (View("tracking", recording="/var/r/1"), ["reinit", "pause", "end-record", "page", "quit"]),
        (tray.no_daemon("none"), ["page", "quit"]),
    ],
)
def test_the_menu_offers_the_possible_actions(view, actions):
    assert [item.action for item in tray.menu(view) if item.action is not None] == actions


def test_the_first_line_is_the_state_with_its_reason_or_the_command_that_starts_a_daemon():
    items = tray.menu(View("searching-targets", "1 of 4 targets found"), "paused")
    assert items[0] == tray.Item("searching targets: 1 of 4 targets found")
    assert items[1] == tray.Item("paused")
    assert items[2] is SEPARATOR
    assert [i.text for i in items if i.default] == ["Re-initialise camera pose"]
    v = tray.no_daemon("no daemon runs (no daemon listens at /run/a or /run/b); start one with `spheremouse run`")
    assert tray.headline(v) == "no daemon runs; start one with `spheremouse run`"


def notices_of(transcript):
    """Return times and texts of notices for (time, state) pairs, updated every second."""
    notices, found = Notices(), []
    end = transcript[-1][0]
    for now in range(end + 1):
        state = [s for t, s in transcript if t <= now][-1]
        text = notices.update(View(state), float(now))
        if text is not None:
            found.append((now, text))
    return found


@pytest.mark.parametrize(
    ("transcript", "shown"),
    [
        (
            [(0, "tracking"), (10, "no-camera"), (200, "tracking"), (300, "tracking")],
            [(15, "no camera"), (202, "tracking again")],
        ),
        ([(0, "tracking"), (10, "lost"), (20, "tracking"), (30, "lost"), (40, "tracking"), (60, "tracking")], []),
        ([(0, "tracking"), (5, NO_DAEMON), (12, "starting"), (15, "tracking"), (40, "tracking")], []),
    ],
    ids=["lasts", "short", "a daemon restarts"],
)
def test_a_lasting_problem_and_its_end_are_shown_once_and_a_short_one_never(transcript, shown):
    assert notices_of(transcript) == shown


def test_a_problem_that_returns_is_shown_every_five_minutes():
    flapping = [(t, "no-camera" if (t // 20) % 2 else "tracking") for t in range(0, 1000, 20)]
    times = [t for t, text in notices_of(flapping) if text == "no camera"]
    assert len(times) >= 3
    assert min(np.diff(times)) >= 300


class Daemon(ControlServer):
    """A control server that keeps its requests and reports `state`."""

    def __init__(self, path):
        self.state, self.asked, self.held = "tracking", [], []
        super().__init__(path, ControlSettings(), self.answer)

    def answer(self, pending):
        request, reply = pending.request, pending.answer
        if request.command == "status":
            reply(a_status(state=self.state, reason="as set"))
            return
        self.asked.append(request.model_dump(exclude_defaults=True))
        if request.command == "reinit":
            self.held.append(reply)
        elif request.command == "record":
            reply(refused("disk full"))
        else:
            self.state = {"pause": "paused", "resume": "tracking"}[request.command]
            reply({"state": self.state})


@pytest.fixture
def world(tmp_path):
    """A link without a daemon, and the views that it showed."""
    shown = []
    link = Link(tmp_path / "s", lambda v, note: shown.append((v, note)), every=0.05)
    link.start()
    until(lambda: shown)
    yield tmp_path / "s", link, shown
    link.close()


def test_the_link_outlives_daemons(world):
    path, _, shown = world
    assert shown[-1][0].state == NO_DAEMON
    assert "spheremouse run" in shown[-1][0].reason
    for _ in range(2):
        with Daemon(path) as daemon:
            until(lambda: shown[-1][0] == View("tracking", "as set", 59.9))
            daemon.state = "lost"
            until(lambda: shown[-1][0].state == "lost")
        until(lambda: shown[-1][0].state == NO_DAEMON)


def test_an_action_is_sent_and_its_result_shown(world):
    path, link, shown = world
    link.do("resume")
    until(lambda: shown[-1][1].startswith("no daemon runs"))
    with Daemon(path) as daemon:
        link.do("pause")
        until(lambda: shown[-1][0].state == shown[-1][1] == "paused")
        link.do("resume")
        until(lambda: shown[-1][0].state == "tracking")
        link.do("record")
        until(lambda: shown[-1][1] == "disk full")
        link.do("end-record")
        until(lambda: len(daemon.asked) == 4)
        assert daemon.asked == [
            {"command": "pause"},
            {"command": "resume"},
            {"command": "record", "seconds": 60.0},
            {"command": "record", "stop": True},
        ]


def test_the_live_page_is_opened_as_its_owner(world, tmp_path, monkeypatch):
    _, link, shown = world
    opened = []
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or True)
    link.do("page")
    until(lambda: "start `spheremouse view` first" in shown[-1][1])
    token = own_token(token_path())
    link.do("page")
    until(lambda: shown[-1][1] == "the live page is in the browser")
    assert opened == [f"http://127.0.0.1:8765/?token={token}"]


def test_a_pending_reply_delays_no_other_action(world):
    path, link, shown = world
    with Daemon(path) as daemon:
        for _ in range(5):  # five clicks while one is under way are one
            link.do("reinit")
        until(lambda: daemon.held)
        until(lambda: any("estimating" in note for _, note in shown))
        link.do("pause")
        until(lambda: shown[-1][0].state == "paused")
        assert daemon.asked == [{"command": "reinit"}, {"command": "pause"}]
        daemon.held[0]({"text": "there"})
        until(lambda: shown[-1][1] == "camera pose estimated again")


def test_without_a_display_there_is_one_line_and_at_login_no_error(spheremouse, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert "no display" in spheremouse.fail("tray")
    code, out, err = spheremouse("tray", "--at-login")
    assert (code, out, err.count("\n"), "no display" in err) == (0, "", 1, True)


def test_a_pygobject_of_another_python_is_ignored(monkeypatch, tmp_path):
    package = tmp_path / "gi"
    package.mkdir()
    (package / "__init__.py").write_text("from . import own\n")
    (package / "own.py").write_text("from . import _gi\n")  # there is none for this Python
    monkeypatch.setattr(tray_live.importlib.util, "find_spec", lambda _: None)
    monkeypatch.setattr(tray_live, "_SYSTEM_GI", package / "__init__.py")
    for name in [name for name in sys.modules if name.partition(".")[0] == "gi"]:
        monkeypatch.delitem(sys.modules, name)
    tray_live.import_system_gi()
    assert not [name for name in sys.modules if name.partition(".")[0] == "gi"]
    (package / "_gi.py").touch()
    tray_live.import_system_gi()
    assert sys.modules["gi"].__path__ == [str(package)]
    for name in ("gi", "gi.own", "gi._gi"):
        monkeypatch.delitem(sys.modules, name)
