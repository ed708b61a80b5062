"""A photo session: frames of a camera in, a folder of photos out, with words and a bell for the person.

The folder is the session: its photos count, so you can leave it at any time and continue it. Each photo is written
whole or not at all, under an unused number.
"""

import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.live import Live
from rich.text import Text

from spheremouse.ball.detect.detections import Image
from spheremouse.calibrate.photographing.selector import FrameCheck, Selector
from spheremouse.calibrate.photos import has_photos, image, read_photos
from spheremouse.errors import CalibrationError, SpheremouseError, os_errors_as
from spheremouse.files.pictures import Size, px
from spheremouse.files.safe_files import replace
from spheremouse.geometry.rotation import Array
from spheremouse.tracker import Frame

_CHECK_INTERVAL_S = 0.2  # between two checks for a program
_GREEN = (110, 224, 94)  # BGR, as targets in all pictures
_MAX_PICTURE_WIDTH = 800  # px of a picture for a program


@dataclass(frozen=True, slots=True)
class Outcome:
    """The end of a session."""

    selector: Selector | None  # None: no frame came
    frames: int
    hindrance: str  # of most frames
    failure: SpheremouseError | None  # of the source


@contextmanager
def open_screen(bell: bool) -> Iterator["Screen"]:
    """Open the person's view of a session on standard error; `bell` rings the terminal's bell for each photo."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    if not console.is_terminal:
        console.width = 1000
    with Live(console=console, transient=True) if console.is_terminal else nullcontext() as live:
        yield Screen(console, live, bell)


class Screen:
    """The person's view of a session: a live picture on a terminal, elsewhere lines."""

    def __init__(self, console: Console, live: Live | None, bell: bool) -> None:
        self._console, self._live, self._bell = console, live, bell
        self._wanted = ""

    def print(self, text: str) -> None:
        """Print a line that stays."""
        self._console.print(Text(text))

    def conclude(self, text: str) -> None:
        """Print a line of the result."""
        print(text)

    def show(self, selector: Selector, check: FrameCheck, picture: Image) -> None:
        """Show progress, the check of the last frame and the next instruction, in a terminal.

        Elsewhere print the next instruction after each photo that changes it. Only `JsonScreen` shows the `picture`.
        """
        wanted = selector.wanted()
        if self._live is not None:
            text = Text("\n".join(selector.status()) + "\n")
            text.append(check.words + "\n", "green" if check.gain else "yellow")
            if wanted:
                text.append(f"Next: {wanted[0]}\n", "bold")
            text.append("A photo is taken by itself when the picture is sharp, still and new. Ctrl-C ends.", "dim")
            self._live.update(text)
        elif check.gain and wanted and wanted[0] != self._wanted:
            self._wanted = wanted[0]
            self.print(f"Next: {wanted[0]}")

    def taken(self, path: Path, selector: Selector, check: FrameCheck) -> None:
        """Report a new photo."""
        self.print(f"{path.name}: {check.gain} ({selector.count} photo{'' if selector.count == 1 else 's'})")
        self.ring()

    def ring(self) -> None:
        """Ring the terminal's bell, if there is a terminal."""
        if self._bell and self._live is not None:
            self._console.bell()


class JsonScreen(Screen):
    """A program's view of a session: JSON lines on standard output, and the picture in a file."""

    def __init__(self, picture: Path | None) -> None:
        super().__init__(Console(), None, bell=False)
        self._picture, self._due = picture, 0.0

    def print(self, text: str) -> None:
        print(json.dumps({"text": text}), flush=True)

    conclude = print

    def show(self, selector: Selector, check: FrameCheck, picture: Image) -> None:
        """Print the check of a frame, and replace the picture, with detected points in it. It omits some frames."""
        now = time.monotonic()
        if now < self._due and not check.gain:
            return
        self._due = now + _CHECK_INTERVAL_S
        if self._picture is not None:
            _write(self._picture, _draw_points(picture, selector.points(check.seen)[1], bool(check.gain)))
        state = {"photos": selector.count, "check": check.words, "gain": check.gain}
        print(json.dumps({**state, "status": selector.status(), "wanted": selector.wanted()}), flush=True)


def take_photos(frames: Iterable[Frame], begin: Callable[[Size], Selector], folder: Path, screen: Screen) -> Outcome:
    """Take photos into `folder` until the selector has enough, or no more frames come.

    `begin` makes the selector for frames of a size. Raises CalibrationError if the folder cannot be used, or holds
    photos of another size.
    """
    with os_errors_as(CalibrationError, f"{folder}: cannot be made"):
        folder.mkdir(parents=True, exist_ok=True)
    selector: Selector | None = None
    count, hindrances, failure = 0, Counter[str](), None
    try:
        for frame in frames:
            count += 1
            if selector is None:
                selector = _resumed(begin, frame.image, folder, screen)
            if selector.enough:
                break
            check = selector.check(frame.image)
            hindrances[check.words.rpartition("; ")[2]] += 1
            if check.gain:
                path = store(frame.image, folder)
                selector.add(check.seen)
                screen.taken(path, selector, check)
            screen.show(selector, check, frame.image)
    except CalibrationError:
        raise
    except SpheremouseError as e:
        failure = e
    return Outcome(selector, count, hindrances.most_common(1)[0][0] if hindrances else "", failure)


def store(picture: Image, folder: Path) -> Path:
    """Write a photo under the next unused number, and return its path. Raises CalibrationError if that fails."""
    number = 0
    while (path := folder / f"view_{number:03d}.png").exists():
        number += 1
    _write(path, picture)
    return path


def _write(path: Path, picture: Image) -> None:
    with os_errors_as(CalibrationError, f"{path}: cannot be written"):
        replace(path, cv2.imencode(path.suffix, picture)[1].tobytes(), 0o600)  # it may show people


def _draw_points(picture: Image, points: Array, taken: bool) -> Image:
    """Return a small copy with a circle at each point, (n, 2) px; filled if the frame became a photo."""
    factor = min(1.0, _MAX_PICTURE_WIDTH / picture.shape[1])
    small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR) if small.ndim == 2 else small
    for u, v in np.rint(factor * points).astype(int).tolist():
        cv2.circle(small, (u, v), 5, _GREEN, -1 if taken else 1, cv2.LINE_AA)
    return small


def _resumed(begin: Callable[[Size], Selector], picture: Image, folder: Path, screen: Screen) -> Selector:
    """Return a selector that knows the photos in the folder. CalibrationError if they have another size."""
    size = picture.shape[1], picture.shape[0]
    selector = begin(size)
    if not has_photos(folder):
        return selector
    photos = read_photos([folder], lambda text: screen.print(f"note: {text}"))
    if photos[0].size != size:
        raise CalibrationError(
            f"{folder}: holds photos of {px(photos[0].size)}, the camera gives {px(size)}; choose that mode with "
            f"--source KIND:ARG,width={photos[0].size[0]},height={photos[0].size[1]}, or put the photos elsewhere"
        )
    screen.print(f"{folder}: looking at the {len(photos)} photos there")
    idle = [p.path.name for p in photos if not selector.resume(image(p))]
    screen.print(f"{folder}: goes on with {selector.count} photos")
    if idle:
        screen.print(f"note: {', '.join(idle)}: show too little to count")
    return selector
