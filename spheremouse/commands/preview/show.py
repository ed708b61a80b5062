"""Analyse frames without a rig: targets, dark spots, sharpness and brightness, as pictures and text."""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse.ball.detect.blur import blur_of
from spheremouse.ball.detect.detections import Image
from spheremouse.ball.detect.projection import GREY, projected
from spheremouse.calibrate.rolling.start import Spots, dark_spots
from spheremouse.capture import section
from spheremouse.capture.signals import SignalHandler
from spheremouse.commands.doctor.sight import brightness
from spheremouse.commands.doctor.sight import grey as grey_of
from spheremouse.commands.preview import PreviewOptions
from spheremouse.errors import ConfigurationError, SourceError
from spheremouse.files import config
from spheremouse.files.rig import load_rig
from spheremouse.finding import Finding
from spheremouse.geometry.rotation import Array
from spheremouse.geometry.statistics import mad_sigma
from spheremouse.session import messages
from spheremouse.session.cameras import looked_through
from spheremouse.session.overlay.file import write_picture
from spheremouse.session.overlay.sight import Sight, draw_sight, sight_of
from spheremouse.session.settings import Configuration
from spheremouse.tracker import Frame

_EXPOSURE_S = 1.0  # until a camera has set its exposure
_TARGET_PROPORTIONS = np.array([1.0, 2.0, 3.0])  # of the targets of `calibrate print`
_MAX_SHARP_PX, _MAX_SOFT_PX = 1.0, 1.5  # blur: a focused lens has 0.3 to 0.7; rings of 4 px are lost from 1.5


@dataclass(frozen=True, slots=True)
class Analysis:
    """Results for one frame."""

    frame: Frame
    sight: Sight
    spots: Spots
    blur: float  # px
    light: Finding

    @property
    def sharpness(self) -> str:
        if not np.isfinite(self.blur):
            return "no edge analysis"
        return "sharp" if self.blur < _MAX_SHARP_PX else "soft" if self.blur < _MAX_SOFT_PX else "blurred"

    @property
    def picture(self) -> Image:
        """Draw the results into the frame."""
        words = messages.list_targets(self.sight.targets.codes, self.sight.codes)
        brief = f"{self.sharpness}; brightest {self.light.values['grey']:.0f} of 255"
        return draw_sight(
            self.frame.image, self.sight, ((words, 0.012), (brief, 0.68)), (self.spots.centre, self.spots.area)
        )

    def data(self) -> dict[str, Any]:
        """Return the results as JSON data."""
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
            "lines": list(self.lines()),
        }

    def lines(self) -> Iterator[str]:
        """Yield the results as lines of text."""
        height, width = self.frame.image.shape[:2]
        colour = self.frame.image.ndim == 3
        yield f"picture     {width}x{height}" + ("" if colour else ", grey: ring targets need colour")
        if colour:
            yield f"targets     {messages.list_targets(self.sight.targets.codes, self.sight.codes)}"
        for (reason, bound), n in Counter((messages.refusal(r), r.bound) for r in self.sight.refused).items():
            yield f"refused     {reason}{f' ({n} times)' if n > 1 else ''}; {messages.remedy(bound)}"
        across = 2.0 * float(np.sqrt(np.median(self.spots.area) / np.pi)) if len(self.spots.area) else 0.0
        yield f"dark spots  {len(self.spots.area)}" + (f", usually {across:.0f} px across" if across else "")
        focus = "" if self.blur < _MAX_SHARP_PX else "; focus the lens; more light lets a camera expose shorter"
        yield f"sharpness   {self.sharpness}" + (
            "" if np.isnan(self.blur) else f", edges {self.blur:.1f} px wide{focus}"
        )
        yield f"brightness  {self.light.text}" + (f"; {self.light.advice}" if self.light.advice else "")


def pictures(options: PreviewOptions, source: str) -> None:
    """Write one picture. With `every`, replace it until the source ends or a signal arrives."""
    due = -np.inf
    with _open(options, source) as (frames, analyse):
        for frame in frames:
            if frame.stamp < due:
                continue
            due = frame.stamp + (options.every or 0.0)
            analysis = analyse(frame)
            write_picture(options.out, analysis.picture)
            if options.as_json:
                print(json.dumps({"source": source, "file": str(options.out), **analysis.data()}), flush=True)
            else:
                head = f"{options.out}: {source} at {frame.stamp:.2f} s"
                print("\n".join((head, *analysis.lines())), flush=True)
            if options.every is None:
                break
    if due == -np.inf:
        hint = "" if options.at is None else f" from {options.at:g} s on: give a smaller --at"
        raise SourceError(f"{source}: gave no frame{hint}")


@contextmanager
def _open(options: PreviewOptions, source: str) -> Iterator[tuple[Iterator[Frame], Callable[[Frame], Analysis]]]:
    """Yield the frames until a signal arrives, and the function that analyses one."""
    settings = config.in_force(options.config, options.assignments or (), Configuration)
    rig = None if options.rig is None else load_rig(options.rig)
    argument = source.partition(":")[2]
    if argument and options.out.resolve() == Path(argument).resolve():
        raise ConfigurationError(f"--out: {options.out} is the source; name another file")
    realtime = options.every is not None
    with looked_through(source, settings.camera, realtime) as opened, SignalHandler() as signals:
        rig = rig or opened.rig
        radii, codes = (_TARGET_PROPORTIONS, None) if rig is None else (rig.targets.radii, rig.targets.codes)
        at = options.at if options.at is not None else _EXPOSURE_S if opened.live else 0.0
        yield section(signals.frames(iter(opened)), at), lambda frame: _analyse(frame, radii, codes, settings)


def _analyse(frame: Frame, radii: Array, codes: tuple[str, ...] | None, settings: Configuration) -> Analysis:
    image = frame.image
    grey = grey_of(image)
    noise = float(mad_sigma(np.diff(grey[::4].astype(np.float32), axis=1).ravel())) / np.sqrt(2.0)
    dark = projected(image, settings.discs.projection or GREY)
    light = brightness([grey], mask=None, settings=settings.discs, noise=noise)
    return Analysis(frame, sight_of(image, radii, codes, settings.rings), dark_spots(dark), blur_of(grey), light)
