"""`dataset:DIR`: a recording with its description (docs/datasets.md). Only the stamps of its truth are read."""

from pathlib import Path

from spheremouse.capture import Stream, pace
from spheremouse.capture.nodes import probe_path
from spheremouse.errors import SourceError
from spheremouse.files.dataset.ball import open_frames
from spheremouse.files.dataset.frames import read_frames
from spheremouse.finding import Finding


def open(argument: str, realtime: bool) -> Stream:
    """Open the frames of a dataset, and its rig. Raise SourceError without a folder, DatasetError if it is invalid."""
    if not argument:
        raise SourceError("dataset: needs a folder; write dataset:DIR")
    recording = open_frames(Path(argument))
    frames = read_frames(recording)
    return Stream(pace(frames) if realtime else frames, rig=recording.rig, fps=recording.fps, count=recording.frames)


def probe(argument: str) -> list[Finding]:
    return [probe_path(Path(argument))]
