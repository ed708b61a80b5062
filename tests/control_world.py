"""The daemon of docs/control.md and a raw connection, for the tests of socket, commands and metrics."""

import json
import os
import socket
from pathlib import Path

import pytest

from spheremouse.errors import ControlError
from spheremouse.session.control import protocol
from spheremouse.session.control.protocol import Request

PAGE = Path(__file__).parents[1] / "docs" / "control.md"
GENEROUS = 20.0  # s, for what takes milliseconds
OTHER = 54321  # a uid that nobody has


def answer(pending):
    pending.answer({"state": "tracking", "command": pending.request.command})


class Wire:
    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(GENEROUS)
        self.socket.connect(str(path))
        self.lines = self.socket.makefile("rb")

    def close(self):
        self.lines.close()
        self.socket.close()

    def send(self, data):
        self.socket.sendall(data if isinstance(data, bytes) else data.encode())

    def read(self):
        return json.loads(self.lines.readline())

    def ask(self, data):
        self.send(data)
        return self.read()

    def ended(self):
        try:
            return self.lines.readline() == b""
        except ConnectionResetError:
            return True


STATUS = b'{"command": "status"}\n'
FINE = {"ok": True, "state": "tracking", "command": "status"}


def a_group():
    """A group of this machine that this process may give files to."""
    import grp

    for entry in grp.getgrall():
        if entry.gr_gid and (os.geteuid() == 0 or entry.gr_gid in os.getgroups()):
            return entry
    pytest.skip("no group to give the socket to")


def conversations():
    """Blocks of the page: each a list of (line sent, replies)."""
    blocks = PAGE.read_text(encoding="utf-8").split("```text\n")[1:]
    found = []
    for block in blocks:
        asked = []
        for line in block.partition("\n```")[0].splitlines():
            if line.startswith("> "):
                asked.append((line[2:], []))
            elif line.startswith("< "):
                asked[-1][1].append(json.loads(line[2:]))
        found.append(asked)
    return found


def page_reply(command):
    """The page's reply to a request without arguments."""
    return next(r[0] for c in conversations() for q, r in c if q == f'{{"command": "{command}"}}')


def a_status(**change):
    """The page's status with some values changed."""
    return {key: value for key, value in page_reply("status").items() if key != "ok"} | change


class Daemon:
    """Answers as a daemon in the situations of the page would."""

    def __init__(self):
        self.paused = False
        self.status = page_reply("status")

    def __call__(self, pending):
        request, reply = pending.request, pending.answer
        folder = "/var/lib/spheremouse/recordings/"
        match request:
            case protocol.Set(assignments=what):
                names = sorted({a.partition(".")[0] for a in what})
                values = {k: [1.0, float(v)] for k, _, v in (a.partition("=") for a in what)}
                told = ", ".join(f"{k} {old} → {new}" for k, (old, new) in values.items())
                words = f"configuration applied: {told}"
                reply({"changed": names, "values": values, "message": words})
            case protocol.Profile(name=None):
                reply({"profiles": {"doom": ["motion.scale_x=2"], "menu": ["motion.scale_x=1"]}})
            case protocol.Profile(name=name):
                words = "configuration applied: motion.scale_x 1.0 → 2.0"
                reply({"changed": ["motion"], "values": {"motion.scale_x": [1.0, 2.0]}, "message": words})
            case protocol.Record(stop=True):
                words = f"{folder}bug-1: 512 frames in 8.5 s, 3.1 MB; ended as asked"
                reply({"folder": folder + "bug-1", "frames": 512, "message": words})
            case protocol.Record(seconds=60.0, folder=name, everything=False):
                words = f"{folder}{name}: recording the ball and the targets, 60 s at most"
                reply({"folder": f"{folder}{name}", "seconds": 60.0, "message": words})
            case protocol.Snapshot(file=None):
                raise ControlError("a snapshot is being written already; ask again when it is done")
            case protocol.Snapshot(file=name):
                reply({"file": f"{folder}{name}"})
            case Request(command="status"):
                reply(
                    {"state": "paused", "reason": "by `spheremouse ctl pause`; `resume` ends it"}
                    if self.paused
                    else self.status
                )
            case Request(command="pause"):
                self.paused = True
                reply({"state": "paused"})
            case Request(command="resume"):
                self.paused = False
                reply({"state": "tracking"})
            case Request(command="settings" | "scene" | "save"):
                reply(page_reply(request.command))
            case protocol.Replay():
                reply({})
            case Request(command="picture"):
                reply(page_reply("picture") | {"pixels": b"12345678"})
            case Request(command="stop"):
                reply({})
            case Request(command="reinit"):
                raise ControlError("no picture from the camera; plug it in")
            case Request(command="reload"):
                where = "/etc/spheremouse/config.yaml:3: motion.scale_x"
                raise ControlError(f"{where}: must be a number, is 'two'; the default is 1.0")
            case _:
                raise AssertionError(request)
