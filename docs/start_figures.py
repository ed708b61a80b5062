"""The table of docs/performance.md on how soon a command answers: python docs/start_figures.py [--write].

Each command in turn, round after round, in a process of its own; of each the least time, as others on the machine only
add to it. Modules are compiled, as an installation does it. Takes some minutes, and wants a machine that does nothing
else. Without --write the table is printed.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

PAGE = Path(__file__).with_name("performance.md")
MARKS = "<!-- table: docs/start_figures.py -->", "<!-- end of table -->"
ROUNDS = 5
PASS = "python -c pass"
NEXT, STATUS = "spheremouse calibrate next FOLDER", "spheremouse ctl status"
CLIP = PAGE.parents[1] / "tests" / "data" / "far26_clip"
MOTION = "spheremouse run --source CLIP --output text:-"
ASKED = {"help": "0.5 s, 80 MB", "next": "1 s", "status": "0.3 s", "motion": "0.8 s"}

# in a process of its own: the peak memory of a child includes that of its parent when it began
_WALK = """
import json, typer.main
from spheremouse.commands import app

def walk(command, words):
    yield words
    for name, inner in getattr(command, "commands", {}).items():
        yield from walk(inner, [*words, name])

print(json.dumps(list(walk(typer.main.get_command(app), []))))
"""

Figures = tuple[float, float, float]  # s by the clock, s of the processor, MB


def commands() -> list[list[str]]:
    """Words of every command and of every group of them."""
    return json.loads(subprocess.run([sys.executable, "-c", _WALK], check=True, stdout=subprocess.PIPE).stdout)


def measured(words: list[str], env: dict[str, str], to_a_line: bool) -> Figures:
    """Return time and memory of a command, from its start to its end or to its first line."""
    begun = time.perf_counter()
    child = subprocess.Popen(
        words, stdout=subprocess.PIPE if to_a_line else subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=env
    )
    if child.stdout is not None and child.stdout.readline():
        child.kill()
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode not in (0, -signal.SIGKILL):
        raise RuntimeError(f"{' '.join(words)}: exit code {child.returncode}")
    return time.perf_counter() - begun, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3


@contextmanager
def daemon(folder: Path, env: dict[str, str]) -> Iterator[Path]:
    """The socket of a daemon that tracks a simulated ball at a few frames a second."""
    socket = folder / "control.sock"
    words = ["run", "--source", "synthetic:fps=2,seconds=3600", "--realtime", "--output", "null"]
    told = [sys.executable, "-m", "spheremouse", *words, "--set", f"control.socket={socket}"]
    with subprocess.Popen(told, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=env) as process:
        try:
            while not socket.exists():
                time.sleep(0.1)
            yield socket
        finally:
            process.terminate()


def main() -> str:
    """The table."""
    before = os.getloadavg()[0]
    ours = [sys.executable, "-m", "spheremouse"]
    helps = {" ".join(["spheremouse", *w, "--help"]): [*ours, *w, "--help"] for w in commands()}
    env = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    with ExitStack() as stack:
        name = stack.enter_context(tempfile.TemporaryDirectory())
        env["PYTHONPYCACHEPREFIX"] = f"{name}/compiled"
        socket = stack.enter_context(daemon(Path(name), env))
        folder = str(Path(name) / "cabinet")
        subprocess.run(
            [*ours, "calibrate", "practice", folder, "--photos", "6", "--boards", "15", "--no-film"],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        asked = {PASS: [sys.executable, "-c", "pass"], **helps}
        asked[NEXT] = [*ours, "calibrate", "next", folder]
        asked[STATUS] = [*ours, "ctl", "status", "--socket", str(socket)]
        asked[MOTION] = [*ours, "run", "--source", f"dataset:{CLIP}", "--output", "text:-"]
        least: dict[str, Figures] = {}
        for _ in range(ROUNDS):
            for what, words in asked.items():
                now = measured(words, env, to_a_line=what == MOTION)
                least[what] = tuple(map(min, now, least.get(what, now)))  # pyright: ignore[reportArgumentType]
    slowest = max(helps, key=lambda what: least[what][0])
    largest = max(helps, key=lambda what: least[what][2])
    rows = [
        (PASS, f"`{PASS}`", None),
        ("spheremouse --help", "`spheremouse --help`", "help"),
        (slowest, f"the slowest of all {len(helps)} helps: `{slowest}`", "help"),
        (largest, f"the largest: `{largest}`", "help"),
        (NEXT, f"`{NEXT}`", "next"),
        (STATUS, f"`{STATUS}`, of a daemon that runs", "status"),
        (MOTION, f"`{MOTION}`, to the first motion", "motion"),
    ]
    lines = [
        "| | s | of the processor, s | times `python -c pass` | MB | limit |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for what, words, wish in rows:
        clock, processor, memory = least[what]
        ratio = clock / least[PASS][0]
        lines.append(
            f"| {words} | {clock:.2f} | {processor:.2f} | {ratio:.0f} | {memory:.0f} | {ASKED.get(wish, '')} |"
        )
    load = max(before, os.getloadavg()[0])
    lines += ["", f"{os.cpu_count()} cores, at a load of {load:.1f} (our own is 1 to 2)."]
    return "\n".join(lines)


if __name__ == "__main__":
    table = main()
    if sys.argv[1:] == ["--write"]:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(MARKS[0])
        PAGE.write_text(f"{before}{MARKS[0]}\n\n{table}\n\n{MARKS[1]}{rest.partition(MARKS[1])[2]}", encoding="utf-8")
    else:
        print(table)
