"""Measure the cost of hostile clients: `python -m tests.control_flood [--seconds S]`.

A server runs in this process, a client that floods it in another. The output is the server's share of a core, and the
delay of a thread of this process that wakes 250 times a second, as the reporter does.
"""

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from spheremouse.session.control.server import ControlServer
from spheremouse.session.settings import ControlSettings

PERIOD = 1 / 250  # s
WAYS = {
    "nothing": "time.sleep(left())",
    "requests": 'c = connected()\nwhile left(): c.sendall(b\'{"command": "status"}\\n\' * 100); c.recv(4096)',
    "long requests": "c = connected()\nwhile left(): c.sendall(b'[' + b'1,' * 3900 + b'1]' + b' ' * 50000 + b'\\n')",
    "letters": "c = connected()\nwhile left(): c.send(b' ')",
    "connections": "while left(): connected().close()",
}
CLIENT = """
import socket, time
end = time.time() + {seconds}
def left(): return max(0.0, end - time.time())
def connected():
    c = socket.socket(socket.AF_UNIX)
    c.connect({path!r})
    c.settimeout(1.0)
    return c
while left():
    try:
        {body}
    except OSError:
        pass
"""


def lateness(stop: threading.Event, late: list[float]) -> None:
    """Append the delays of this thread's wake-ups, in s, until `stop`."""
    due = time.monotonic()
    while not stop.is_set():
        due += PERIOD
        time.sleep(max(0.0, due - time.monotonic()))
        late.append(time.monotonic() - due)
        due = max(due, time.monotonic() - PERIOD)


def main() -> int:
    """Try each kind of flood and print a line."""
    parser = argparse.ArgumentParser(prog="python -m tests.control_flood", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seconds", type=float, default=5.0, metavar="S", help="for each way")
    seconds = parser.parse_args().seconds
    for name, body in WAYS.items():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "c"
            stop, late = threading.Event(), list[float]()
            with ControlServer(path, ControlSettings(), lambda pending: pending.answer({"state": "tracking"})):
                code = CLIENT.format(seconds=seconds, path=str(path), body=body.replace("\n", "\n        "))
                thread = threading.Thread(target=lateness, args=(stop, late))
                thread.start()
                before = time.process_time()
                subprocess.run([sys.executable, "-c", code], check=True)
                share = (time.process_time() - before) / seconds
                stop.set()
                thread.join()
        median, most = 1e3 * np.quantile(late, [0.5, 0.99])
        print(f"{name}: {100 * share:.1f} % of a core; woken late by {median:.2f} ms (median), {most:.2f} ms (99 %)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
