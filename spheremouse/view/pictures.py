"""Live pictures for all browsers: the lease of the daemon's memory."""

import asyncio
import contextlib
import time
from collections.abc import Callable
from pathlib import Path

from spheremouse.errors import ControlError
from spheremouse.session.control.client import Client
from spheremouse.session.control.jpeg_picture import JpegPicture
from spheremouse.session.control.pictures import PictureReader

INTERVAL = 1 / 15  # s between two pictures
_LEASE_RENEWAL_S = 1.0  # s between two renewals of the lease
_PAUSE_AFTER_PICTURE_S = 0.97 * INTERVAL  # s after a picture, in which no other is looked for
_MEMORY_POLL_S = 0.01  # s between two looks into the memory
_LEASE_KEPT_S = 1.0  # s after the last request, in which the lease is kept
_LEASE_RETRY_S = 0.5  # s after a failed lease


class Pictures:
    """The daemon's pictures, at most one each INTERVAL, read while browsers ask for them.

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
        self._wanted_until = time.monotonic() + _LEASE_KEPT_S
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._read())
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout):
                while self._latest is None or self._latest is shown:
                    await self._arrived.wait()
                return self._latest
        return None

    async def _read(self) -> None:
        """Hold the lease and read the memory while browsers ask."""
        while time.monotonic() < self._wanted_until:
            try:
                await self._read_under_lease()
            except ControlError:  # the link to the daemon reports it
                await asyncio.sleep(_LEASE_RETRY_S)
        self._latest = None

    async def _read_under_lease(self) -> None:
        reader: PictureReader | None = None
        number, renew_at, socket, self._latest = 0, 0.0, self._socket(), None
        with Client(socket) as client:
            while (now := time.monotonic()) < self._wanted_until and socket is self._socket():
                if reader is None or now >= renew_at:
                    renewed = await asyncio.to_thread(client.pictures, INTERVAL)
                    number = number if renewed is reader else 0
                    reader, renew_at = renewed, now + _LEASE_RENEWAL_S
                picture = reader.latest(number)
                if picture is not None:
                    number, self._latest = picture.number, JpegPicture(picture)
                    self._arrived.set()
                    self._arrived = asyncio.Event()
                await asyncio.sleep(_MEMORY_POLL_S if picture is None else _PAUSE_AFTER_PICTURE_S)
