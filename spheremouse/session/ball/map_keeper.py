"""Load the map of a ball at a run's start, and save it during the run and at its end, beside the rig.

`succession` chooses the map to save from the maps alone. The keeper saves it in another thread if frames must not wait,
because a memory card may take a second to write.
"""

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.rig import Rig
from spheremouse.errors import ConfigurationError, SpheremouseError
from spheremouse.files.ball_map import SavedMap, age, check_fits, load_map, old_path, save_map, saved_now
from spheremouse.files.safe_files import open_to_read, replace
from spheremouse.geometry.rotation import Array

EVERY = 60.0  # s between two checks for a changed map; a power cut can cost as much
_AS_GOOD = 0.8  # part of the saved map that one of the same ball must contain to replace it
_HALF = 0.5  # the same of another ball's map: a cover with a few dark spots is no ball


def open_map(path: Path, rig: Rig, kind: str) -> SavedMap:
    """Return the map of a `kind` in a file. Raise ConfigurationError if it is unreadable or does not fit the rig."""
    saved = load_map(path)
    check_fits(saved, rig, path, kind)
    return saved


@dataclass(frozen=True, slots=True)
class Succession:
    """The decision about a saved map: replace it or keep it."""

    map: BallMap | None  # to be saved, in the frame of the saved one if it is the same ball; None: the saved one stays
    rotation: Array  # (3, 3) that brought the run's map there: saved ~ run's directions @ rotation.T
    aside: bool  # the saved one is kept under another name
    text: str  # for the user; empty if the map continues unchanged


def succession(saved: BallMap | None, now: BallMap, *, absolute: bool) -> Succession:
    """Choose the map to save from the `saved` one (None: there is none) and the run's map `now`.

    `absolute` is True if the run recognised the saved map and extended it. Otherwise the run has a map of its own. If
    it is of the same ball, it is rotated into the frame of the saved one, so that attitudes stay comparable. If it is
    of another ball, it replaces the saved one. A map with too little replaces nothing, nor does one of another kind.
    """
    as_is = np.eye(3)
    if saved is None:
        return Succession(now, as_is, False, "")
    if saved.kind != now.kind:
        return Succession(None, as_is, False, f"stays unchanged: it is of {saved.kind}, and this run saw {now.kind}")
    here = saved.compare_at(now, as_is)
    if absolute and here.same_ball:  # the tracker has seen which discs are gone: it may be any number
        return Succession(now, as_is, False, "")
    found = here if here.same_ball else saved.compare(now)
    if now.amount < (_HALF if found is None else _AS_GOOD) * saved.amount:
        text = f"stays unchanged, with {saved.text}; this run did not recognise it, and knew {now.text}"
        return Succession(None, as_is, False, text)
    if found is None:
        text = f"another ball, or {now.alteration}: a new map of {now.text} saved"
        return Succession(now, as_is, True, text)
    if found is here:
        return Succession(now, as_is, False, "")
    back = found.rotation.T
    text = f"the same ball with a new map, turned into its earlier axes, {found.text}"
    return Succession(now.turned(back), back, True, text)


class Newest(NamedTuple):
    """The map of a run after a frame."""

    map: Callable[[], BallMap | None]  # None: there is nothing to save
    absolute: bool  # it extends the saved one


class MapKeeper:
    """Keeps the map of a device over one run; a context manager that saves it when left."""

    def __init__(
        self,
        path: Path,
        rig: Rig,
        kind: str,
        log: Callable[[str], None],
        every: float = EVERY,
        elsewhere: Callable[[Callable[[], None]], None] = lambda work: work(),
    ) -> None:
        """Load the map of a `kind` in `path`, if the file exists. `log` prints a line, from any thread.

        `every` is the time between two checks for changes, s. `elsewhere` has another thread save; by default the
        caller waits. Raises ConfigurationError if the folder does not exist, or if the map is unreadable or of another
        rig.
        """
        if not path.parent.is_dir():
            raise ConfigurationError(f"{path}: no such folder; name a place for the map with --map, or give --no-map")
        self.path = path
        self._rig, self._log, self._every = rig, log, every
        loaded = open_map(path, rig, kind) if path.exists() else None
        self.known = None if loaded is None else loaded.map  # map at the start of the run
        self._saved = self.known  # map in the file
        self._first = self.known  # map for comparison in the last line
        self._frame = np.eye(3)  # rotation of the run's maps into the frame of the file's
        self._aside = False
        self._writable = os.access(path.parent, os.W_OK)
        self._newest: Newest | None = None
        self._due = time.monotonic() + every
        self._elsewhere = elsewhere
        self._saving = threading.Lock()
        self._under_way = self._over = False
        self._said = ""  # the last line about saving
        if loaded is not None:
            log(f"map: {path}: {loaded.map.text}, saved {age(loaded)}")
        if not self._writable:
            log(f"map: {path.parent}: not writable: the daemon cannot save this run's map")

    def close(self) -> None:
        """Save the map, and wait until it is saved."""
        self._over = True
        now = self._now()
        if now is not None:
            with self._saving:  # not before the pending save
                self._save(*now, last=True)
        elif self._newest is not None and self._saved is None and self._writable:
            self._log(f"map: {self.path}: nothing saved: too little of the ball is known for good")

    def keep(self, newest: Newest) -> None:
        """Take the newest map, and save it if `every` seconds have passed and it has changed."""
        self._newest = newest
        clock = time.monotonic()
        if clock < self._due or self._under_way:
            return
        self._due = clock + self._every
        now = self._now()
        if now is not None:
            self._under_way = True
            self._elsewhere(lambda: self._save_meanwhile(*now))

    def _now(self) -> tuple[BallMap, bool] | None:
        """Return the run's map, and True if it extends the saved one; None if there is nothing to save."""
        if self._newest is None or not self._writable:
            return None
        found = self._newest.map()
        return None if found is None or not found.is_finite else (found, self._newest.absolute)

    def _save_meanwhile(self, now: BallMap, absolute: bool) -> None:
        with self._saving:
            if not self._over:  # then a newer one is there
                self._save(now, absolute)
        self._under_way = False

    def _save(self, now: BallMap, absolute: bool, last: bool = False) -> None:
        if absolute:
            self._frame = np.eye(3)
        now = now if np.array_equal(self._frame, np.eye(3)) else now.turned(self._frame)
        next_ = succession(self._saved, now, absolute=absolute)
        if not last and (next_.map is None or not (self._saved is None or next_.map.improves(self._saved))):
            return
        try:
            text = self._replace(next_)
        except (SpheremouseError, OSError) as e:
            text = f"not saved: {e}"
        text = text or (self._in_words() if last else "")
        if text and text != self._said:
            self._log(f"map: {self.path}: {text}")
            self._said = text

    def _replace(self, next_: Succession) -> str:
        """Replace the file as decided, and return the log lines."""
        if next_.map is None:
            return next_.text
        kept = ""
        if next_.aside and not self._aside and self.path.exists():
            kept = f"; the map before is kept in {self._set_aside()}"
        save_map(self.path, saved_now(next_.map, self._rig))
        self._saved, self._frame = next_.map, next_.rotation @ self._frame
        if next_.aside:
            self._first = next_.map
        return next_.text + kept

    def _in_words(self) -> str:
        """Return the contents of the file and the changes since the start, in words."""
        assert self._saved is not None
        saved = f"{self._saved.text} saved"
        return saved if self._first is None else f"{saved}: {self._first.compare_at(self._saved, np.eye(3)).text}"

    def _set_aside(self) -> Path:
        """Copy the map's file to another name and return that. The file itself stays until it is replaced whole."""
        old = old_path(self.path)
        with open_to_read(self.path) as file:
            replace(old, file.read())
        self._aside = True
        return old
