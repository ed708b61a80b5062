"""Show the daemon's state in the desktop's tray with pystray, and send the actions of the menu.

The process knows the daemon by its control socket alone, and outlives it. The desktop's thread never waits: `link`
polls the daemon in one thread and runs each action in another. `view` decides what is shown.

pystray has three backends on Linux: `appindicator` and `gtk` have a menu and need PyGObject. `xorg` has no menu, and a
click is the menu's default action.
"""

import contextlib
import importlib
import importlib.util
import logging
import os
import queue
import signal
import sys
import threading
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

from spheremouse.commands.tray import view as tray
from spheremouse.commands.tray.link import Link
from spheremouse.commands.tray.view import View
from spheremouse.errors import SpheremouseError

_MENU_REFRESH_S = 10.0  # if only numbers have changed: each update closes an open menu
_HOST_TIMEOUT_S = 60.0  # for a desktop that is still starting
_SYSTEM_GI = Path("/usr/lib/python3/dist-packages/gi/__init__.py")  # Debian's PyGObject
_EDGE = (24, 26, 28)  # behind the icon's soft edge if a window cannot be transparent: the outline's colour

MENU_NEEDS = "apt-get install python3-gi gir1.2-ayatanaappindicator3-0.1"


class TrayError(SpheremouseError):
    """There is no tray for the icon."""


# ---- the icon ----


class Tray:
    """The icon for the life of the process. Call `run` from the main thread."""

    def __init__(self, socket: Path | None, log: Callable[[str], None]) -> None:
        self._socket, self._log = socket, log
        self._notices = tray.Notices()
        self._icon: Any = None
        self._recording: str | None = None
        self._closing = threading.Event()

    def run(self) -> None:
        """Show the icon until Quit or a signal. Raises TrayError if there is no tray."""
        pystray, backend = _library()
        for name in ("SIGTERM", "SIGINT", "SIGHUP"):
            if hasattr(signal, name):  # in a thread, since the interrupted thread may hold X's locks
                signal.signal(getattr(signal, name), lambda *_: threading.Thread(target=self.stop, daemon=True).start())
        _wait_for_host(backend, self._closing)
        if not self._closing.is_set():
            self._log(f"icon by {backend}: {_capabilities(pystray)}")
        while not self._closing.is_set():
            self._show_icon(pystray, backend)
            if not self._closing.wait(1.0):  # the panel has ended and closed our window
                _wait_for_host(backend, self._closing)

    def stop(self) -> None:
        """End `run`, from any thread."""
        self._closing.set()
        if self._icon is not None:
            with contextlib.suppress(Exception):  # its window may be closed
                self._icon.stop()

    def _show_icon(self, pystray: Any, backend: str) -> None:
        """Show an icon until its window is closed."""
        icon = _DockedIcon(self, pystray, backend, self._socket)
        self._icon = icon.icon
        try:
            icon.run()
        except Exception as e:  # pystray withdraws notices at the end, which fails without a notification service
            if not self._closing.is_set():
                raise TrayError(f"{backend}: {' '.join(str(e).split())}") from None
        finally:
            self._icon = None
            icon.close()

    def notify(self, icon: Any, v: View) -> None:
        """Show a notice if one is due."""
        text = self._notices.update(v, time.monotonic())
        if v.connected:
            if self._recording is not None and v.recording is None:
                text = f"recorded into {self._recording}"
            self._recording = v.recording
        if text is None:
            return
        self._log(text)
        if icon.HAS_NOTIFICATION:
            icon.notify(text, "spheremouse")


class _DockedIcon:
    """An icon in a tray. The link's thread alone changes it."""

    def __init__(self, owner: Tray, pystray: Any, backend: str, socket: Path | None) -> None:
        self._owner, self._pystray, self._backend = owner, pystray, backend
        self._state, self._tip, self._items, self._refreshed = "", "", (), 0.0
        first = tray.no_daemon("looking for the daemon")
        picture, tip, menu = tray.icon(first.state), tray.tooltip(first), self._menu(tray.menu(first))
        self.icon = pystray.Icon("spheremouse", picture, tip, menu)
        if backend == "xorg":
            _patch_xorg(self.icon)
        self.link = Link(socket, self._show)

    def run(self) -> None:
        """Run until the icon is stopped or its window is closed."""
        self.icon.run(self._ready)

    def close(self) -> None:
        """Close the link and the window."""
        self.link.close()
        if self._backend == "xorg":
            with contextlib.suppress(Exception):  # X may be gone
                self.icon._display.close()
            self.icon._running, self.icon._display = False, contextlib.ExitStack()  # pystray closes it again

    def _ready(self, icon: Any) -> None:
        icon.visible = True
        self.link.start()

    def _show(self, v: View, note: str) -> None:
        try:
            self._draw(v, note)
            self._owner.notify(self.icon, v)
        except Exception as e:  # the desktop may be ending; a lasting error appears at the next start
            logging.getLogger(__name__).debug("icon not updated: %s", e)

    def _draw(self, v: View, note: str) -> None:
        icon, now = self.icon, time.monotonic()
        undocked = self._backend == "xorg" and icon._systray_manager is None
        if v.state != self._state or (undocked and has_host(self._backend)):
            icon.icon, self._state = tray.icon(v.state), v.state
        tip, items = tray.tooltip(v), tray.menu(v, note)
        if tip != self._tip:
            icon.title = self._tip = tip
        changed = _without_digits(items) != _without_digits(self._items)
        if changed or (items != self._items and now - self._refreshed > _MENU_REFRESH_S):
            icon.menu, self._items, self._refreshed = self._menu(items), items, now

    def _menu(self, items: tuple[tray.Item, ...]) -> Any:
        return self._pystray.Menu(*(self._item(i) for i in items))

    def _item(self, item: tray.Item) -> Any:
        if item is tray.SEPARATOR:
            return self._pystray.Menu.SEPARATOR
        action = item.action

        def clicked(*_: Any) -> None:
            if action == "quit":
                self._owner.stop()
            elif action is not None:
                self.link.do(action)

        return self._pystray.MenuItem(item.text, clicked, default=item.default, enabled=action is not None)


def _without_digits(items: tuple[tray.Item, ...]) -> list[Any]:
    """Return texts without digits and actions, to compare menus."""
    return [("".join(c for c in i.text if not c.isdigit()), i.action) for i in items]


def _patch_xorg(icon: Any) -> None:
    """Correct pystray 0.19.5 on X11 without a menu.

    It does not select clicks. It docks again with every picture, which trays take for another icon. It stretches
    pictures and puts them on a square of one colour. It fails on titles that are not Latin-1.
    """
    from Xlib import X
    from Xlib.ext import shape

    icon._window.change_attributes(event_mask=X.ExposureMask | X.StructureNotifyMask | X.ButtonPressMask)
    dock = icon._dock_window

    def dock_once(self: Any) -> None:
        if self._systray_manager is None:
            dock()

    def fit(self: Any, width: int, height: int) -> None:
        if self._icon_data is None or self._icon_data.size != (width, height):
            self._icon_data, outline = fit_icon(self.icon, width, height)
            if self._display.has_extension("SHAPE"):
                self._window.shape_rectangles(shape.SO.Set, shape.SK.Bounding, X.YXSorted, 0, 0, outline)

    def title(self: Any) -> None:
        self._window.set_wm_name(self.title.encode("latin-1", "replace").decode("latin-1"))
        names = [self._display.intern_atom(name) for name in ("_NET_WM_NAME", "UTF8_STRING")]
        self._window.change_text_property(*names, self.title)

    icon._dock_window = types.MethodType(dock_once, icon)
    icon._assert_icon_data = types.MethodType(fit, icon)
    changes = {name: getattr(type(icon), name) for name in ("_show", "_hide", "_update_icon", "_stop")}
    _run_in_main_thread(icon, changes | {"_update_title": title})


def _run_in_main_thread(icon: Any, changes: dict[str, Callable[[Any], None]]) -> None:
    """Replace methods of an icon on X11 by ones that run in the main thread.

    pystray's threads share one connection, on which python-xlib sometimes loses an event, and the icon hangs. Here the
    main thread alone uses it. Other threads wake it from connections of their own.
    """
    from Xlib import X
    from Xlib.display import Display
    from Xlib.protocol.event import ClientMessage

    window_id = icon._window.id
    waiting: queue.SimpleQueue[Callable[[Any], None]] = queue.SimpleQueue()

    def wake() -> None:
        display = Display()
        display.set_error_handler(lambda *_: None)  # the window may be closed
        window = display.create_resource_object("window", window_id)
        kind = display.intern_atom("_SPHEREMOUSE_WAKE")
        window.send_event(ClientMessage(window=window, client_type=kind, data=(32, [0] * 5)))
        display.sync()
        display.close()

    def in_main_thread(work: Callable[[Any], None]) -> Callable[[Any], None]:
        def call(self: Any) -> None:
            if threading.current_thread() is threading.main_thread():
                work(self)
            else:
                waiting.put(work)
                wake()

        return call

    def run_waiting(_: Any) -> None:
        while not waiting.empty():
            try:
                waiting.get()(icon)
            except Exception as e:  # otherwise the loop ends
                logging.getLogger(__name__).debug("icon not updated: %s", e)

    for name, work in changes.items():
        setattr(icon, name, types.MethodType(in_main_thread(work), icon))
    icon._message_handlers[X.ClientMessage] = run_waiting


def fit_icon(picture: Image.Image, width: int, height: int) -> tuple[Any, list[tuple[int, int, int, int]]]:
    """Centre a square picture in a rectangle. Also return its opaque rows as (x, y, width, height)."""
    side = min(width, height)
    small = picture.resize((side, side), Image.Resampling.LANCZOS)
    clear, ground = Image.new("RGBA", (width, height)), Image.new("RGBA", (width, height), _EDGE)
    clear.paste(small, ((width - side) // 2, (height - side) // 2))
    whole: Any = Image.alpha_composite(ground, clear).convert("RGB")
    whole.tostring = whole.tobytes  # python-xlib's name for it
    rows = (clear.getchannel("A").point([0] * 128 + [255] * 128).crop((0, y, width, y + 1)) for y in range(height))
    boxes = [(y, row.getbbox()) for y, row in enumerate(rows)]
    return whole, [(box[0], y, box[2] - box[0], 1) for y, box in boxes if box is not None]


# ---- backends ----


def _library() -> tuple[Any, str]:
    """Return pystray and the name of its backend; TrayError if none works."""
    if _on_linux() and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise TrayError(
            "there is no display; start it in the desktop's session, where the service's entry starts it at login"
        )
    import_system_gi()
    if _on_linux() and "PYSTRAY_BACKEND" not in os.environ and not _session_bus():
        os.environ["PYSTRAY_BACKEND"] = "xorg"  # the others need a session bus
    logger = logging.getLogger("pystray")  # it logs tracebacks while there is no tray yet
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    try:
        pystray = importlib.import_module("pystray")
    except Exception as e:  # each of its libraries raises its own
        why = " ".join(str(e).split())[:200] or type(e).__name__
        raise TrayError(f"no tray can be reached ({why}); on Wayland, run {MENU_NEEDS}") from None
    return pystray, pystray.Icon.__module__.rpartition("._")[2]


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


def _on_linux() -> bool:
    return sys.platform not in ("win32", "darwin")


def _session_bus() -> bool:
    try:
        gio = importlib.import_module("gi.repository.Gio")
        gio.bus_get_sync(gio.BusType.SESSION, None)
    except Exception:  # no PyGObject, or no bus
        return False
    return True


def _capabilities(pystray: Any) -> str:
    if pystray.Icon.HAS_MENU:
        if pystray.Icon.HAS_DEFAULT_ACTION:
            return "a right click opens the menu, a click estimates the camera pose again"
        return "a click opens the menu"
    return f"no menu and no notices, a click estimates the camera pose again; for a menu: {MENU_NEEDS}"


def has_host(backend: str) -> bool:
    """Return whether there is a tray for the icon of this backend."""
    if backend == "appindicator" and _status_notifier():
        return True
    return backend not in ("appindicator", "gtk", "xorg") or _xembed()


def _xembed() -> bool:
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
    """Return whether there is a tray of newer desktops, which watches the session bus for status notifiers."""
    try:
        gio, glib = (importlib.import_module(f"gi.repository.{name}") for name in ("Gio", "GLib"))
        bus = gio.bus_get_sync(gio.BusType.SESSION, None)
        name = glib.Variant("(s)", ("org.kde.StatusNotifierWatcher",))
        dbus = "org.freedesktop.DBus"
        reply = bus.call_sync(dbus, "/org/freedesktop/DBus", dbus, "NameHasOwner", name, None, 0, 1000, None)
        return bool(reply.unpack()[0])
    except Exception:  # no bus
        return False


def _wait_for_host(backend: str, closing: threading.Event, seconds: float = _HOST_TIMEOUT_S) -> None:
    end = time.monotonic() + seconds
    while not has_host(backend):
        if time.monotonic() > end:
            wayland = bool(os.environ.get("WAYLAND_DISPLAY"))
            raise TrayError(advice(backend, os.environ.get("XDG_CURRENT_DESKTOP", ""), wayland=wayland))
        if closing.wait(1.0):
            return


def advice(backend: str, desktop: str, *, wayland: bool) -> str:
    """Return the advice if there is no tray for the icon."""
    first = "this desktop has no tray for the icon: "
    gnome = "gnome" in desktop.lower()
    if gnome:
        first += "GNOME has one with apt-get install gnome-shell-extension-appindicator, then log in again"
        return first if backend == "appindicator" else f"{first}; the icon also needs {MENU_NEEDS}"
    if wayland and backend != "appindicator":
        return f"{first}on Wayland it needs {MENU_NEEDS}"
    return f"{first}start a panel that has one (of Xfce, LXQt, MATE, KDE), or trayer"
