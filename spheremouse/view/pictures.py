"""Live pictures for all browsers, requested from the daemon while browsers ask for them."""

import asyncio
import contextlib
import time
from collections.abc import Callable
from pathlib import Path

from spheremouse.errors import ControlError
from spheremouse.session.control.client import Client
from spheremouse.session.control.jpeg_picture import JpegPicture

INTERVAL = 1 / 15  # s between two pictures
_WANTED_S = 1.0  # s after the last request of a browser, in which pictures are requested
_RETRY_S = 0.5  # s after a failed request


class Pictures:
    """The daemon's pictures, at most one each INTERVAL, requested while browsers ask for them.

    All methods are called in the event loop.
    """

    def __init__(self, socket: Callable[[], Path | None]) -> None:
        """`socket` returns the path of the present daemon's."""
        self._socket = socket
        self._latest: JpegPicture | None = None
        self._arrived = asyncio.Event()
        self._wanted_until = 0.0  # s, monotonic
        self._task: asyncio.Task[None] | None = None

    async def after(self, shown: JpegPicture | None, timeout: float) -> JpegPicture | None:
        """Return the first picture after `shown`; None if none comes within `timeout`, s."""
        self._wanted_until = time.monotonic() + _WANTED_S
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._read())
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout):
                while self._latest is None or self._latest is shown:
                    await self._arrived.wait()
                return self._latest
        return None

    async def _read(self) -> None:
        """Request pictures while browsers ask."""
        while time.monotonic() < self._wanted_until:
            try:
                await self._read_from(self._socket())
            except ControlError:  # the link to the daemon reports it
                self._latest = None
                await asyncio.sleep(_RETRY_S)
        self._latest = None

    async def _read_from(self, socket: Path | None) -> None:
        with Client(socket) as client:
            due = time.monotonic()
            while time.monotonic() < self._wanted_until and socket is self._socket():
                self._latest = JpegPicture(await asyncio.to_thread(client.picture))
                self._arrived.set()
                self._arrived = asyncio.Event()
                due = max(due + INTERVAL, time.monotonic())
                await asyncio.sleep(due - time.monotonic())
