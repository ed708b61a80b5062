"""The description of the runs of a table, in a JSON file beside it.

`{"schema": 1, "runs": [...]}` has one object for each opening of the table. The first row writes it, with the end null.
Closing the table completes it, so a run that was killed keeps null.
"""

import json
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from spheremouse.errors import OutputError, os_errors_as
from spheremouse.files import plain_json, safe_files
from spheremouse.output.log_file import write_error
from spheremouse.output.sample import Sample
from spheremouse.tracker import Status

_MAX_BYTES = 100_000_000


class RunRecord:
    """The description of one run, with the times at which a ball was lost."""

    def __init__(self, path: Path, description: dict[str, Any]) -> None:
        """Add a run to the file. Raise OutputError if it cannot be written, or is another file."""
        self._path, self._runs = path, _runs(path)
        self._run: dict[str, Any] = {"start": _now(), "end": None, "verdict": None, **description}
        self._runs.append(self._run)
        self._rows = self._tracked = self._missing = 0
        self._first: Sample | None = None
        self._last: Sample | None = None
        self._losses: list[dict[str, Any]] = []
        self._lost: dict[int, dict[str, Any]] = {}  # losses that have not ended, by ball
        self._write()

    def add(self, samples: Iterable[Sample]) -> None:
        """Count the samples of a frame."""
        for sample in samples:
            self._rows += 1
            self._tracked += sample.status is Status.TRACKING
            self._count_loss(sample)
            if self._last is not None:
                self._missing += max(0, int(sample.sequence) - int(self._last.sequence) - 1)
            self._first, self._last = self._first or sample, sample

    def finish(self) -> None:
        """Complete the description. Raise OutputError if it cannot be written."""
        self._run |= {
            "end": _now(),
            "verdict": self._verdict(),
            "stamps": [float(s.stamp) for s in (self._first, self._last) if s is not None],
            "rows": self._rows,
            "rows_tracked": self._tracked,
            "frames_missing": self._missing,
            "losses": self._losses,
        }
        self._write()

    def _count_loss(self, sample: Sample) -> None:
        lost, stamp = self._lost.get(sample.ball), float(sample.stamp)
        if lost is None and sample.status is Status.LOST:
            self._lost[sample.ball] = lost = {"ball": sample.ball, "start": stamp, "end": None}
            self._losses.append(lost)
        elif lost is not None and sample.status is not Status.LOST:
            lost["end"] = stamp
            del self._lost[sample.ball]

    def _verdict(self) -> str:
        end = float(self._last.stamp) if self._last is not None else 0.0
        seconds = sum((end if loss["end"] is None else loss["end"]) - loss["start"] for loss in self._losses)
        n, share = len(self._losses), 100.0 * self._tracked / max(self._rows, 1)
        lost = f"lost {n} time{'s' if n > 1 else ''}, {seconds:.2f} s in all" if n else "never lost"
        missing = f"; {self._missing} frames are missing" if self._missing else ""
        return f"{self._tracked} of {self._rows} rows tracked ({share:.1f} %), {lost}{missing}"

    def _write(self) -> None:
        text = json.dumps({"schema": 1, "runs": self._runs}, indent=1, allow_nan=False)
        with os_errors_as(OutputError, f"{self._path}: cannot be written"):
            safe_files.replace(self._path, text.encode() + b"\n")


def _runs(path: Path) -> list[dict[str, Any]]:
    """Return the runs of a file, none if it does not exist."""
    try:
        found = plain_json.loads(safe_files.read_text(path, _MAX_BYTES, "description of runs"))
        if isinstance(found, dict) and found.get("schema") == 1 and isinstance(found.get("runs"), list):
            return found["runs"]
    except FileNotFoundError:
        return []
    except OSError as e:
        raise write_error(path, e) from None
    except ValueError:
        pass
    raise OutputError(f"{path}: exists and is no description of runs", "choose another name or remove it")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
