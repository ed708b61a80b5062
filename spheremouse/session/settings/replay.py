"""The part of a configuration that a recording keeps: what tracks it again elsewhere."""

from dataclasses import replace
from typing import Any

from spheremouse.files import config
from spheremouse.session.settings import Configuration


def configuration_text(c: Configuration, **changes: Any) -> str:
    """Without what belongs to this computer: its devices, files and doors. A replay brings its own."""
    plain = type(c)()
    c = replace(
        c,
        source=None, output=None, rig=None, camera_file=None, map=None,
        control=plain.control, record=plain.record, metrics=plain.metrics, **changes,
    )  # fmt: skip
    return config.dump(c, plain)
