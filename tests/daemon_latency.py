"""What the daemon takes: `python -m tests.daemon_latency [FOLDER ...] [--seconds S] [--realtime auto|off]`.

For each recording, by default a simulated one of 60 frames a second that is made first, the daemon runs on it at its
own pace (`spheremouse run --source dataset:FOLDER --realtime --output null`) and is asked by its control socket. Prints
a Markdown table: latency from a frame's arrival to the end of the write to the output, and the stages in it, as the
median and what 99 % stay below; the same latency as a share of the interval between frames; processor time as a share
of a core after the start, of the thread that works on frames and of the whole process, which reads the film as well;
resident memory at the end, what the process has written and with the pages of files that it only reads.

A recording is decoded before it arrives, so that the latency is that beyond decoding. Others on the machine count.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from spheremouse.capture import open_source
from spheremouse.errors import ControlError
from spheremouse.session.control.client import Client

HEAD = (
    "recording", "frames/s", "latency", "detect", "filter", "of the interval", "of a core", "with the film", "MB",
    "with files",
)  # fmt: skip
_TICKS = os.sysconf("SC_CLK_TCK")


def processor(pid: int) -> tuple[float, float]:
    """s of processor time so far: of the thread that works on frames, which is the main one, and of all."""
    return tuple(
        sum(int(w) for w in path.read_text().rpartition(")")[2].split()[11:13]) / _TICKS
        for path in (Path(f"/proc/{pid}/task/{pid}/stat"), Path(f"/proc/{pid}/stat"))
    )


def megabytes(pid: int, file: str = "status") -> dict[str, float]:
    """Return the amounts of memory that a file of /proc has of a process."""
    lines = Path(f"/proc/{pid}/{file}").read_text().splitlines()
    return {line.split(":")[0]: 1.024e-3 * float(line.split()[1]) for line in lines if line.endswith("kB")}


def measure(folder: Path, seconds: float, realtime: str) -> list[str]:
    with tempfile.TemporaryDirectory() as name:
        config = Path(name) / "config.yaml"
        config.write_text(f'schema: 2\nrealtime: "{realtime}"\ncontrol: {{socket: {name}/s}}\n')
        command = [sys.executable, "-m", "spheremouse", "run", "--config", str(config), "--no-map", "--no-status"]
        command += ["--source", f"dataset:{folder}", "--realtime", "--output", "null"]
        client = Client(Path(name) / "s")
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            status, first, mb = {}, None, {}
            while process.poll() is None and (first is None or time.monotonic() < first[0] + seconds):
                time.sleep(0.2)
                try:
                    status = client.ask("status")
                    if first is None and status["state"] == "tracking" and status["frames"] > 30:
                        first = (time.monotonic(), processor(process.pid))
                    spent, last = processor(process.pid), time.monotonic()
                    mb = megabytes(process.pid, "smaps_rollup")
                except (ControlError, OSError):
                    continue
            process.terminate()
            _, text = process.communicate()
        if first is None:
            raise SystemExit(f"{folder}: was never tracked: {text}")
    with open_source(f"dataset:{folder}") as source:
        fps = source.fps or 30.0
    latency, stages = status["latency_ms"], status["stages_ms"]
    return [
        folder.name, f"{fps:g}", pair(latency), pair(stages["detect"]), pair(stages["filter"]),
        f"{0.1 * latency['p50'] * fps:.1f} / {0.1 * latency['p99'] * fps:.1f} %",
        *(f"{100.0 * (b - a) / (last - first[0]):.1f} %" for a, b in zip(first[1], spent, strict=True)),
        f"{mb['Private_Dirty']:.0f}", f"{mb['Rss']:.0f}"
    ]  # fmt: skip


def pair(ms: dict[str, float]) -> str:
    return f"{ms['p50']:.2f} / {ms['p99']:.2f} ms"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="*")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each recording, or to its end")
    parser.add_argument("--realtime", choices=("auto", "off"), default="auto")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folders = given.folder
        if not folders:
            folders = [Path(name) / "simulated-60"]
            words = f"simulate {folders[0]} --fps 60 --motion play --seconds 20 --noise 3"
            command = [sys.executable, "-m", "spheremouse", *words.split()]
            subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
        print(f"| {' | '.join(HEAD)} |\n|{' --- |' * len(HEAD)}")
        for folder in folders:
            print("| " + " | ".join(measure(folder, given.seconds, given.realtime)) + " |", flush=True)


if __name__ == "__main__":
    main()
