"""Folders that are there whole or not at all, whatever interrupts the program."""

import os
import signal
import sys
from contextlib import contextmanager

import pytest

from spheremouse.errors import DatasetError
from spheremouse.files import safe_files
from spheremouse.files.safe_files import NewFolder
from spheremouse.session.overlay.file import OverlayFile
from spheremouse.simulate.ball.film import prepare
from spheremouse.simulate.ball.options import SimulationOptions
from spheremouse.simulate.to_dataset import write_simulation, write_wand
from spheremouse.simulate.wand.film import prepare_wand
from spheremouse.simulate.wand.options import WandOptions


@contextmanager
def interrupted_at(step, within):
    """Raise SystemExit before instruction `step` of the module's functions `within`; yields whether it came."""
    left, done = [step], []

    def trace(frame, event, _):
        if frame.f_code.co_filename != safe_files.__file__ or frame.f_code.co_name not in within:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            if left[0] == 0:
                sys.settrace(None)
                done.append(True)
                raise SystemExit
            left[0] -= 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield done
    except SystemExit:
        pass
    finally:
        sys.settrace(before)


def test_a_folder_that_is_interrupted_at_any_step_of_its_making_is_removed(tmp_path):
    for step in range(1000):
        with interrupted_at(step, ("make",)) as done:
            new = NewFolder(tmp_path / "new", DatasetError)
            try:
                new.make()
            finally:
                new.discard()
        assert list(tmp_path.iterdir()) == [], step
        if not done:
            break
    assert 20 < step < 1000


def test_a_folder_that_is_interrupted_while_it_replaces_another_leaves_one_of_them_whole(tmp_path):
    place, content = tmp_path / "film", []
    for step in range(1000):
        place.mkdir(exist_ok=True)
        (place / "which").write_text("old")
        with interrupted_at(step, ("finish",)) as done:
            new = NewFolder(place, DatasetError)
            try:
                (new.make() / "which").write_text("new")
                new.finish()
            finally:
                new.discard()
        assert list(tmp_path.iterdir()) == [place], step
        content.append((place / "which").read_text())
        if not done:
            break
    assert step < 1000
    assert sorted(content, reverse=True) == content  # old up to some step, new from there on
    assert set(content) == {"old", "new"}


@contextmanager
def sigterm_as_the_folder_is_made(parent):
    """SIGTERM arrives as soon as there is a hidden folder in `parent`; the program unwinds, as `main` has it."""

    def profile(_, event, called):
        if event == "c_return" and called is os.mkdir and any(p.name.startswith(".") for p in parent.iterdir()):
            sys.setprofile(None)
            os.kill(os.getpid(), signal.SIGTERM)

    before = signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    sys.setprofile(profile)
    try:
        with pytest.raises(SystemExit):
            yield
    finally:
        sys.setprofile(None)
        signal.signal(signal.SIGTERM, before)


def simulated(path):
    list(write_simulation(path, prepare(SimulationOptions(seconds=0.1))))


def simulated_wand(path):
    list(write_wand(path, prepare_wand(WandOptions(seconds=0.1))))


def overlaid(path):
    with OverlayFile(path.with_suffix(".mp4"), 30.0):
        pass


@pytest.mark.parametrize("write", [simulated, simulated_wand, overlaid])
def test_sigterm_at_the_moment_at_which_the_hidden_folder_is_made_leaves_nothing(tmp_path, write):
    with sigterm_as_the_folder_is_made(tmp_path):
        write(tmp_path / "film")
    assert list(tmp_path.iterdir()) == []
