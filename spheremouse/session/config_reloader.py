"""Read a new configuration in a thread of the pool, and apply it between two frames or refuse it as a whole.

A new one is read if one of its files has changed, and on `set` and `reload`. Only the worker calls the methods. Other
threads may read the attributes.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from spheremouse.errors import SpheremouseError
from spheremouse.session.changes import (
    AT_START,
    check_read,
    check_settable,
    differences,
    latest,
    stages_of,
    stamps_of,
    told,
    values,
)
from spheremouse.session.control.protocol import internal_error, refused
from spheremouse.session.control.request_queue import PendingRequest
from spheremouse.session.follower import Setup
from spheremouse.session.plan import Plan, Request, check_kinds, read_plan
from spheremouse.session.process.threads import WorkerPool

READING = "reading"  # kind of the crew's work

Prepare = Callable[[Plan, list[str]], Callable[[], bool]]


class ConfigReloader:
    """The request and the plan of a run."""

    def __init__(
        self,
        request: Request,
        plan: Plan,
        setup: Setup,
        prepare: Prepare,
        *,
        crew: WorkerPool,
        ask: Callable[[Callable[[], None]], None],
        say: Callable[[str], None],
    ) -> None:
        """`prepare` takes a plan and the changed sections. It raises SpheremouseError to refuse the plan, or returns
        a function that applies it and returns True if that has ended a recording. `ask` runs a call in the worker.
        """
        self.request, self.plan, self._setup, self._prepare = request, plan, setup, prepare
        self._crew, self._ask, self._say = crew, ask, say
        self._files = stamps_of(request, plan)

    @property
    def outdated(self) -> bool:
        """Return True if a file has been written since it was read."""
        return self._files != stamps_of(self.request, self.plan)

    def set(self, assignments: tuple[str, ...], pending: PendingRequest) -> None:
        """Change parameters, KEY=VALUE. ControlError if one could not take effect."""
        check_settable(self.request, assignments)
        wanted = replace(self.request, changes=latest((*self.request.changes, *assignments)))
        self._load(wanted, pending, assignments)

    def reload(self, pending: PendingRequest) -> None:
        """Read all files again, and drop the values of `set`."""
        self._load(replace(self.request, changes=()), pending)

    def _load(self, wanted: Request, pending: PendingRequest, assigned: tuple[str, ...] = ()) -> None:
        before = self.plan

        def read() -> None:
            files = stamps_of(wanted, before)
            try:
                plan = self._setup.planned(wanted, read_plan(wanted))
                check_kinds(plan, before)
                check_read(plan, assigned)
                if stages_of(plan) != stages_of(before):
                    self._setup.make_ready(plan)  # no frame may wait for the compiler
            except SpheremouseError as e:
                error = str(e)
            except Exception as e:
                error = internal_error(e)
            else:
                self._ask(lambda: pending.attempt(lambda: self._apply(wanted, plan, files, pending, assigned)))
                return
            self._ask(lambda: pending.attempt(lambda: self._not_applied(error, files, pending)))

        self._crew.do(READING, read)

    def _not_applied(self, error: str, files: dict[Path, int], pending: PendingRequest) -> None:
        self._files = files
        self._say(f"configuration not applied: {error}")
        pending.answer(refused(error))

    def _apply(
        self, wanted: Request, plan: Plan, files: dict[Path, int], pending: PendingRequest, assigned: tuple[str, ...]
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
        self.request, self.plan, self._files = wanted, plan, stamps_of(wanted, plan)
        for path, stamp in files.items():
            if path in self._files:
                self._files[path] = stamp  # the time of reading: a later write counts as a change
        ended = apply()
        read = [name for name in changed if name in ("rig", "map", "balls") and name not in exact]  # from their files
        text = f"configuration applied: {', '.join(filter(None, (told(exact), *read))) or 'nothing has changed'}"
        later = [name for name in changed if name in AT_START]
        if later:
            text += f" ({', '.join(later)}: from the next start on)"
        text += "; the recording has ended, for it is of one configuration" if ended else ""
        if changed or not pending.quiet:
            self._say(text)
        pending.answer({"changed": changed, "values": exact, "message": text})
