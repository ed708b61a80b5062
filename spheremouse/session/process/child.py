"""Commands of ours as processes of their own. Their memory is freed at their end."""

import asyncio
import json
import os
import shutil
import sys
from asyncio.subprocess import DEVNULL, PIPE, Process
from pathlib import Path
from typing import Any

from spheremouse.errors import ControlError, printable

_TIMEOUT_S = 120.0  # s
_MAX_LINE_BYTES = 1_000_000


async def start(socket: Path | None, *words: str, stderr: int = PIPE) -> Process:
    """Start a command for the daemon at `socket`. It ends with this process if the system can do that."""
    bound = ("setpriv", "--pdeathsig", "TERM", "--") if shutil.which("setpriv") else ()
    place = {} if socket is None else {"SPHEREMOUSE_SOCKET": str(socket)}
    return await asyncio.create_subprocess_exec(
        *bound, sys.executable, "-m", "spheremouse", *words, env={**os.environ, **place},
        stdin=DEVNULL, stdout=PIPE, stderr=stderr, limit=_MAX_LINE_BYTES,
    )  # fmt: skip


async def answer(
    socket: Path | None, *words: str, codes: tuple[int, ...] = (0,), timeout: float | None = _TIMEOUT_S
) -> dict[str, Any]:
    """Return the JSON that a command prints. If the caller is cancelled, the command is killed.

    Raises ControlError with its last line if its exit code is another, and if it takes longer than `timeout`, s.
    """
    process = await start(socket, *words)
    try:
        async with asyncio.timeout(timeout):
            out, error = await process.communicate()
    except TimeoutError:
        raise ControlError(f"spheremouse {words[0]}: no answer within {timeout:g} s") from None
    finally:
        if process.returncode is None:
            process.kill()
    if process.returncode not in codes:
        raise ControlError(problem_in(error.decode(errors="replace").splitlines()) or f"{words[0]}: failed")
    try:
        return json.loads(out)
    except ValueError:
        raise ControlError(f"spheremouse {words[0]}: prints no JSON; see the log of the page") from None


async def answers(socket: Path | None, *commands: list[str]) -> list[dict[str, Any]]:
    """Return the JSON of commands that run at once, however long they take.

    Raises ControlError as `answer`. If one of them fails, or the caller is cancelled, all are killed.
    """
    runs = [asyncio.create_task(answer(socket, *words, timeout=None)) for words in commands]
    try:
        return await asyncio.gather(*runs)
    finally:
        for run in runs:
            run.cancel()


def problem_in(lines: list[str]) -> str:
    """Return the last line of a command that failed, without its name."""
    return printable(lines[-1].removeprefix("spheremouse: ")) if lines else ""
