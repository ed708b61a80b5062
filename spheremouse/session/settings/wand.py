"""What `run --tracker wand` may be told: the balls, their tracker's parameters, and how they move the pointer."""

from dataclasses import dataclass, field

from spheremouse.files.dataset.format import MOST_BALLS
from spheremouse.output.hand import PointingSettings
from spheremouse.settings import param
from spheremouse.wand.settings import WandSettings


@dataclass(frozen=True, slots=True)
class WandRunSettings(WandSettings):
    """The hand-held ball, where `tracker` is wand."""

    balls: tuple[str, ...] = param(
        (),
        "-",
        "wand files, a ball each, relative to this file's folder; none: Grzonka's ball, or the recording's own",
        most=MOST_BALLS,
    )
    points: int = param(
        1, "-", "number of the ball that moves the pointer, in the order of `balls`", ge=1, le=MOST_BALLS
    )
    axes: str | None = param(
        None,
        "-",
        "file for the six axes as text besides `output`, - for standard output; text outputs have them",
    )
    pointing: PointingSettings = field(default_factory=PointingSettings)
