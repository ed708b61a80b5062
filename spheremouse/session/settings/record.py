"""Settings of recordings: their folder and their limits."""

from dataclasses import dataclass

from spheremouse.settings import param


@dataclass(frozen=True, slots=True)
class RecordSettings:
    """Recordings and snapshots of `spheremouse ctl`, with limits after which a recording ends."""

    folder: str | None = param(
        None,
        "-",
        "folder of recordings and snapshots, relative to this file; null is `recordings` in the state directory",
    )
    seconds: float = param(
        60.0, "s", "maximum duration of a recording; a minute is enough to show a fault", ge=0.1, le=86400
    )
    megabytes: float = param(
        1000.0,
        "MB",
        "maximum size of a recording; a minute of 640x480 at 60 Hz has 210 MB in grey, 1500 MB in colour",
        ge=20,
        le=1e8,  # 100 TB: a day of the largest pictures
    )
    everything: bool = param(
        False,
        "-",
        "keep whole images; by default all but ball and targets is black, to protect the people in view",
    )
    # Not a setting: MB that recordings and snapshots leave free on the disk for the system and the map.
    free_megabytes: float = 500.0
