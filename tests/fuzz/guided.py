"""Text made by libFuzzer, which looks where in our code it leads."""

import importlib
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from spheremouse.ball.settings import Settings
from spheremouse.files import config
from spheremouse.files.rig import rig_text
from tests.fuzz.control import MESSAGES
from tests.fuzz.scene import small_rig
from tests.fuzz.targets import TARGETS
from tests.fuzz.texts import whole

ROOT = Path(__file__).parents[2]
SEEDS: dict[str, Callable[[], list[str]]] = {
    "configuration": lambda: [config.dump(Settings(), Settings()), "schema: 2\nso3: {acceleration_sigma: 1}\n"],
    "daemon's configuration": lambda: [config.dump(whole()(), whole()()), "schema: 2\n"],
    "control messages": lambda: list(MESSAGES),
    "rig": lambda: [rig_text(small_rig())],
}
# The modules that are looked into.
GUIDING = ("files.yaml", "files.validate", "files.config", "files.rig", "session.control.protocol")


def guide(name: str, seconds: float, first: int) -> None:
    """Let libFuzzer make input for a target in this process, which it ends: with 0 if nothing was found."""
    import atheris  # pyright: ignore[reportMissingImports]

    with atheris.instrument_imports(include=[f"spheremouse.{m}" for m in GUIDING], enable_loader_override=False):
        loaded = [importlib.reload(importlib.import_module(f"spheremouse.{m}")) for m in GUIDING]
    ours = [vars(m) for n, m in list(sys.modules.items()) if n.startswith("tests.fuzz.")]
    for names in ours:  # what was imported from them by name
        for name_here, value in list(names.items()):
            for module in loaded:
                if getattr(value, "__module__", None) == module.__name__:
                    names[name_here] = getattr(module, value.__name__)
    corpus = Path("corpus")
    corpus.mkdir(exist_ok=True)
    for k, text in enumerate(SEEDS[name]()):
        (corpus / str(k)).write_text(text, encoding="utf-8")
    words = [
        f"-max_total_time={seconds:.0f}",
        f"-seed={first + 1}",
        "-max_len=20000",
        "-print_final_stats=1",
        str(corpus),
    ]
    atheris.Setup([sys.argv[0], *words], TARGETS[name])
    atheris.Fuzz()


def guided(name: str, seconds: float, first: int) -> tuple[int, str | None]:
    """As `run`, by `guide` in a process of its own."""
    words = [sys.executable, "-m", "tests.fuzz", "--guide", name, "--seconds", str(seconds), "--seed", str(first)]
    here = os.environ | {"TMPDIR": str(Path.cwd())}  # it cannot tidy up
    done = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False, cwd=ROOT, env=here)
    count = re.search(r"number_of_executed_units: (\d+)", done.stderr)
    return int(count[1]) if count else 0, None if done.returncode == 0 else (done.stdout + done.stderr)[-5000:]
