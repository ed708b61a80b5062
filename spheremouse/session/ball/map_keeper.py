"""Load the map of a ball at a run's start, and save it during the run and at its end, beside the rig.

`choose_map` decides which map to save from the maps alone. The keeper saves it in another thread if frames must not
wait, because a memory card may take a second to write.
"""

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from spheremouse.ball.ball_map import BallMap
from spheremouse.ball.build import map_kind
from spheremouse.ball.rig import Rig
from spheremouse.errors import ConfigurationError, SpheremouseError
from spheremouse.files.ball_map import SavedMap, age, check_fits, load_map, old_path, save_map, saved_now
from spheremouse.files.safe_files import open_to_read, replace
from spheremouse.geometry.rotation import Array
from spheremouse.session.run_config import RunConfig
from spheremouse.session.tracker_adapter import MAP, Submit, here

CHECK_INTERVAL_S = 60.0  # between two checks for a changed map; a power cut can cost as much
_MIN_OF_SAME_BALL = 0.8  # part of the saved map that one of the same ball must contain to replace it
_MIN_OF_OTHER_BALL = 0.5  # the same of another ball's map: a cover with a few dark spots is no ball


def open_map(path: Path, rig: Rig, kind: str) -> SavedMap:
    """Return the map of a `kind` in a file. Raise ConfigurationError if it is unreadable or does not fit the rig."""
    saved = load_map(path)
    check_fits(saved, rig, path, kind)
    return saved


@dataclass(frozen=True, slots=True)
class MapDecision:
    """The decision about a saved map: replace it or keep it."""

    map: BallMap | None  # to be saved, in the frame of the saved one if it is the same ball; None: the saved one stays
    text: str = ""  # for the user; empty if the map continues unchanged
    rotation: Array = field(default_factory=lambda: np.eye(3))  # (3, 3): saved ~ run's directions @ rotation.T
    keep_old: bool = False  # the saved one is kept under another name


def choose_map(saved: BallMap | None, new: BallMap, *, extends_saved: bool) -> MapDecision:
    """Decide which map to save: the `saved` one (None: there is none) stays, or the run's map `new` replaces it.

    `extends_saved` is True if the run recognised the saved map and extended it. Otherwise the run has a map of its own.
    If it is of the same ball, it is rotated into the frame of the saved one, so that attitudes stay comparable. If it
    is of another ball, it replaces the saved one. A map with too little replaces nothing, nor does one of another kind.
    """
    if saved is None:
        return MapDecision(new)
    if saved.kind != new.kind:
        return MapDecision(None, f"stays unchanged: it is of {saved.kind}, and this run saw {new.kind}")
    unrotated = saved.compare_at(new, np.eye(3))
    if extends_saved and unrotated.same_ball:  # the tracker has seen which discs are gone: it may be any number
        return MapDecision(new)
    comparison = unrotated if unrotated.same_ball else saved.compare(new)
    if new.amount < (_MIN_OF_OTHER_BALL if comparison is None else _MIN_OF_SAME_BALL) * saved.amount:
        return MapDecision(
            None, f"stays unchanged, with {saved.text}; this run did not recognise it, and knew {new.text}"
        )
    if comparison is None:
        text = f"another ball, or {new.alteration}: a new map of {new.text} saved"
        return MapDecision(new, text, keep_old=True)
    if comparison is unrotated:
        return MapDecision(new)
    back = comparison.rotation.T
    text = f"the same ball with a new map, turned into its earlier axes, {comparison.text}"
    return MapDecision(new.turned(back), text, back, keep_old=True)


def open_keeper(plan: RunConfig, rig: Rig, log: Callable[[str], None], submit: Submit = here) -> "MapKeeper | None":
    """Return the keeper of a plan's map; None if the plan keeps none. `rig` is of the first camera."""
    if plan.map_path is None:
        return None
    return MapKeeper(plan.map_path, rig, map_kind(rig, plan.configuration), log, elsewhere=partial(submit, MAP))


class Newest(NamedTuple):
    """The map of a run after a frame."""

    map: Callable[[], BallMap | None]  # None: there is nothing to save
    extends_saved: bool  # the run recognised the saved map and extends it


class MapKeeper:
    """Keeps the map of a device over one run; a context manager that saves it when left."""

    def __init__(
        self,
        path: Path,
        rig: Rig,
        kind: str,
        log: Callable[[str], None],
        check_interval_s: float = CHECK_INTERVAL_S,
        elsewhere: Callable[[Callable[[], None]], None] = lambda work: work(),
    ) -> None:
        """Load the map of a `kind` in `path`, if the file exists. `log` prints a line, from any thread.

        `elsewhere` has another thread save; by default the caller waits. Raises ConfigurationError if the folder does
        not exist, or if the map is unreadable or of another rig.
        """
        if not path.parent.is_dir():
            raise ConfigurationError(f"{path}: no such folder; name a place for the map with --map, or give --no-map")
        self.path = path
        self._rig, self._log, self._check_interval_s = rig, log, check_interval_s
        loaded = open_map(path, rig, kind) if path.exists() else None
        self.known = None if loaded is None else loaded.map  # map at the start of the run
        self._saved = self.known  # map in the file
        self._first = self.known  # map for comparison in the last line
        self._frame = np.eye(3)  # rotation of the run's maps into the frame of the file's
        self._old_kept = False  # the map before this run has another name now
        self._writable = os.access(path.parent, os.W_OK)
        self._newest: Newest | None = None
        self._due = time.monotonic() + check_interval_s
        self._elsewhere = elsewhere
        self._saving = threading.Lock()
        self._under_way = self._over = False
        self._last_message = ""  # of the last save; empty if it had none
        if loaded is not None:
            log(f"map: {path}: {loaded.map.text}, saved {age(loaded.saved)}")
        if not self._writable:
            log(f"map: {path.parent}: not writable: the daemon cannot save this run's map")

    def close(self) -> None:
        """Save the map, and wait until it is saved."""
        self._over = True
        newest = self._newest_map()
        if newest is not None:
            with self._saving:  # not before the pending save
                self._save(*newest, last=True)
        elif self._newest is not None and self._saved is None and self._writable:
            self._log(f"map: {self.path}: nothing saved: too little of the ball is known for good")

    def keep(self, newest: Newest) -> None:
        """Take the newest map, and save it if the interval has passed and it has changed."""
        self._newest = newest
        clock = time.monotonic()
        if clock < self._due or self._under_way:
            return
        self._due = clock + self._check_interval_s
        current = self._newest_map()
        if current is not None:
            self._under_way = True
            self._elsewhere(lambda: self._save_meanwhile(*current))

    def _newest_map(self) -> tuple[BallMap, bool] | None:
        """Return the run's map, and True if it extends the saved one; None if there is nothing to save."""
        if self._newest is None or not self._writable:
            return None
        found = self._newest.map()
        return None if found is None or not found.is_finite else (found, self._newest.extends_saved)

    def _save_meanwhile(self, new: BallMap, extends_saved: bool) -> None:
        with self._saving:
            if not self._over:  # then a newer one is there
                self._save(new, extends_saved)
        self._under_way = False

    def _save(self, new: BallMap, extends_saved: bool, *, last: bool = False) -> None:
        """Save the run's map if it is worth it, and log the decision, the error or, at the `last` time, the contents.

        During the run a map that is no better than the file is not saved, and not reported. A message is not repeated
        while the saves have the same.
        """
        if extends_saved:
            self._frame = np.eye(3)
        new = new if np.array_equal(self._frame, np.eye(3)) else new.turned(self._frame)
        decision = choose_map(self._saved, new, extends_saved=extends_saved)
        worth_saving = decision.map is not None and (self._saved is None or decision.map.improves(self._saved))
        if not (last or worth_saving):
            return
        try:
            text = self._replace(decision)
        except (SpheremouseError, OSError) as e:
            text = f"not saved: {e}"
        if text and text != self._last_message:
            self._log(f"map: {self.path}: {text}")
        elif last and not text:
            self._log(f"map: {self.path}: {self._describe_saved()}")
        self._last_message = text

    def _replace(self, decision: MapDecision) -> str:
        """Replace the file as decided, and return the message; empty if the map continues."""
        if decision.map is None:
            return decision.text
        kept = ""
        if decision.keep_old and not self._old_kept and self.path.exists():
            kept = f"; the map before is kept in {self._keep_old()}"
        save_map(self.path, saved_now(decision.map, self._rig))
        self._saved, self._frame = decision.map, decision.rotation @ self._frame
        if decision.keep_old:
            self._first = decision.map
        return decision.text + kept

    def _describe_saved(self) -> str:
        """Return the contents of the file and the changes since the start, in words."""
        assert self._saved is not None
        saved = f"{self._saved.text} saved"
        return saved if self._first is None else f"{saved}: {self._first.compare_at(self._saved, np.eye(3)).text}"

    def _keep_old(self) -> Path:
        """Copy the map's file to another name and return that. The file itself stays until it is replaced whole."""
        old = old_path(self.path)
        with open_to_read(self.path) as file:
            replace(old, file.read())
        self._old_kept = True
        return old
