"""Text made by libFuzzer, which looks where in our code it leads."""

import importlib
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from spheremouse.ball.track import Settings
from spheremouse.files import config
from spheremouse.files.rig import rig_text
from tests.fuzz.control import MESSAGES
from tests.fuzz.scene import small_rig
from tests.fuzz.targets import TARGETS
from tests.fuzz.texts import whole

ROOT = Path(__file__).parents[2]
SEEDS: dict[str, Callable[[], list[str]]] = {
    "configuration": lambda: [config.dump(Settings(), Settings()), "schema: 1\nso3: {acceleration_sigma: 1}\n"],
    "daemon's configuration": lambda: [config.dump(whole()(), whole()()), "schema: 1\n"],
    "control messages": lambda: list(MESSAGES),
    "rig": lambda: [rig_text(small_rig())],
}
# The modules that are looked into.
GUIDING = ("files.yaml", "files.validate", "files.config", "files.rig", "session.control.protocol")
