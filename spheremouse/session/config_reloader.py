"""Apply a new configuration between two frames, or refuse it as a whole.

`set` changes the values in memory. If a value needs files, another device, tracker or detector, and for `reload`, a
thread of the pool reads all files. It does so too when one of them has changed. Only the worker calls the methods.
Other threads may read the attributes.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spheremouse.ball.settings import Settings
from spheremouse.errors import ControlError, SpheremouseError
from spheremouse.files import config, exchange
from spheremouse.files.config import key_of
from spheremouse.files.validate import nearest
from spheremouse.files.yaml import dotted
from spheremouse.session.control.protocol import Save, internal_error, refused
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.process.threads import WorkerPool
from spheremouse.session.run_config import CommandLineOverrides, RunConfig, check_kinds, read_run_config
from spheremouse.session.settings import Configuration
from spheremouse.session.setup import Setup
from spheremouse.wand.settings import WandSettings

# Sections and keys whose values name files or devices, or select tracker and detector.
_READ_FILES = ("source", "output", "rig", "camera_file", "map", "wand.balls", "record.folder", "tracker", "detector")
AT_START = ("control", "metrics", "realtime")  # settings that are read at the start only
_OF_BALL = {"motion", *Settings.__dataclass_fields__} - {"tracker"}
_UNREAD = {  # sections and keys that a tracker in use does not read
    "so3": {"wand", "euler"},
    "ekf1": {"wand", "so3"},
    "ekf2": {"wand", "so3"},
    "wand": _OF_BALL,
}

Values = dict[str, tuple[Any, Any]]  # by key: old value and new value


def stamps_of(overrides: CommandLineOverrides, plan: RunConfig) -> dict[Path, int]:
    """Return the modification times of the files of a plan."""
    found: dict[Path, int] = {}
    rigs = (each.rig_path for each in plan.cameras)
    for path in (overrides.file, overrides.saved, *rigs, plan.camera_path, *plan.ball_paths):
        if path is not None:
            try:
                found[path] = path.stat().st_mtime_ns
            except OSError:
                found[path] = 0
    return found


def latest(assignments: tuple[str, ...]) -> tuple[str, ...]:
    """Return the last assignment to each key, in order."""
    last = {key_of(a): k for k, a in enumerate(assignments)}
    return tuple(a for k, a in enumerate(assignments) if last[key_of(a)] == k)


def given(overrides: CommandLineOverrides) -> tuple[str, ...]:
    """Return the keys that the command line sets; no file changes them."""
    return (*dict.fromkeys(map(key_of, overrides.assignments)), *(("map",) if overrides.no_map else ()))


def settings_in_use(overrides: CommandLineOverrides, plan: RunConfig) -> list[dict[str, Any]]:
    """Return the settings that the tracker of a plan reads, as `config.described`.

    `saved` is the value without the changes by `set`. `live` is true if `set` can change the value.
    """
    saved = _by_key(plan.without_changes)
    fixed = (*AT_START, "map") if overrides.no_map else AT_START
    described = ((about, about["key"].partition(".")[0]) for about in config.describe(plan.configuration))
    unread = _UNREAD[plan.configuration.tracker]
    return [
        {**about, "saved": saved[about["key"]], "live": section not in fixed}
        for about, section in described
        if section not in unread
    ]


def check_settable(overrides: CommandLineOverrides, assignments: tuple[str, ...]) -> None:
    """Raise ControlError for a setting that is read at the start only, and for `map` under --no-map."""
    sections = {key_of(a).partition(".")[0] for a in assignments}
    if at_start := sorted(sections.intersection(AT_START)):
        hint = "write it into the configuration file and start again"
        raise ControlError(f"{', '.join(at_start)}: read at the start only", hint)
    if overrides.no_map and "map" in sections:
        raise ControlError("map: this run keeps no map; start again without --no-map")


def check_read(plan: RunConfig, assignments: tuple[str, ...]) -> None:
    """Raise ControlError if the tracker of a plan does not read an assigned key."""
    tracker = plan.configuration.tracker
    unread = [k for k in map(key_of, assignments) if k.partition(".")[0] in _UNREAD[tracker]]
    if unread:
        raise ControlError(f"{', '.join(unread)}: the tracker in use, {tracker}, does not read this setting")


def values(old_plan: RunConfig, new_plan: RunConfig, assignments: tuple[str, ...]) -> Values:
    """Return old and new value of each parameter that has changed or was assigned."""
    a, b = _by_key(old_plan.configuration), _by_key(new_plan.configuration)
    assigned = set(map(key_of, assignments))
    return {key: (a[key], b[key]) for key in b if a[key] != b[key] or key in assigned}


def _by_key(configuration: Configuration) -> dict[str, Any]:
    return {dotted(key): value for key, value in config.parameters(configuration)}


def describe_changes(values: Values) -> str:
    return ", ".join(
        f"{key} {config.to_yaml(old)} → {config.to_yaml(new)}" if old != new else f"{key} {config.to_yaml(new)} already"
        for key, (old, new) in values.items()
    )


def differences(before: RunConfig, now: RunConfig) -> list[str]:
    """Return the names of the sections of the configuration that have changed.

    Settings that the tracker of `now` does not read do not count. Rigs, lenses and balls are compared by path and
    content, the map by its path.
    """
    a, b = before.configuration, now.configuration
    cameras = list(zip(before.cameras, now.cameras, strict=True))
    if b.tracker == "wand":
        tracker_changed = any(
            getattr(a.wand, f) != getattr(b.wand, f) for f in (*WandSettings.__dataclass_fields__, "points")
        )
        motion_changed = a.wand.pointing != b.wand.pointing
    else:
        tracker_changed = any(getattr(a, f) != getattr(b, f) for f in Settings.__dataclass_fields__)
        motion_changed = a.motion != b.motion
    changed = {
        "tracker": tracker_changed,
        "source": any(old.source != new.source for old, new in cameras) or a.camera != b.camera,
        "output": before.outputs != now.outputs,
        "rig": any(old.rig_path != new.rig_path or not _same(old.rig, new.rig) for old, new in cameras)
        or not _same(before.camera, now.camera),
        "map": before.map_path != now.map_path,
        "balls": before.ball_paths != now.ball_paths or not _same(before.balls, now.balls),
        "motion": motion_changed,
    }
    for name in ("pointer", "record", *AT_START):
        changed[name] = getattr(a, name) != getattr(b, name)
    return [name for name, differs in changed.items() if differs]


def _same(a: Any, b: Any) -> bool:
    """Compare two devices, nested dataclasses with arrays."""
    if a is None or b is None:
        return a is b
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    if isinstance(a, tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(_same, a, b))
    if hasattr(type(a), "__dataclass_fields__"):
        return type(a) is type(b) and all(_same(getattr(a, f), getattr(b, f)) for f in type(a).__dataclass_fields__)
    return bool(a == b)


READING = "reading"  # kind of the pool's work
_MIN_READING_INTERVAL = 0.1  # s from one reading to the next, since reading holds the interpreter as tracking does

Prepare = Callable[[RunConfig, list[str]], Callable[[], bool]]


class ConfigReloader:
    """Holds the overrides and the plan of a run, and changes both together."""

    def __init__(
        self,
        overrides: CommandLineOverrides,
        plan: RunConfig,
        setup: Setup,
        prepare: Prepare,
        *,
        workers: WorkerPool,
        call: Callable[[Callable[[], None]], None],
        log: Callable[[str], None],
    ) -> None:
        """`prepare` takes a plan and the changed sections. It raises SpheremouseError to refuse the plan, or returns
        a function that applies it and returns True if that has ended a recording. `call` runs a call in the worker.
        """
        self.overrides, self.plan, self._setup, self._prepare = overrides, plan, setup, prepare
        self._workers, self._call, self._log = workers, call, log
        self._files = stamps_of(overrides, plan)
        self._read_at = 0.0  # s, end of the last reading

    @property
    def outdated(self) -> bool:
        """Return True if a file has been written since it was read."""
        return self._files != stamps_of(self.overrides, self.plan)

    def set(self, assignments: tuple[str, ...], pending: PendingRequest) -> None:
        """Change parameters, KEY=VALUE, all or none. `pending` gets the result, perhaps later.

        Raises ControlError or ConfigurationError if one cannot take effect.
        """
        self._change(self.plan.configuration, self.overrides.changes, assignments, pending)

    def profile(self, name: str | None, pending: PendingRequest) -> None:
        """Replace all changes by `set` and `profile` by those of a profile; with None answer with all profiles.

        Raises ControlError for an unknown profile.
        """
        profiles = self.plan.configuration.profiles
        if name is None:
            pending.answer({"profiles": profiles})
        elif name not in profiles:
            hint = nearest(name, list(profiles)) if profiles else "write `profiles:` into the configuration file"
            raise ControlError(f"profile: there is no profile {name!r}", hint)
        else:
            self._change(self.plan.without_changes, (), profiles[name], pending)

    def _change(
        self, configuration: Configuration, changes: tuple[str, ...], assigned: tuple[str, ...], pending: PendingRequest
    ) -> None:
        """Assign values to a configuration that has these changes already."""
        check_settable(self.overrides, assigned)
        wanted = replace(self.overrides, changes=latest((*changes, *assigned)))
        dropped = set(map(key_of, self.overrides.changes)) - set(map(key_of, wanted.changes))
        if not (dropped | set(map(key_of, assigned))).isdisjoint(_READ_FILES):
            self._load(wanted, pending, assigned)
            return
        for assignment in assigned:
            configuration = config.override(configuration, assignment, label="")
        plan = replace(self.plan, configuration=configuration)
        check_read(plan, assigned)
        self._apply(wanted, plan, self._files, pending, assigned)

    def save(self, request: Save, pending: PendingRequest) -> None:
        """Write changes into the service's own file, or remove it. ControlError if there is none, or nothing to save.

        `pending` gets the file, and the settings as KEY=VALUE.
        """
        path, keys = self.overrides.saved, request.keys
        if path is None:
            raise ControlError("save: the daemon leaves it to its client: spheremouse ctl save")
        if request.forget:
            path.unlink(missing_ok=True)
            self.reload(pending)
            return
        changes = tuple(c for c in self.overrides.changes if keys is None or key_of(c) in keys)
        if fixed := sorted(set(map(key_of, changes)) & set(given(self.overrides))):
            problem = f"{', '.join(fixed)}: set on the command line, which overrides it"
            raise ControlError(problem, "start again without that option")

        def write() -> None:
            exchange.save(path, changes)
            self._call(lambda: pending.attempt(lambda: self._finish_save(path, changes, pending)))

        self._workers.submit(READING, lambda: pending.attempt(write))

    def _finish_save(self, path: Path, changes: tuple[str, ...], pending: PendingRequest) -> None:
        """Count the changes as read from the file."""
        left = tuple(change for change in self.overrides.changes if change not in changes)
        self.overrides, without_changes = replace(self.overrides, changes=left), self.plan.without_changes
        for change in changes:
            without_changes = config.override(without_changes, change, label="")
        self.plan = replace(self.plan, without_changes=without_changes, saved=latest((*self.plan.saved, *changes)))
        self._files[path] = stamps_of(self.overrides, self.plan)[path]
        text = f"{path}: saved: {', '.join(changes)}" if changes else f"{path}: nothing was set that is not in it"
        self._log(text)
        pending.answer({"file": str(path), "saved": list(changes), "message": text})

    def reload(self, pending: PendingRequest) -> None:
        """Read all files again, and drop the changes by `set` and `profile`. If a file is invalid, all stays."""
        self._load(replace(self.overrides, changes=()), pending)

    def _load(self, wanted: CommandLineOverrides, pending: PendingRequest, assigned: tuple[str, ...] = ()) -> None:
        """Read and check the configuration in another thread. Between two frames, apply it or report its error."""
        before = self.plan

        def read() -> None:
            time.sleep(max(0.0, self._read_at + _MIN_READING_INTERVAL - time.monotonic()))
            files = stamps_of(wanted, before)
            try:
                plan = self._setup.planned(read_run_config(wanted))
                check_kinds(plan, before)
                check_read(plan, assigned)
                if plan.notice not in ("", before.notice):
                    self._log(plan.notice)
            except SpheremouseError as e:
                error = str(e)
            except Exception as e:
                error = internal_error(e)
            else:
                self._call(lambda: pending.attempt(lambda: self._apply(wanted, plan, files, pending, assigned)))
                return
            finally:
                self._read_at = time.monotonic()
            self._call(lambda: pending.attempt(lambda: self._not_applied(error, files, pending)))

        self._workers.submit(READING, read)

    def _not_applied(self, error: str, files: dict[Path, int], pending: PendingRequest) -> None:
        self._files = files
        self._log(f"configuration not applied: {error}")
        pending.answer(refused(error))

    def _apply(
        self,
        wanted: CommandLineOverrides,
        plan: RunConfig,
        files: dict[Path, int],
        pending: PendingRequest,
        assigned: tuple[str, ...],
    ) -> None:
        """Apply a plan, and log the changes that need a restart."""
        if pending.cancelled:
            pending.answer(refused("given up: the client has disconnected"))
            return
        changed, exact = differences(self.plan, plan), values(self.plan, plan, assigned)
        try:
            apply = self._prepare(plan, changed)
        except SpheremouseError as e:
            self._not_applied(str(e), files, pending)
            return
        # Nothing from here on is refused.
        self.overrides, self.plan, self._files = wanted, plan, stamps_of(wanted, plan)
        for path, stamp in files.items():
            if path in self._files:
                self._files[path] = stamp  # the time of reading: a later write counts as a change
        ended = apply()
        read = [name for name in changed if name in ("rig", "map", "balls") and name not in exact]  # from their files
        changes = ", ".join(filter(None, (describe_changes(exact), *read)))
        text = f"configuration applied: {changes or 'nothing has changed'}"
        later = [name for name in changed if name in AT_START]
        if later:
            text += f" ({', '.join(later)}: from the next start on)"
        text += "; the recording has ended, since it holds one tracker configuration" if ended else ""
        if changed or not pending.quiet:
            self._log(text)
        pending.answer({"changed": changed, "values": exact, "message": text})
