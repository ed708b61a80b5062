"""Show the daemon's state in the desktop's tray with pystray, and send the actions of the menu.

The desktop's thread never waits: `link` polls the daemon in one thread and runs each action in another. pystray has two
backends with a menu on Linux, `appindicator` and `gtk`, which need PyGObject.
"""

import contextlib
import importlib
import importlib.util
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from spheremouse.commands.tray import view as tray
from spheremouse.commands.tray.link import Link
from spheremouse.commands.tray.view import View
from spheremouse.errors import SpheremouseError, reason_of
from spheremouse.output.rate_limited_logger import strip_digits

_MENU_REFRESH_S = 10.0  # if only numbers have changed: each update closes an open menu
_HOST_TIMEOUT_S = 60.0  # for a desktop that is still starting
_BUS_TIMEOUT_MS = 1000
_SYSTEM_GI = Path("/usr/lib/python3/dist-packages/gi/__init__.py")  # Debian's PyGObject
_ON_LINUX = sys.platform not in ("win32", "darwin")

MENU_NEEDS = "apt-get install python3-gi gir1.2-ayatanaappindicator3-0.1"


class TrayError(SpheremouseError):
    """There is no tray for the icon."""


class Tray:
    """The icon. Call `run` from the main thread. The link's thread alone changes it. `log` takes a line."""

    def __init__(self, socket: Path | None, log: Callable[[str], None]) -> None:
        self._log = log
        self._notices = tray.Notices()
        self._link = Link(socket, self._show)
        self._closing = threading.Event()
        self._icon: Any = None
        self._state, self._tip, self._items, self._refreshed = "", "", (), 0.0
        self._recording: str | None = None

    def run(self) -> None:
        """Show the icon until Quit or a signal. Raises TrayError if there is no tray."""
        self._pystray, backend = _library()
        for name in ("SIGTERM", "SIGINT", "SIGHUP"):
            if hasattr(signal, name):  # in a thread, since the interrupted thread may hold the desktop's locks
                signal.signal(getattr(signal, name), lambda *_: threading.Thread(target=self.stop, daemon=True).start())
        _wait_for_host(backend, self._closing)
        if self._closing.is_set():
            return
        clicked = "a right click opens the menu, a click estimates the camera pose again"
        click = clicked if self._pystray.Icon.HAS_DEFAULT_ACTION else "a click opens the menu"
        self._log(f"icon by {backend}: {click}")
        first = tray.no_daemon("looking for the daemon")
        picture, tip, menu = tray.icon(first.state), tray.tooltip(first), self._menu(tray.menu(first))
        self._icon = self._pystray.Icon("spheremouse", picture, tip, menu)
        try:
            self._icon.run(self._ready)
        except Exception as e:  # pystray withdraws notices at the end, which fails without a notification service
            if not self._closing.is_set():
                raise TrayError(f"{backend}: {reason_of(e)}") from None
        finally:
            self._link.close()

    def stop(self) -> None:
        """End `run`, from any thread."""
        self._closing.set()
        if self._icon is not None:
            with contextlib.suppress(Exception):  # the desktop may be ending
                self._icon.stop()

    def _ready(self, icon: Any) -> None:
        icon.visible = True
        self._link.start()

    def _show(self, v: View, note: str) -> None:
        try:
            self._update_icon(v, note)
            self._notify(v)
        except Exception as e:  # the desktop may be ending; a lasting error appears at the next start
            logging.getLogger(__name__).debug("icon not updated: %s", e)

    def _update_icon(self, v: View, note: str) -> None:
        """Update icon, tooltip and menu where they changed. A menu that differs in digits alone waits."""
        icon, now = self._icon, time.monotonic()
        if v.state != self._state:
            icon.icon, self._state = tray.icon(v.state), v.state
        tip, items = tray.tooltip(v), tray.menu(v, note)
        if tip != self._tip:
            icon.title = self._tip = tip
        changed = _without_digits(items) != _without_digits(self._items)
        if changed or (items != self._items and now - self._refreshed > _MENU_REFRESH_S):
            icon.menu, self._items, self._refreshed = self._menu(items), items, now

    def _notify(self, v: View) -> None:
        """Notify the user of a change that is worth it, and of a finished recording."""
        text = self._notices.update(v, time.monotonic())
        if v.connected:
            if self._recording is not None and v.recording is None:
                text = f"recorded into {self._recording}"
            self._recording = v.recording
        if text is None:
            return
        self._log(text)
        if self._icon.HAS_NOTIFICATION:
            self._icon.notify(text, "spheremouse")

    def _menu(self, items: tuple[tray.Item, ...]) -> Any:
        return self._pystray.Menu(*(self._menu_item(i) for i in items))

    def _menu_item(self, item: tray.Item) -> Any:
        """Return an entry of the menu as pystray takes it. One without an action is greyed out."""
        if item is tray.SEPARATOR:
            return self._pystray.Menu.SEPARATOR
        action = item.action

        def clicked(*_: Any) -> None:
            if action == "quit":
                self.stop()
            elif action is not None:
                self._link.do(action)

        return self._pystray.MenuItem(item.text, clicked, default=item.default, enabled=action is not None)


def _without_digits(items: tuple[tray.Item, ...]) -> list[Any]:
    return [(strip_digits(i.text), i.action) for i in items]


def _library() -> tuple[Any, str]:
    """Return pystray and the name of its backend; TrayError if none with a menu works."""
    if _ON_LINUX and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise TrayError(
            "there is no display; start it in the desktop's session, where the service's entry starts it at login"
        )
    import_system_gi()
    logger = logging.getLogger("pystray")  # it logs tracebacks while there is no tray yet
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    try:
        pystray = importlib.import_module("pystray")
    except Exception as e:  # each of its libraries raises its own
        raise TrayError(f"no tray can be reached ({reason_of(e)[:200]}); run {MENU_NEEDS}") from None
    backend = pystray.Icon.__module__.rpartition("._")[2]
    if backend == "xorg":  # has no menu
        raise TrayError(f"the menu needs PyGObject; run {MENU_NEEDS}")
    return pystray, backend


def import_system_gi() -> None:
    """Import the system's PyGObject in a virtual environment, since pip would have to compile it."""
    if importlib.util.find_spec("gi") is not None or not _SYSTEM_GI.is_file():
        return
    spec = importlib.util.spec_from_file_location("gi", _SYSTEM_GI)
    assert spec is not None
    assert spec.loader is not None
    sys.modules["gi"] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(sys.modules["gi"])
    except Exception:  # compiled for another Python
        for name in [name for name in sys.modules if name.partition(".")[0] == "gi"]:
            del sys.modules[name]


def has_host(backend: str) -> bool:
    """Return whether there is a tray for the icon of this backend."""
    if backend == "appindicator" and _status_notifier():
        return True
    return backend not in ("appindicator", "gtk") or _has_x11_tray()


def _has_x11_tray() -> bool:
    """Return whether there is a tray of X11, which owns a selection."""
    from Xlib import X
    from Xlib.display import Display
    from Xlib.error import ConnectionClosedError, DisplayError

    try:
        display = Display()
        atom = display.intern_atom(f"_NET_SYSTEM_TRAY_S{display.get_default_screen()}")
        owner = display.get_selection_owner(atom)
        display.close()
    except (DisplayError, ConnectionClosedError, OSError):  # no X server, or it is ending
        return False
    return owner != X.NONE


def _status_notifier() -> bool:
    """Return whether the desktop shows icons by the protocol StatusNotifierItem, as KDE does (on the session bus)."""
    try:
        gio, glib = (importlib.import_module(f"gi.repository.{name}") for name in ("Gio", "GLib"))
        bus = gio.bus_get_sync(gio.BusType.SESSION, None)
        name = glib.Variant("(s)", ("org.kde.StatusNotifierWatcher",))
        dbus = "org.freedesktop.DBus"
        reply = bus.call_sync(dbus, "/org/freedesktop/DBus", dbus, "NameHasOwner", name, None, 0, _BUS_TIMEOUT_MS, None)
        return bool(reply.unpack()[0])
    except Exception:  # neither PyGObject nor a bus is required
        return False


def _wait_for_host(backend: str, closing: threading.Event) -> None:
    end = time.monotonic() + _HOST_TIMEOUT_S
    while not has_host(backend):
        if time.monotonic() > end:
            raise TrayError(advice(os.environ.get("XDG_CURRENT_DESKTOP", "")))
        if closing.wait(1.0):
            return


def advice(desktop: str) -> str:
    """Return the advice if there is no tray for the icon."""
    first = "this desktop has no tray for the icon: "
    if "gnome" in desktop.lower():
        return f"{first}GNOME has one with apt-get install gnome-shell-extension-appindicator, then log in again"
    return f"{first}start a panel that has one (of Xfce, LXQt, MATE, KDE), or trayer"
