"""Write the table of docs/performance.md from a run of `spheremouse bench`: python docs/performance.py.

It takes some minutes on an idle machine.
"""

import os
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).with_suffix(".md")
MARKS = "<!-- tables: docs/performance.py -->", "<!-- end of tables -->"


def run(text: str, *arguments: str) -> str:
    """Return the command and the output of `spheremouse bench`."""
    command = [sys.executable, "-m", "spheremouse", "bench", *arguments]
    shown = " ".join(["spheremouse", "bench", *arguments])
    print(f"{shown} ...", file=sys.stderr)
    printed = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, env={**os.environ, "LC_ALL": "C.UTF-8"}
    )
    lines = "\n".join(line.rstrip() for line in printed.stdout.splitlines())
    return f"{text}\n\n```text\n$ {shown}\n{lines}\n```\n"


def main() -> None:
    """Replace the table of the page."""
    table = run("The simulated far scene, which every checkout can film:", "--steps", "100000")
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(MARKS[0])
    after = rest.partition(MARKS[1])[2]
    PAGE.write_text(f"{before}{MARKS[0]}\n\n{table}\n{MARKS[1]}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
