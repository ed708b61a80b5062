"""The daemon of docs/control.md and a raw connection, for the tests of socket, commands and metrics."""

import contextlib
import json
import os
import socket
from copy import deepcopy
from functools import cache
from pathlib import Path

import pytest

from spheremouse.errors import ControlError
from spheremouse.session.control import protocol

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


def reply_to(asked):
    """The page's reply to a request, as JSON or as the daemon gets it, without `ok` and `id`."""
    request = protocol.parse(json.dumps(asked).encode()) if isinstance(asked, dict) else asked
    return deepcopy(_replies()[request.model_copy(update={"id": None})])


@cache
def _replies():
    found = {}
    for line, replies in (exchange for conversation in conversations() for exchange in conversation):
        with contextlib.suppress(protocol.BadRequestError):
            request = protocol.parse(line.encode()).model_copy(update={"id": None})
            found[request] = {key: value for key, value in replies[0].items() if key not in ("ok", "id")}
    return found


def a_status(**change):
    """The page's status with some values changed."""
    return reply_to({"command": "status"}) | change


class Daemon:
    """Gives the page's replies, and those to any `set` and `save`."""

    def __init__(self):
        self.paused = False
        self.status = a_status()

    def __call__(self, pending):
        request = pending.request
        if request.command in ("pause", "resume"):
            self.paused = request.command == "pause"
        if isinstance(request, protocol.Set):
            values = {k: [1.0, float(v)] for k, _, v in (a.partition("=") for a in request.assignments)}
            told = ", ".join(f"{k} {old} → {new}" for k, (old, new) in values.items())
            names = sorted({key.partition(".")[0] for key in values})
            reply = {"changed": names, "values": values, "message": f"configuration applied: {told}"}
        elif isinstance(request, protocol.Save):
            reply = reply_to({"command": "save"})
        elif request.command == "status":
            reason = "by `spheremouse ctl pause`; `resume` ends it"
            reply = {"state": "paused", "reason": reason} if self.paused else self.status
        else:
            reply = reply_to(request)
        if "error" in reply:
            raise ControlError(reply["error"])
        pending.answer(reply | ({"pixels": bytes(reply["bytes"])} if "bytes" in reply else {}))
