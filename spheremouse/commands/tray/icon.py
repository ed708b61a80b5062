"""The tray's process: asks the daemon every second, shows it with pystray, passes on what is clicked.

It knows the daemon by its control socket only, and outlives it. The desktop's thread waits for nobody: a thread asks
and shows, each thing that is clicked has one of its own. What is shown is in `tray`.

pystray shows an icon in three ways on Linux: `appindicator` and `gtk` (with a menu; both need PyGObject) and `xorg`
(no menu: a click is the menu's default entry).
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

_OLD = 10.0  # s after which a line in the menu is renewed where only its numbers have changed; that closes an open menu
_FOR_A_HOST = 60.0  # s to wait for a desktop that is only just coming up
_SYSTEMS_GI = Path("/usr/lib/python3/dist-packages/gi/__init__.py")  # Debian's PyGObject
_EDGE = (24, 26, 28)  # what an icon's soft edge goes over into where nothing shines through: the outline's own colour

MENU_NEEDS = "apt-get install python3-gi gir1.2-ayatanaappindicator3-0.1"


class TrayError(SpheremouseError):
    """There is no tray to put an icon into."""


# ---- the desktop's side ----


class Tray:
    """The icon of one run. `run` belongs to the main thread."""

    def __init__(self, socket: Path | None, say: Callable[[str], None]) -> None:
        self._socket, self._say = socket, say
        self._notices = tray.Notices()
        self._icon: Any = None
        self._recording: str | None = None
        self._over = threading.Event()

    def run(self) -> None:
        """Until Quit is clicked or a signal comes. TrayError where there is no tray."""
        pystray, backend = _library()
        for name in ("SIGTERM", "SIGINT", "SIGHUP"):
            if hasattr(signal, name):  # in a thread: the signal may have hit the one that is to stop, holding X's locks
                signal.signal(getattr(signal, name), lambda *_: threading.Thread(target=self.stop, daemon=True).start())
        _wait_for_host(backend, self._over)
        if not self._over.is_set():
            self._say(f"icon by {backend}: {_what_it_can(pystray)}")
        while not self._over.is_set():
            self._once(pystray, backend)
            if not self._over.wait(1.0):  # the panel has ended, and taken our window with it
                _wait_for_host(backend, self._over)

    def stop(self) -> None:
        """End `run`, from any thread."""
        self._over.set()
        if self._icon is not None:
            with contextlib.suppress(Exception):  # it may have ended by itself
                self._icon.stop()

    def _once(self, pystray: Any, backend: str) -> None:
        """As long as the icon's window lives."""
        shown = _Shown(self, pystray, backend, self._socket)
        self._icon = shown.icon
        try:
            shown.run()
        except Exception as e:  # pystray takes back notices at the end, which fails where nobody shows any
            if not self._over.is_set():
                raise TrayError(f"{backend}: {' '.join(str(e).split())}") from None
        finally:
            self._icon = None
            shown.close()

    def tell(self, icon: Any, v: View) -> None:
        """Show a notice of what is worth one."""
        text = self._notices.see(v, time.monotonic())
        if v.there:
            if self._recording is not None and v.recording is None:
                text = f"recorded into {self._recording}"
            self._recording = v.recording
        if text is None:
            return
        self._say(text)
        if icon.HAS_NOTIFICATION:
            icon.notify(text, "spheremouse")


class _Shown:
    """An icon in a tray, and the link whose thread alone changes it."""

    def __init__(self, owner: Tray, pystray: Any, backend: str, socket: Path | None) -> None:
        self._owner, self._pystray, self._backend = owner, pystray, backend
        self._state, self._tip, self._items, self._renewed = "", "", (), 0.0
        first = tray.no_daemon("looking for the daemon")
        picture, tip, menu = tray.icon(first.state), tray.tooltip(first), self._menu(tray.menu(first))
        self.icon = pystray.Icon("spheremouse", picture, tip, menu)
        if backend == "xorg":
            _mend_xorg(self.icon)
        self.link = Link(socket, self._show)

    def run(self) -> None:
        """Until the icon is stopped, or its window is gone."""
        self.icon.run(self._ready)

    def close(self) -> None:
        """Whatever ended it: no window of it stays."""
        self.link.close()
        if self._backend == "xorg":
            with contextlib.suppress(Exception):  # X may be gone
                self.icon._display.close()
            self.icon._running, self.icon._display = False, contextlib.ExitStack()  # which pystray closes again

    def _ready(self, icon: Any) -> None:
        icon.visible = True
        self.link.start()

    def _show(self, v: View, note: str) -> None:
        try:
            self._draw(v, note)
            self._owner.tell(self.icon, v)
        except Exception as e:  # a desktop that is just going down; what is wrong for good is seen at the next start
            logging.getLogger(__name__).debug("not shown: %s", e)

    def _draw(self, v: View, note: str) -> None:
        icon, now = self.icon, time.monotonic()
        undocked = self._backend == "xorg" and icon._systray_manager is None
        if v.state != self._state or (undocked and host_there(self._backend)):
            icon.icon, self._state = tray.icon(v.state), v.state
        tip, items = tray.tooltip(v), tray.menu(v, note)
        if tip != self._tip:
            icon.title = self._tip = tip
        update = _letters(items) != _letters(self._items)
        if update or (items != self._items and now - self._renewed > _OLD):
            icon.menu, self._items, self._renewed = self._menu(items), items, now

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


def _letters(items: tuple[tray.Item, ...]) -> list[Any]:
    """A menu without its numbers: whether it is the same one."""
    return [("".join(c for c in i.text if not c.isdigit()), i.action) for i in items]


def _mend_xorg(icon: Any) -> None:
    """Do what pystray 0.19.5 does not do on bare X11.

    It asks for no clicks, docks again with every picture, which trays take for another icon, stretches pictures, puts
    them on a square of one colour, whatever the panel's, and ends where a title is not Latin-1.
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
            self._icon_data, outline = _fitted(self.icon, width, height)
            if self._display.has_extension("SHAPE"):
                self._window.shape_rectangles(shape.SO.Set, shape.SK.Bounding, X.YXSorted, 0, 0, outline)

    def title(self: Any) -> None:
        self._window.set_wm_name(self.title.encode("latin-1", "replace").decode("latin-1"))
        names = [self._display.intern_atom(name) for name in ("_NET_WM_NAME", "UTF8_STRING")]
        self._window.change_text_property(*names, self.title)

    icon._dock_window = types.MethodType(dock_once, icon)
    icon._assert_icon_data = types.MethodType(fit, icon)
    changes = {name: getattr(type(icon), name) for name in ("_show", "_hide", "_update_icon", "_stop")}
    _leave_to_main_thread(icon, changes | {"_update_title": title})


def _leave_to_main_thread(icon: Any, changes: dict[str, Callable[[Any], None]]) -> None:
    """Methods of an icon on bare X11, by name, as the main thread alone may do them.

    pystray's threads share one connection, on which python-xlib now and then loses an event, and the icon then hangs:
    here the main thread alone has it, and others wake it from connections of their own.
    """
    from Xlib import X
    from Xlib.display import Display
    from Xlib.protocol.event import ClientMessage

    window_id = icon._window.id
    waiting: queue.SimpleQueue[Callable[[Any], None]] = queue.SimpleQueue()

    def wake() -> None:
        display = Display()
        display.set_error_handler(lambda *_: None)  # the window may just have gone
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

    def awake(_: Any) -> None:
        while not waiting.empty():
            try:
                waiting.get()(icon)
            except Exception as e:  # the loop would end
                logging.getLogger(__name__).debug("not shown: %s", e)

    for name, work in changes.items():
        setattr(icon, name, types.MethodType(in_main_thread(work), icon))
    icon._message_handlers[X.ClientMessage] = awake


def _fitted(picture: Image.Image, width: int, height: int) -> tuple[Any, list[tuple[int, int, int, int]]]:
    """A square picture in the middle of a rectangle, and what of it is seen: rows as x, y, width, height."""
    side = min(width, height)
    small = picture.resize((side, side), Image.Resampling.LANCZOS)
    clear, ground = Image.new("RGBA", (width, height)), Image.new("RGBA", (width, height), _EDGE)
    clear.paste(small, ((width - side) // 2, (height - side) // 2))
    whole: Any = Image.alpha_composite(ground, clear).convert("RGB")
    whole.tostring = whole.tobytes  # python-xlib's name for it
    rows = (clear.getchannel("A").point([0] * 128 + [255] * 128).crop((0, y, width, y + 1)) for y in range(height))
    boxes = [(y, row.getbbox()) for y, row in enumerate(rows)]
    return whole, [(box[0], y, box[2] - box[0], 1) for y, box in boxes if box is not None]


# ---- where it works ----


def _library() -> tuple[Any, str]:
    """pystray, and which of its backends shows the icon; TrayError in words where none can."""
    if _on_x() and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise TrayError("no display here; start it within the desktop's session, where it starts by itself at login")
    _find_gi()
    if _on_x() and "PYSTRAY_BACKEND" not in os.environ and not _session_bus():
        os.environ["PYSTRAY_BACKEND"] = "xorg"  # the others cannot begin without one
    logger = logging.getLogger("pystray")  # it logs tracebacks where a tray is not there yet
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    try:
        pystray = importlib.import_module("pystray")
    except Exception as e:  # of several libraries, each with its own
        why = " ".join(str(e).split())[:200] or type(e).__name__
        raise TrayError(f"no tray can be reached from here ({why}); on Wayland it takes {MENU_NEEDS}") from None
    return pystray, pystray.Icon.__module__.rpartition("._")[2]


def _find_gi() -> None:
    """The system's PyGObject, alone of its packages, for a virtual environment: pip would have to compile it."""
    if importlib.util.find_spec("gi") is not None or not _SYSTEMS_GI.is_file():
        return
    spec = importlib.util.spec_from_file_location("gi", _SYSTEMS_GI)
    assert spec is not None
    assert spec.loader is not None
    sys.modules["gi"] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(sys.modules["gi"])
    except Exception:  # compiled for another Python than this
        for name in [name for name in sys.modules if name.partition(".")[0] == "gi"]:
            del sys.modules[name]


def _on_x() -> bool:
    return sys.platform not in ("win32", "darwin")


def _session_bus() -> bool:
    try:
        gio = importlib.import_module("gi.repository.Gio")
        gio.bus_get_sync(gio.BusType.SESSION, None)
    except Exception:  # no PyGObject, or no bus
        return False
    return True


def _what_it_can(pystray: Any) -> str:
    if pystray.Icon.HAS_MENU:
        if pystray.Icon.HAS_DEFAULT_ACTION:
            return "a right click opens the menu, a click re-initialises the camera pose"
        return "a click opens the menu"
    return f"no menu and no notices here, a click re-initialises the camera pose; for a menu: {MENU_NEEDS}"


def host_there(backend: str) -> bool:
    """Whether there is a tray that takes the icon of this backend."""
    if backend == "appindicator" and _status_notifier():
        return True
    return backend not in ("appindicator", "gtk", "xorg") or _xembed()


def _xembed() -> bool:
    """A tray of X11: somebody owns its selection."""
    from Xlib import X
    from Xlib.display import Display
    from Xlib.error import ConnectionClosedError, DisplayError

    try:
        display = Display()
        atom = display.intern_atom(f"_NET_SYSTEM_TRAY_S{display.get_default_screen()}")
        owner = display.get_selection_owner(atom)
        display.close()
    except (DisplayError, ConnectionClosedError, OSError):  # no X, or it is going down
        return False
    return owner != X.NONE


def _status_notifier() -> bool:
    """A tray of newer desktops: somebody watches for status notifiers on the session's bus."""
    try:
        gio, glib = (importlib.import_module(f"gi.repository.{name}") for name in ("Gio", "GLib"))
        bus = gio.bus_get_sync(gio.BusType.SESSION, None)
        name = glib.Variant("(s)", ("org.kde.StatusNotifierWatcher",))
        dbus = "org.freedesktop.DBus"
        reply = bus.call_sync(dbus, "/org/freedesktop/DBus", dbus, "NameHasOwner", name, None, 0, 1000, None)
        return bool(reply.unpack()[0])
    except Exception:  # no bus
        return False


def _wait_for_host(backend: str, over: threading.Event, seconds: float = _FOR_A_HOST) -> None:
    end = time.monotonic() + seconds
    while not host_there(backend):
        if time.monotonic() > end:
            wayland = bool(os.environ.get("WAYLAND_DISPLAY"))
            raise TrayError(advice(backend, os.environ.get("XDG_CURRENT_DESKTOP", ""), wayland=wayland))
        if over.wait(1.0):
            return


def advice(backend: str, desktop: str, *, wayland: bool) -> str:
    """Advice where no tray takes the icon."""
    first = "this desktop has no tray for the icon: "
    gnome = "gnome" in desktop.lower()
    if gnome:
        first += "GNOME has one with apt-get install gnome-shell-extension-appindicator, then log in anew"
        return first if backend == "appindicator" else f"{first}; the icon also needs {MENU_NEEDS}"
    if wayland and backend != "appindicator":
        return f"{first}on Wayland it needs {MENU_NEEDS}"
    return f"{first}start a panel that has one (of Xfce, LXQt, MATE, KDE), or trayer"
