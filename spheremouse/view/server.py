"""The page's web server: static files, and one WebSocket for each browser.

A browser asks for each picture, so a slow one gets fewer. What the page sends unasked waits in a bounded queue.
"""

import asyncio
import contextlib
import json
import signal
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any, Literal

import orjson
import uvicorn
from pydantic import Field
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from spheremouse import __version__
from spheremouse.errors import ConfigurationError, SpheremouseError, internal_error_text, printable
from spheremouse.files.plain_json import loads, tuples
from spheremouse.files.validate import Part, validate
from spheremouse.files.yaml import Document
from spheremouse.session.control.jpeg_picture import JpegPicture
from spheremouse.session.control.protocol import internal_error
from spheremouse.view.access import HEADERS, PROOF, Access, Visitor
from spheremouse.view.actions import Actions
from spheremouse.view.daemon import DaemonLink
from spheremouse.view.guide import LOOK, Guide, GuideOptions
from spheremouse.view.pictures import Pictures

STATIC = Path(__file__).with_name("static")
TO_OWN = "to be the owner, open once the address that `spheremouse view --url` prints"
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}

_MAX_BROWSERS = 24
_MAX_MESSAGE_BYTES = 100_000
_MAX_WAITING = 300  # messages for one browser
_PICTURE_TIMEOUT = 0.5  # s; then `next` is answered without a picture
_REQUEST_TIMEOUT = 5.0  # s in which a connection must request something
_SEND_TIMEOUT = 30.0  # s in which a browser must read a message
_PROGRESS_INTERVAL_S = 2.0  # s
_LINK_KEPT_S = 3.0  # s after the last browser, in which the link to the daemon stays
_SHOWN = ("stamp", "width", "height", "annotations")  # of a picture
_COOKIE_AGE = 365 * 86400  # s


class _Pace(Part):
    type: Literal["next", "rest"]


class _Set(Part):
    type: Literal["set"]
    id: int = Field(ge=0, lt=2**53)
    values: dict[str, Any] = Field(min_length=1, max_length=50)
    gesture: str = Field(max_length=200)


class _Do(Part):
    type: Literal["do"]
    id: int = Field(ge=0, lt=2**53)
    action: str = Field(max_length=50)
    arguments: dict[str, Any] = Field(default_factory=dict)


_MESSAGES: dict[Any, type[_Pace | _Set | _Do]] = {"next": _Pace, "rest": _Pace, "set": _Set, "do": _Do}


class LivePage:
    """All browsers of one daemon."""

    def __init__(self, socket: Path | None, access: Access, guide_options: GuideOptions) -> None:
        """Make the page in the event loop, which its tasks need. Without `socket`, `find_socket` finds the daemon's."""
        self.access = access
        self.daemon = DaemonLink(socket, self._publish)
        self.pictures = Pictures(lambda: self.daemon.socket)
        self.guide = Guide(guide_options, socket, self._publish)
        self.actions = Actions(self.daemon, self.guide)
        self.browsers: set[_Browser] = set()
        self._closing_link: asyncio.Task[None] | None = None  # closes the link when no browser comes back

    async def serve(self, socket: WebSocket, visitor: Visitor) -> None:
        """Serve a browser until it leaves."""
        if len(self.browsers) >= _MAX_BROWSERS:
            await socket.close(1013, "too many browsers")
            return
        await socket.accept()
        browser = _Browser(self, socket, visitor == "owner")
        self.browsers.add(browser)
        if self._closing_link is not None:
            self._closing_link.cancel()
        self.daemon.set_watched(True)
        try:
            await browser.converse()
        finally:
            self.browsers.discard(browser)
            if not self.browsers:
                self._closing_link = asyncio.create_task(self._close_link())

    async def _close_link(self) -> None:
        """Close the connection to the daemon if no browser comes back for a while."""
        await asyncio.sleep(_LINK_KEPT_S)
        if not self.browsers:
            self.actions.recordings.end()
            self.daemon.set_watched(False)
            await self.guide.stop(LOOK)

    def _publish(self, message: dict[str, Any]) -> None:
        """Send a message to all browsers; that of the guide to owners only."""
        kind = message["type"]
        text = None if kind == "hello" else json.dumps(message)
        for browser in self.browsers:
            if browser.owner or kind != "guide":
                browser.push(kind, text if text is not None else browser.hello())


class _Browser:
    """One WebSocket."""

    def __init__(self, page: LivePage, socket: WebSocket, owner: bool) -> None:
        self._page, self._socket, self.owner = page, socket, owner
        self._waiting: deque[tuple[str, str | bytes]] = deque(maxlen=_MAX_WAITING)
        self._has_waiting = asyncio.Event()
        self._frame: asyncio.Task[None] | None = None
        self._shown: JpegPicture | None = None
        self._rows = page.daemon.count  # samples sent
        self._tasks: set[asyncio.Task[None]] = set()

    def hello(self) -> str:
        """Return the first message."""
        return json.dumps({**self._page.daemon.hello(), "version": __version__, "owner": self.owner})

    def push(self, kind: str, message: str | bytes) -> None:
        """Add a message. One with a whole state, or a frame, replaces the one of its kind that waits.

        If too many wait, the oldest is dropped.
        """
        if kind in ("status", "values", "scene", "hello", "guide", "frame"):
            self._waiting = deque((w for w in self._waiting if w[0] != kind), _MAX_WAITING)
        self._waiting.append((kind, message))
        self._has_waiting.set()

    async def converse(self) -> None:
        """Take requests until the browser leaves."""
        daemon = self._page.daemon
        self.push("hello", self.hello())
        for message in (daemon.state(), daemon.values(), *([self._page.guide.state()] if self.owner else [])):
            self.push(message["type"], json.dumps(message))
        sending = asyncio.create_task(self._send())
        try:
            while True:
                await self._take(await self._socket.receive_text())
        except (WebSocketDisconnect, RuntimeError, KeyError):  # it left, was dropped, or sent bytes
            pass
        finally:
            for task in (sending, *self._tasks):
                task.cancel()

    async def _send(self) -> None:
        """Send the waiting messages one by one. A browser that does not read is disconnected."""
        with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):
            while await self._has_waiting.wait():
                _, message = self._waiting.popleft()
                if not self._waiting:
                    self._has_waiting.clear()
                send: Any = self._socket.send_text if isinstance(message, str) else self._socket.send_bytes
                try:
                    async with asyncio.timeout(_SEND_TIMEOUT):
                        await send(message)
                except TimeoutError:
                    await self._socket.close(1008, "does not read")
                    return

    async def _take(self, text: str) -> None:
        """Obey a message of the browser, or answer why it is invalid."""
        data = None
        try:
            data = tuples(loads(text))
            if not isinstance(data, dict) or not isinstance(data.get("type"), str) or data["type"] not in _MESSAGES:
                raise ValueError(f"type: must be one of {', '.join(_MESSAGES)}")
            message = validate(Document("", data), _MESSAGES[data["type"]])
        except (ValueError, ConfigurationError) as e:
            id_ = data.get("id") if isinstance(data, dict) else None
            self._refuse(id_ if isinstance(id_, int) else None, e)
            return
        if isinstance(message, _Pace):
            if message.type == "rest" and self._frame is not None:
                self._frame.cancel()
            elif message.type == "next" and (self._frame is None or self._frame.done()):
                self._frame = self._begin(self._send_frame())
        elif not self.owner:
            self._answer("trouble", message.id, text=f"only the owner may do this; {TO_OWN}")
        elif len(self._tasks) > 8:  # a browser that asks for more does not wait for answers
            self._answer("trouble", message.id, text="busy: too many requests are under way")
        else:
            self._begin(self._carry_out(message))

    def _begin(self, work: Any) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _carry_out(self, message: _Set | _Do) -> None:
        """Carry out a request, and answer it, at first with `progress` while it takes long."""
        actions, begun = self._page.actions, time.monotonic()
        is_set = isinstance(message, _Set)
        work = asyncio.create_task(
            actions.set(message.values, message.gesture) if is_set else actions.do(message.action, message.arguments)
        )
        try:
            while not (await asyncio.wait([work], timeout=_PROGRESS_INTERVAL_S))[0]:
                self._answer("progress", message.id, seconds=round(time.monotonic() - begun))
            done = work.result()
            self._answer("done", message.id, **({"message": done} if isinstance(done, str) else {"data": done}))
        except SpheremouseError as e:
            self._refuse(message.id, e)
        except Exception as e:  # else the browser would wait for an answer
            self._answer("trouble", message.id, text=internal_error(e))
            print(internal_error_text(), file=sys.stderr)
        finally:
            work.cancel()

    def _answer(self, type_: str, id_: int | None, **words: Any) -> None:
        self.push(type_, json.dumps({"type": type_, "id": id_, **words}))

    def _refuse(self, id_: int | None, error: Exception) -> None:
        self._answer("trouble", id_, text=printable("; ".join(str(error).splitlines())))

    async def _send_frame(self) -> None:
        """Answer `next` with the next picture, or without one if none comes."""
        shown = await self._page.pictures.after(self._shown, _PICTURE_TIMEOUT)
        rows, self._rows = self._page.daemon.rows(self._rows)
        head, jpeg = {"type": "frame", "samples": rows}, b""
        if shown is not None:
            self._shown, jpeg = shown, shown.whole if self.owner else shown.masked
            head |= {name: getattr(shown.picture, name) for name in _SHOWN}
        text = orjson.dumps(head)
        self.push("frame", struct.pack(">I", len(text)) + text + jpeg)


def application(socket: Path | None, access: Access, guide_options: GuideOptions) -> Starlette:
    """Return the web application."""
    pages: list[LivePage] = []

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        pages.append(LivePage(socket, access, guide_options))
        yield
        await pages[0].actions.recordings.close()
        pages[0].daemon.close()
        await pages[0].guide.stop()

    async def file(request: Request) -> Response:
        visitor, given = _visitor(access, request), request.query_params.get("token")
        if visitor is None:
            return PlainTextResponse(f"403: only the owner may see this page; {TO_OWN}\n", 403, HEADERS)
        if given is not None:
            answer: Response = RedirectResponse(request.url.path, 303, HEADERS)
            if access.is_token(given):
                answer.set_cookie(access.cookie, given, _COOKIE_AGE, path="/", httponly=True, samesite="strict")
            return answer
        if request.url.path == PROOF:
            return PlainTextResponse(access.proof(request.query_params.get("nonce", "")), headers=HEADERS)
        path = FILES.get(request.url.path)
        if path is None:
            return PlainTextResponse("404: there is no such file\n", 404, HEADERS)
        return FileResponse(path, media_type=TYPES[path.suffix], headers=HEADERS)

    async def live(browser: WebSocket) -> None:
        visitor = _visitor(access, browser)
        if visitor is None or browser.headers.get("origin") is None:  # a browser always sends it
            await browser.close()  # before acceptance: answers 403
        else:
            await pages[0].serve(browser, visitor)

    routes = [WebSocketRoute("/live", live), Route("/{path:path}", file)]
    return Starlette(routes=routes, lifespan=lifespan)


# The files by their addresses. No other path is ever opened.
FILES = {
    **{f"/static/{path.name}": path for path in STATIC.iterdir() if path.suffix in TYPES},
    "/": STATIC / "index.html",
}


def _visitor(access: Access, request: HTTPConnection) -> Visitor | None:
    """Return who sent a request, or None if access is refused. A client at the page's address is on this computer."""
    headers, client, (address, _) = request.headers, request.client, request.scope["server"]
    return access.visitor(
        "" if client is None else "127.0.0.1" if client.host == address else client.host,
        headers.get("host", ""),
        headers.get("origin"),
        request.cookies.get(access.cookie),
        request.query_params.get("token"),
    )


class _Protocol(H11Protocol):
    """HTTP with a deadline for the request, so that silent connections do not take all places for ever."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.loop.call_later(_REQUEST_TIMEOUT, self._check)

    def _check(self) -> None:
        if self.cycle is None and self in self.connections:  # neither answered, nor a WebSocket
            self.transport.close()


def server(app: Starlette, address: str, port: int) -> uvicorn.Server:
    """Return the server of an application at an address."""
    config = uvicorn.Config(
        app, host=address, port=port, ws="websockets-sansio", ws_max_size=_MAX_MESSAGE_BYTES, ws_max_queue=16,
        ws_per_message_deflate=False, http=_Protocol, loop="asyncio", limit_concurrency=100, timeout_keep_alive=5,
        timeout_graceful_shutdown=1, access_log=False, log_config=None, server_header=False, proxy_headers=False,
    )  # fmt: skip
    return _Server(config)


class _Server(uvicorn.Server):
    """A server that ends at SIGINT and SIGTERM as at any other end, without raising the signal again."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                asyncio.get_running_loop().add_signal_handler(number, self.handle_exit, number, None)
        yield
