"""Write and read the map of a ball, beside its rig: discs (`disc_map`) or a picture of the pattern (`picture_map`)."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from spheremouse import __version__
from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.disc_map import DiscMap
from spheremouse.ball.rig import Rig
from spheremouse.errors import ConfigurationError
from spheremouse.files import disc_map
from spheremouse.files.safe_files import write_atomically
from spheremouse.files.yaml import SCHEMAS, parse_bytes, read_raw

BALL_DIFFERS, _DISC_DIFFERS = 0.05, 0.25  # parts of a radius; less is calibration, more is another device
_MAX_BYTES = 8_000_000  # a picture of noise has 3 MB
_PICTURE = b"\npicture: |\n"  # key of the last entry of a map of a pattern


@dataclass(frozen=True, slots=True)
class SavedMap:
    """A map, the sizes of its device, and its age."""

    map: BallMap
    ball_radius: float  # m
    disc_radius: float | None  # m, along the surface; None: of a pattern
    saved: datetime  # with its time zone
    version: str  # of the program that wrote it


def map_path(rig_file: Path, kind: str = DiscMap.kind) -> Path:
    """Return the path of a device's map beside `rig.yaml`: `rig.map.yaml` of discs, `rig.pattern.yaml` of a pattern."""
    return rig_file.with_suffix(".map.yaml" if kind == DiscMap.kind else ".pattern.yaml")


def old_path(path: Path) -> Path:
    """Return the path for a map that another ball's map replaces: `rig.map.old.yaml` for `rig.map.yaml`."""
    return path.with_suffix(f".old{path.suffix}")


def saved_now(ball_map: BallMap, rig: Rig) -> SavedMap:
    """Return a map to save, with the sizes of this device, the time and our version."""
    now = datetime.now(UTC).replace(microsecond=0)
    disc_radius = rig.disc_radius if ball_map.kind == DiscMap.kind else None
    return SavedMap(ball_map, rig.ball.radius, disc_radius, now, __version__)


def save_map(path: Path, saved: SavedMap) -> None:
    """Write a map file, whole or not at all; it reads back to the same map."""
    write_atomically(path, map_text(saved))


def load_map(path: Path) -> SavedMap:
    """Read a map file; ConfigurationError with problem and remedy."""
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file; check the path")
    try:
        text, key, picture = read_raw(path, _MAX_BYTES).partition(_PICTURE)
        document = parse_bytes(text + b"\n", str(path))
        if key:
            from spheremouse.files import picture_map

            file, found = picture_map.parse(document, picture)
        else:
            file, found = disc_map.parse(document)
    except ConfigurationError as e:
        first, *others = str(e).splitlines()
        more = f" (and {len(others)} more)" if others else ""
        raise ConfigurationError(
            f"{first}{more}; mend that, or move the file away: a new map is made as the ball turns"
        ) from None
    disc_radius = getattr(file, "disc_radius", None)
    return SavedMap(found, file.ball_radius, disc_radius, datetime.fromisoformat(file.saved), file.spheremouse)


def map_text(saved: SavedMap) -> str:
    header = [
        f"schema: {SCHEMAS['map']}",
        f'spheremouse: "{saved.version}"',
        f'saved: "{saved.saved.isoformat()}"',
        f"ball_radius: {float(saved.ball_radius)!r}  # m",
    ]
    made: Any = saved.map
    if made.kind == DiscMap.kind:
        assert saved.disc_radius is not None
        lines = disc_map.lines(header, made, saved.disc_radius)
    else:
        from spheremouse.files import picture_map

        lines = picture_map.lines(header, made)
    return "\n".join(lines) + "\n"


def check_fits(saved: SavedMap, rig: Rig, path: Path, kind: str) -> None:
    """Raise ConfigurationError if a map shows another `kind` of thing, or has other sizes than those of the rig."""
    remedy = (
        "name this device's map with --map, or move the file away, and the tracker creates a new one as the ball turns"
    )
    if saved.map.kind != kind:
        raise ConfigurationError(f"{path}: is a map of {saved.map.kind}, and the tracker follows {kind}: {remedy}")
    for what, saved_radius, radius, tolerance in (
        ("a ball", saved.ball_radius, rig.ball.radius, BALL_DIFFERS),
        ("discs", saved.disc_radius, rig.disc_radius, _DISC_DIFFERS),
    ):
        if saved_radius is not None and radius is not None and abs(saved_radius - radius) > tolerance * radius:
            raise ConfigurationError(
                f"{path}: was made with {what} of radius {saved_radius:g} m, the rig has {radius:g} m: {remedy}"
            )


def age(then: datetime) -> str:
    """Return the time since then, in words."""
    seconds = (datetime.now(UTC) - then).total_seconds()
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * length:
            return f"{seconds / length:.0f} {unit} ago"
    return "just now"
