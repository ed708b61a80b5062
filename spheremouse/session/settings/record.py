"""What may be configured of recordings: where they go, and when they end by themselves."""

from dataclasses import dataclass

from spheremouse.settings import param


@dataclass(frozen=True, slots=True)
class RecordSettings:
    """Recordings and snapshots, made when somebody asks for one; bounded, whatever happens to who asked."""

    folder: str | None = param(
        None,
        "-",
        "folder of recordings and snapshots, relative to this file; null takes recordings/ in the state directory",
    )
    seconds: float = param(60.0, "s", "a recording ends after so long: a fault is shown in a minute", ge=0.1, le=86400)
    megabytes: float = param(
        1000.0,
        "MB",
        "and when it has this size: a minute of 640x480 at 60 Hz has 210 MB in grey, 1500 in colour",
        ge=20,
        le=1e8,  # 100 TB: a day of the largest pictures
    )
    free_megabytes: float = param(
        500.0, "MB", "and when no more than this is free on the disk: the system and the map need room", ge=0, le=1e8
    )
    everything: bool = param(
        False,
        "-",
        "keep whole pictures; by default all but ball and targets is black, for people did not ask to be filmed",
    )
