"""Measure the live page: `python -m tests.view_cost [--seconds S] [--connections N]`.

A daemon tracks a simulated ball, 640x480 at 60 Hz, from a camera that sends MJPEG. Browsers ask for pictures as fast as
they get them. The table has, for each number of them, the pictures a second that each gets, the processor time of
the page process as a part of a core, and its resident memory, with pages of files. Then N connections are opened and
dropped, every second one without reading. Before, a browser asks for pictures and reads none. Two lines have the time
until the first picture: after opening, while nobody looks, and after another page process begins to start.
"""

import argparse
import asyncio
import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import simplejpeg
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException
from websockets.typing import Origin

from spheremouse.capture import Payload
from spheremouse.files.token import read_token
from spheremouse.session.control.client import Client
from tests.daemon_latency import megabytes, processor
from tests.daemon_process import Camera
from tests.live_cost import serve, wait_for_tracking
from tests.raw_picture import RawPicture
from tests.reporting import free_port

SETTLE = 5.0  # s after a change, in which links and leases begin or end
UNREAD = 60.0  # s in which a browser does not read
QUALITY = 85  # of the camera's MJPEG


class JpegRaw(RawPicture):
    """A frame that comes as JPEG. It is decoded already, so that the daemon leaves more time to the page."""

    def __init__(self, image, stamp, sequence):
        super().__init__(image[0], image[0], stamp, sequence)
        self._jpeg = image[1]

    def payload(self):
        height, width = self.images[0].shape[:2]
        return Payload("jpeg", width, height, memoryview(self._jpeg))


class JpegCamera(Camera):
    """Plays the film as MJPEG."""

    raw = JpegRaw

    def __init__(self, images, fps):
        super().__init__([(i, simplejpeg.encode_jpeg(i, quality=QUALITY, colorspace="BGR")) for i in images], fps)


class Page:
    def __init__(self, folder: Path, daemon: Path) -> None:
        self.port, file = free_port(), folder / "token"
        words = ("--port", str(self.port), "--socket", str(daemon), "--token-file", str(file))
        command = [sys.executable, "-m", "spheremouse", "view", *words]
        self.process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port)):
                break
            time.sleep(0.05)
        self.cookie = f"spheremouse-{self.port}={read_token(file)}"

    def browser(self, *, owner: bool = True) -> connect:
        """Return a connection of a browser."""
        headers, address = {"Cookie": self.cookie} if owner else {}, f"127.0.0.1:{self.port}"
        return connect(
            f"ws://{address}/live", origin=Origin(f"http://{address}"), additional_headers=headers, max_size=None,
            compression=None, ping_interval=None, close_timeout=0.5,
        )  # fmt: skip

    def memory(self) -> tuple[float, float]:
        """MB resident now, and at most so far."""
        mb = megabytes(self.process.pid)
        return mb["VmRSS"], mb["VmHWM"]


async def watch(page: Page, pictures: list[float], *, owner: bool) -> None:
    """Ask for pictures for ever, and record when each came."""
    async with page.browser(owner=owner) as browser:
        await browser.send('{"type":"next"}')
        async for message in browser:
            if isinstance(message, bytes):
                if message.endswith(b"\xff\xd9"):  # the end of a JPEG file
                    pictures.append(time.monotonic())
                await browser.send('{"type":"next"}')


async def measure(page: Page, owners: list[bool], seconds: float) -> list[str]:
    """Return pictures a second of each browser, % of a core, MB, MB at most, with browsers that are owners or not."""
    seen: list[list[float]] = [[] for _ in owners]
    tasks = [asyncio.create_task(watch(page, p, owner=o)) for p, o in zip(seen, owners, strict=True)]
    await asyncio.sleep(SETTLE)
    begun, before = time.monotonic(), processor(page.process.pid)[1]
    await asyncio.sleep(seconds)
    spent, lasted = processor(page.process.pid)[1] - before, time.monotonic() - begun
    memory = page.memory()
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    rates = [sum(begun <= at < begun + lasted for at in p) / lasted for p in seen]
    await asyncio.sleep(SETTLE)
    share = f"{100.0 * spent / lasted:.1f} %"
    return [", ".join(f"{rate:.1f}" for rate in rates) or "-", share, *(f"{mb:.0f} MB" for mb in memory)]


async def first_picture(page: Page) -> float:
    """Return the time from opening the page to the first picture, s."""
    begun, pictures = time.monotonic(), []
    task = asyncio.create_task(watch(page, pictures, owner=True))
    while not pictures:
        await asyncio.sleep(0.005)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return pictures[0] - begun


async def openings(page: Page, repeats: int = 5) -> list[float]:
    """Return the times to the first picture, s, each while nobody looks."""
    times = []
    for _ in range(repeats):
        await asyncio.sleep(SETTLE)
        times.append(await first_picture(page))
    return sorted(times)


async def flood(page: Page, connections: int) -> list[str]:
    """Open connections, ten at a time, and drop them; every second one reads nothing. Return cells as `measure`."""

    async def one(k: int) -> None:
        with contextlib.suppress(OSError, TimeoutError, WebSocketException):
            async with page.browser() as browser:
                await browser.send('{"type":"next"}')
                if k % 2:
                    await browser.recv()
                browser.transport.abort()

    before = page.memory()[0]
    for first in range(0, connections, 10):
        await asyncio.gather(*(one(k) for k in range(first, min(first + 10, connections))))
    await asyncio.sleep(SETTLE)
    after, most = page.memory()
    return ["-", "-", f"{after:.0f} MB ({after - before:+.1f} MB)", f"{most:.0f} MB"]


async def unread(page: Page, seconds: float) -> list[str]:
    """Ask for 15 pictures a second, and read none. Return cells as `measure`."""
    before = during = page.memory()[0]
    with contextlib.suppress(WebSocketException):
        async with page.browser() as browser:
            browser.transport.pause_reading()
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                await browser.send('{"type":"next"}')
                await asyncio.sleep(1 / 15)
                during = page.memory()[0]
            browser.transport.abort()
    await asyncio.sleep(SETTLE)
    return ["-", "-", f"{during:.0f} MB ({during - before:+.1f} MB)", f"{page.memory()[1]:.0f} MB"]


async def table(page: Page, seconds: float, connections: int) -> None:
    print("| browsers | pictures/s | of a core | memory | at most |\n| --- | --- | --- | --- | --- |")
    rows = {"none": [], "one owner": [True], "two owners": [True, True], "one visitor, masked": [False]}
    work = {name: measure(page, owners, seconds) for name, owners in rows.items()}
    work[f"one that never reads, {UNREAD:g} s"] = unread(page, UNREAD)
    work[f"{connections:,} connections"] = flood(page, connections)
    work["as many again"] = flood(page, connections)  # the first ones fill pools of memory
    for name, cells in work.items():
        print(f"| {name} | {' | '.join(await cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each row of the table")
    parser.add_argument("--connections", type=int, default=1000)
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve:
        serve(given.serve, JpegCamera)
        return
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "s"
        daemon = subprocess.Popen([sys.executable, "-m", "tests.view_cost", "--serve", name], stdout=subprocess.DEVNULL)
        wait_for_tracking(path)
        page = Page(Path(name), path)
        asyncio.run(table(page, given.seconds, given.connections))
        times = asyncio.run(openings(page))
        print(f"\nfirst picture {times[len(times) // 2]:.2f} s after opening, at most {times[-1]:.2f} s")
        page.process.terminate()
        page.process.wait(10.0)
        begun = time.monotonic()
        page = Page(Path(name), path)
        started = time.monotonic() - begun
        print(f"{started + asyncio.run(first_picture(page)):.2f} s after the start of a process")
        print(f"load {os.getloadavg()[0]:.1f}; {Client(path).status().scheduling}", file=sys.stderr)
        page.process.terminate()
        Client(path).ask("stop")
        daemon.wait(60.0)


if __name__ == "__main__":
    main()
