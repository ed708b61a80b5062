"""The tables of docs/performance.md from runs of `spheremouse bench`: python docs/performance.py [FAR26_DIR].

Takes some minutes, and wants a machine that does nothing else.
"""

import os
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).with_suffix(".md")
MARKS = "<!-- tables: docs/performance.py -->", "<!-- end of tables -->"


def run(text: str, *arguments: str) -> str:
    """What `spheremouse bench` prints, under the command as a person types it."""
    command = [sys.executable, "-m", "spheremouse", "bench", *arguments]
    shown = " ".join(["spheremouse", "bench", *(Path(a).name if os.sep in a else a for a in arguments)])
    print(f"{shown} ...", file=sys.stderr)
    printed = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, env={**os.environ, "LC_ALL": "C.UTF-8"}
    )
    lines = "\n".join(line.rstrip() for line in printed.stdout.splitlines())
    return f"{text}\n\n```text\n$ {shown}\n{lines}\n```\n"


def main(far26: Path | None) -> None:
    """Replace the tables of the page."""
    parts = [run("The simulated far scene, which every checkout can film:", "--repeat", "2", "--steps", "100000")]
    if far26 is not None:
        text = "The reference recording `far26`, rendered by other code, with a room full of false candidates:"
        parts.append(run(text, str(far26.resolve()), "--repeat", "2", "--no-sizes"))
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(MARKS[0])
    after = rest.partition(MARKS[1])[2]
    tables = "\n".join(parts)
    PAGE.write_text(f"{before}{MARKS[0]}\n\n{tables}\n{MARKS[1]}{after}", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
