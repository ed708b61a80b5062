"""Settings of `run --tracker wand`: the balls, the tracker, and the mapping to the pointer."""

from dataclasses import dataclass, field

from spheremouse.files.dataset.format import MOST_BALLS
from spheremouse.output.wand_mapping import PointingSettings
from spheremouse.settings import param
from spheremouse.wand.settings import WandSettings


@dataclass(frozen=True, slots=True)
class WandRunSettings(WandSettings):
    """The hand-held ball, where `tracker` is wand."""

    balls: tuple[str, ...] = param(
        (),
        "-",
        "wand files, one for each ball, relative to this file's folder; by default the recording's ball, or Grzonka's",
        most=MOST_BALLS,
    )
    points: int = param(
        1, "-", "number of the ball that moves the pointer, in the order of `balls`", ge=1, le=MOST_BALLS
    )
    axes: str | None = param(
        None,
        "-",
        "file for the six axes as text, in addition to `output`; - is standard output",
    )
    pointing: PointingSettings = field(default_factory=PointingSettings)
