"""What the worker does between two frames: what other threads leave to it, and what is asked at the desk."""

import traceback
from collections import deque
from collections.abc import Callable
from functools import partial

from spheremouse.errors import SpheremouseError
from spheremouse.session.control.request_queue import Asked, RequestQueue


class CallQueue:
    """They wait for the worker's next turn, whom they wake. No error of one ends the run."""

    def __init__(self, wake: Callable[[], None], say: Callable[[str], None]) -> None:
        """`say` takes lines for the log."""
        self._wake, self._say = wake, say
        self._todo: deque[Callable[[], None]] = deque()
        self._desk = RequestQueue(wake)

    def ask(self, action: Callable[[], None]) -> None:
        """Have it done; from any thread, and from a signal's handler."""
        self._todo.append(action)
        self._wake()

    def put(self, asked: Asked) -> None:
        """Have it answered; from any thread."""
        self._desk.put(asked)

    def do_all(self, answer: Callable[[Asked], None]) -> None:
        """In the worker's thread; `answer` sees to it that a request is answered, then or later."""
        while self._todo:
            self._do(self._todo.popleft())
        while (asked := self._desk.take()) is not None:
            self._do(partial(asked.attempt, partial(answer, asked)))

    def do_now(self, asked: Asked, answer: Callable[[Asked], None]) -> None:
        """In the worker's thread; not where one of its kind is under way."""
        if self._desk.begin(asked):
            asked.attempt(partial(answer, asked))

    def _do(self, action: Callable[[], None]) -> None:
        try:
            action()
        except SpheremouseError as e:
            self._say(str(e))
        except Exception:
            self._say("internal error, please report it:\n" + traceback.format_exc().rstrip())
