"""A session before a camera: frames in, a folder of photos out, each of which added something.

The folder is the session: what is in it counts, so that it can be left at any time and continued. A photo is written
whole or not at all, under a number that nothing has.
"""

import threading
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2

from spheremouse.ball.detect.detections import Image
from spheremouse.calibrate.photographing.look import Judge, Look
from spheremouse.calibrate.photos import has_photos, image, read_photos
from spheremouse.errors import CalibrationError, SpheremouseError
from spheremouse.files.atomic import replace
from spheremouse.files.pictures import Size, px
from spheremouse.tracker import Frame


class Teller(Protocol):
    """Whoever tells a person what goes on."""

    def say(self, text: str) -> None:
        """Something that stays to be read."""
        ...

    def show(self, judge: Judge, look: Look) -> None:
        """The last frame, and how far it is."""
        ...

    def taken(self, path: Path, judge: Judge, look: Look) -> None:
        """A photo was taken."""
        ...


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a session ended."""

    judge: Judge | None  # None: no frame came
    frames: int
    hindered: str  # what hindered most frames
    failure: SpheremouseError | None  # what ended the source


def take_photos(
    frames: Iterable[Frame], begin: Callable[[Size], Judge], folder: Path, live: bool, teller: Teller
) -> Outcome:
    """Photos into `folder` until they are enough, or no more frames come.

    CalibrationError where the folder cannot be used, or holds photos of another size.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise CalibrationError(f"{folder}: cannot be made: {e.strerror or e}") from None
    judge: Judge | None = None
    aside = BackgroundTask(live)
    count, why, failure = 0, Counter[str](), None
    try:
        for frame in frames:
            count += 1
            if judge is None:
                judge = _continued(begin, frame.image, folder, teller)
            aside.ask(judge)
            if judge.enough:
                break
            look = judge.look(frame.image)
            why[look.words.rpartition("; ")[2]] += 1
            if look.gain:
                path = store(frame.image, folder)
                judge.add(look, _reader(path))
                aside.ask(judge)
                teller.taken(path, judge, look)
            teller.show(judge, look)
    except CalibrationError:
        raise
    except SpheremouseError as e:
        failure = e
    return Outcome(judge, count, why.most_common(1)[0][0] if why else "", failure)


def store(picture: Image, folder: Path) -> Path:
    """Write a photo under the next free number; whole or not at all."""
    number = 0
    while (path := folder / f"view_{number:03d}.png").exists():
        number += 1
    try:
        replace(path, cv2.imencode(".png", picture)[1].tobytes(), 0o600)  # of people, perhaps
    except OSError as e:
        raise CalibrationError(f"{path}: cannot be written: {e.strerror or e}") from None
    return path


class BackgroundTask:
    """Long calculations: at once where frames can wait, in a thread where they come when they come."""

    def __init__(self, live: bool) -> None:
        self._live = live
        self._thread: threading.Thread | None = None

    def ask(self, judge: Judge) -> None:
        """Begin what there is to calculate, unless something is under way."""
        if self._thread is not None and self._thread.is_alive():
            return
        calculate = judge.pending_work()
        if calculate is None:
            return
        if not self._live:
            calculate()
            return
        self._thread = threading.Thread(target=calculate, name="adjustment", daemon=True)  # Ctrl-C does not wait for it
        self._thread.start()


def _continued(begin: Callable[[Size], Judge], picture: Image, folder: Path, teller: Teller) -> Judge:
    """A judge that begins with what the folder holds."""
    size = picture.shape[1], picture.shape[0]
    judge = begin(size)
    if not has_photos(folder):
        return judge
    photos = read_photos([folder], lambda text: teller.say(f"note: {text}"))
    if photos[0].size != size:
        raise CalibrationError(
            f"{folder}: holds photos of {px(photos[0].size)}, the camera gives {px(size)}; choose that mode with "
            f"--source KIND:ARG,width={photos[0].size[0]},height={photos[0].size[1]}, or put the photos elsewhere"
        )
    teller.say(f"{folder}: looking at the {len(photos)} photos there")
    idle = [p.path.name for p in photos if not judge.resume(lambda photo=p: image(photo))]
    teller.say(f"{folder}: goes on with {judge.count} photos")
    if idle:
        teller.say(f"note: {', '.join(idle)}: show too little to count")
    return judge


def _reader(path: Path) -> Callable[[], Image]:
    def read() -> Image:
        return image(read_photos([path], lambda _: None)[0])

    return read
