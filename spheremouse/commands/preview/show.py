"""Frames in, pictures and words out: what is made out in a frame while nothing is known of the device."""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.projection import GREY, projected
from spheremouse.ball.detect.sharpness import blur_of
from spheremouse.calibrate.rolling.start import Spots, dark_spots
from spheremouse.capture.signals import SignalHandler
from spheremouse.commands.doctor.finding import Finding
from spheremouse.commands.doctor.light import brightness
from spheremouse.errors import ConfigurationError, SourceError
from spheremouse.files import config
from spheremouse.files.rig import load_rig
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import mad_sigma
from spheremouse.session import messages
from spheremouse.session.cameras import looked_through
from spheremouse.session.overlay.file import OverlayFile, write_picture
from spheremouse.session.overlay.sight import Sight, draw_sight, sight_of
from spheremouse.session.settings import Configuration
from spheremouse.tracker import Frame

_SETTLING = 1.0  # s that a camera takes for its exposure
_FILM = 5.0  # pictures a second: each takes tenths of one
_USUAL = np.array([1.0, 2.0, 3.0])  # proportions of the targets that `calibrate print` makes
_SHARP, _SOFT = 1.0, 1.5  # px of blur: a lens in focus has 0.3 to 0.7; rings of 4 px begin to go from 1.5 on


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the command line says."""

    source: str
    out: Path
    at: float | None  # s after the first frame
    rig: Path | None
    config: Path | None
    assignments: tuple[str, ...]
    as_json: bool


@dataclass(frozen=True, slots=True)
class Seen:
    """What one frame shows."""

    frame: Frame
    sight: Sight
    spots: Spots
    blur: float  # px
    light: Finding

    @property
    def sharpness(self) -> str:
        """In a word."""
        if not np.isfinite(self.blur):
            return "no edge seen"
        return "sharp" if self.blur < _SHARP else "soft" if self.blur < _SOFT else "blurred"

    @property
    def picture(self) -> Image:
        """The frame with all of it."""
        words = messages.found(self.sight.targets.codes, self.sight.codes)
        brief = f"{self.sharpness}; brightest {self.light.values['grey']:.0f} of 255"
        return draw_sight(
            self.frame.image, self.sight, ((words, 0.012), (brief, 0.68)), (self.spots.centre, self.spots.area)
        )

    def data(self) -> dict[str, Any]:
        """The same for programs."""
        targets, height, width = self.sight.targets, *self.frame.image.shape[:2]
        return {
            "size": [width, height],
            "colour": self.frame.image.ndim == 3,
            "targets": [
                {"code": c, "place_px": np.round(p, 2).tolist(), "radius_px": round(float(r), 2)}
                for c, p, r in zip(targets.codes, targets.centre, targets.radius, strict=True)
            ],
            "strangers": list(self.sight.strangers),
            "refused": [
                {
                    "code": r.code,
                    "place_px": np.round(r.centre, 2).tolist(),
                    "radius_px": round(r.radius, 2),
                    "bound": r.bound,
                }
                for r in self.sight.refused
            ],
            "spots": len(self.spots.area),
            "blur_px": None if np.isnan(self.blur) else round(self.blur, 2),
            **self.light.values,
        }

    def lines(self) -> Iterator[str]:
        """The same for people."""
        height, width = self.frame.image.shape[:2]
        colour = self.frame.image.ndim == 3
        yield f"picture     {width}x{height}" + ("" if colour else ", grey: ring targets need colour")
        if colour:
            yield f"targets     {messages.found(self.sight.targets.codes, self.sight.codes)}"
        for (said, bound), n in Counter((messages.refusal(r), r.bound) for r in self.sight.refused).items():
            yield f"refused     {said}{f' ({n} times)' if n > 1 else ''}; {messages.remedy(bound)}"
        across = 2.0 * float(np.sqrt(np.median(self.spots.area) / np.pi)) if len(self.spots.area) else 0.0
        yield f"dark spots  {len(self.spots.area)}" + (f", usually {across:.0f} px across" if across else "")
        focus = "" if self.blur < _SHARP else "; focus the lens; more light lets a camera expose shorter"
        yield f"sharpness   {self.sharpness}" + (
            "" if np.isnan(self.blur) else f", edges {self.blur:.1f} px wide{focus}"
        )
        yield f"brightness  {self.light.text}" + (f"; {self.light.advice}" if self.light.advice else "")


def pictures(wanted: Wanted, every: float | None) -> None:
    """One, or one after the other until the source ends or somebody stops it."""
    due = -np.inf
    with _looked_at(wanted, every is not None) as (frames, look):
        for frame in frames:
            if frame.stamp < due:
                continue
            due = frame.stamp + (every or 0.0)
            seen = look(frame)
            write_picture(wanted.out, seen.picture)
            _tell(wanted, seen)
            if every is None:
                break
    if due == -np.inf:
        raise _nothing(wanted)


def film(wanted: Wanted, seconds: float) -> None:
    """So long, at a steady rate: where looking takes longer than that, a picture stands."""
    seen: Seen | None = None
    with OverlayFile(wanted.out, _FILM) as file, _looked_at(wanted, False) as (frames, look):
        begun, shown = 0.0, 0
        for frame in frames:
            begun = begun if shown else frame.stamp
            due = int((frame.stamp - begun) * _FILM) + 1
            if due <= shown:
                continue
            if frame.stamp - begun > seconds:
                break
            seen = look(frame)
            picture = seen.picture
            for _ in range(due - shown):
                file.show(lambda picture=picture: picture)
            shown = due
    if seen is None:
        raise _nothing(wanted)
    _tell(wanted, seen)


def _nothing(wanted: Wanted) -> SourceError:
    late = "" if wanted.at is None else f" from {wanted.at:g} s on: give a smaller --at"
    return SourceError(f"{wanted.source}: gave no frame{late}")


def _tell(wanted: Wanted, seen: Seen) -> None:
    if wanted.as_json:
        print(json.dumps({"file": str(wanted.out), **seen.data()}), flush=True)
    else:
        print("\n".join((f"{wanted.out}: {wanted.source} at {seen.frame.stamp:.2f} s", *seen.lines())), flush=True)


@contextmanager
def _looked_at(wanted: Wanted, realtime: bool) -> Iterator[tuple[Iterator[Frame], Callable[[Frame], Seen]]]:
    """The frames that are wanted, until somebody stops it, and what looks at one."""
    settings = config.in_force(wanted.config, wanted.assignments, Configuration)
    rig = None if wanted.rig is None else load_rig(wanted.rig)
    argument = wanted.source.partition(":")[2]
    if argument and wanted.out.resolve() == Path(argument).resolve():
        raise ConfigurationError(f"--out: {wanted.out} is what is looked at; name another file")
    with looked_through(wanted.source, settings.camera, realtime) as source, SignalHandler() as stopping:
        rig = rig or source.rig
        radii, codes = (_USUAL, None) if rig is None else (rig.targets.radii, rig.targets.codes)
        at = wanted.at if wanted.at is not None else _SETTLING if source.live else 0.0
        frames = _from(stopping.frames(iter(source)), at)
        yield frames, lambda frame: _look(frame, radii, codes, settings)


def _from(frames: Iterator[Frame], at: float) -> Iterator[Frame]:
    first: float | None = None
    for frame in frames:
        first = frame.stamp if first is None else first
        if frame.stamp - first >= at:
            yield frame


def _look(frame: Frame, radii: Array, codes: tuple[str, ...] | None, settings: Configuration) -> Seen:
    image = frame.image
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    noise = float(mad_sigma(np.diff(grey[::4].astype(np.float32), axis=1).ravel())) / np.sqrt(2.0)
    dark = projected(image, settings.discs.projection or GREY)
    light = brightness([grey], None, settings.discs, noise)
    return Seen(frame, sight_of(image, radii, codes, settings.rings), dark_spots(dark), blur_of(grey), light)
