"""Write dataset folders whole or not at all: of simulations with truth, of a camera without."""

import csv
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spheremouse.ball.rig import Rig
from spheremouse.ball.truth import DiscTruth
from spheremouse.errors import DatasetError, SpheremouseError, os_errors_as
from spheremouse.files.dataset.format import DISC_COLUMNS, FILES, STAMP_COLUMNS, TRUTH_COLUMNS, camera_description
from spheremouse.files.dataset.pictures import FAST_CODECS, PictureWriter
from spheremouse.files.safe_files import NewFolder
from spheremouse.geometry.rotation import Array, to_euler
from spheremouse.tracker import Frame

CENTRE_COLUMNS = ("bx", "by", "bz")  # of truth.csv, where the ball leaves its place


@contextmanager
def new_folder(path: Path, check: Callable[[Path], None], error: type[SpheremouseError]) -> Iterator[Path]:
    """Make a hidden folder beside `path`, which takes its name at the end, or is removed after an exception or a kill.

    `check` raises `error` if `path` may not be replaced. It is called at both ends: another process may have made it.
    """
    check(path)
    new = NewFolder(path, error)
    try:
        new.make().chmod(0o755)
        yield new.path
        check(path)
        new.finish()
    except OSError as e:
        raise error(f"{path}: cannot be written ({e.strerror})") from None
    finally:
        new.discard()


class DatasetFolder(NamedTuple):
    """A dataset that is being written. Add each image to `pictures`, and a row to each table."""

    path: Path
    pictures: PictureWriter
    files: ExitStack

    def table(self, name: str, columns: Sequence[str]) -> Any:
        """Return a writer of the rows of a table."""
        return _begin_table(self.files, self.path / name, columns)


@contextmanager
def dataset_folder(path: Path | str, scene: Mapping[str, Any], *, replace: bool = False) -> Iterator[DatasetFolder]:
    """Write a dataset, none after an exception. `scene`: scene.json without `frames`; `replace` another dataset."""
    path = Path(path).absolute()
    size = int(scene["width"]), int(scene["height"])
    with new_folder(path, partial(refuse_to_overwrite, replace=replace), DatasetError) as folder, ExitStack() as files:
        pictures = PictureWriter(folder, size, float(scene["fps"]))
        try:
            yield DatasetFolder(folder, pictures, files)
            _finish_pictures(pictures, path)
            _write_scene(folder, {**scene, "frames": pictures.written})
        finally:
            pictures.release()


class TruthWriter:
    """Writes frames of the ball in its frame, with their truth, into a dataset."""

    def __init__(self, dataset: DatasetFolder, *, centres: bool = False, discs: bool = True) -> None:
        """`centres`: write the ball's centre, which moves; `discs`: the ball has some."""
        self._pictures, self._centres = dataset.pictures, centres
        self._truth = dataset.table("truth.csv", (*TRUTH_COLUMNS, *(CENTRE_COLUMNS if centres else ())))
        self._discs = dataset.table("discs.csv", DISC_COLUMNS) if discs else None

    def add(self, frame: Frame, attitude: Array, rate: Array, discs: DiscTruth, centre: Array | None = None) -> None:
        """Add a frame with R_obj_ball (3, 3), w_obj (3,) rad/s and the rows of its discs (their `frame` is not used).

        `centre`: (3,) m in obj, of the ball, where `centres` are written.
        """
        index = self._pictures.written
        self._pictures.add(frame.image)
        numbers = [frame.stamp, *attitude.ravel(), *rate, *to_euler(attitude)]
        if self._centres:
            numbers += [0.0, 0.0, 0.0] if centre is None else list(centre)
        self._truth.writerow([index, *(repr(float(x)) for x in numbers)])
        for k in range(len(discs)):
            assert self._discs is not None
            centre_px = (f"{x:.4f}" for x in discs.centre[k])
            blob = ("" if np.isnan(x) else f"{x:.4f}" for x in (*discs.blob_centre[k], discs.area[k]))
            self._discs.writerow([index, int(discs.disc[k]), *centre_px, *blob, int(discs.state[k])])


class FilmWriter:
    """Writes frames of a live camera, bit for bit, without truth; `finish` gives the dataset its name."""

    def __init__(self, path: Path, size: tuple[int, int]) -> None:
        """Make a hidden folder, which `finish` renames to `path`. `open` must follow before the first frame.

        `size` is (width, height) px. Raises DatasetError if `path` has files, or cannot be written.
        """
        self._path, self._size = path.absolute(), size
        self._stamps: list[float] = []
        self._pictures: PictureWriter | None = None
        self._files = ExitStack()
        refuse_to_overwrite(self._path, replace=False)
        self._new = NewFolder(self._path, DatasetError)
        try:
            self.folder = self._new.make()
        except BaseException:
            self._new.discard()
            raise

    def open(self, fps: float) -> None:
        """Choose the codec, which takes some tenths of a second; `fps`: of the video in a player."""
        self._pictures = PictureWriter(self.folder, self._size, fps, FAST_CODECS, mixed=True)
        self._rows = _begin_table(self._files, self.folder / "stamps.csv", STAMP_COLUMNS)

    def add(self, frame: Frame) -> None:
        assert self._pictures is not None
        stamp, colour = float(frame.stamp), int(frame.image.ndim == 3)
        self._rows.writerow([self._pictures.written, repr(stamp), int(frame.sequence), colour])
        self._pictures.add(frame.image)
        self._stamps.append(stamp)

    @property
    def frames(self) -> int:
        return len(self._stamps)

    def size(self) -> int:
        """Bytes on the disk so far."""
        return 0 if self._pictures is None else self._pictures.size() + (self.folder / "stamps.csv").stat().st_size

    def finish(self, scene: Mapping[str, Any], files: Mapping[str, str]) -> None:
        """Give the dataset its name, once all is on the disk; DatasetError if that fails.

        `scene`: the content of scene.json but for name, rate and number of frames; `files`: further files of a
        dataset, name and text.
        """
        assert self._pictures is not None
        with os_errors_as(DatasetError, f"{self._path}: cannot be written"):
            self._files.close()
            _finish_pictures(self._pictures, self._path)
            for name, text in files.items():
                (self.folder / name).write_text(text, encoding="utf-8")
            content = {"name": self._path.name, **scene, "fps": _rate(self._stamps), "frames": self.frames}
            _write_scene(self.folder, content)
            for file in [*self.folder.rglob("*"), self.folder]:
                _sync(file)
            self.folder.chmod(0o750)  # it may show people
            refuse_to_overwrite(self._path, replace=False)
            self._new.finish()
            _sync(self._path.parent)

    def discard(self) -> None:
        """Remove the dataset, unless it has its name."""
        if self._pictures is not None:
            self._pictures.release()
            self._files.close()
        self._new.discard()


def _finish_pictures(pictures: PictureWriter, path: Path) -> None:
    if pictures.written == 0:
        raise DatasetError(f"{path}: nothing to write, the recording would have no frame")
    try:
        pictures.close()
    except DatasetError as e:
        raise DatasetError(f"{path}: {str(e).partition(': ')[2]}") from None


def _write_scene(folder: Path, scene: Mapping[str, Any]) -> None:
    (folder / "scene.json").write_text(json.dumps(scene, indent=1) + "\n", encoding="utf-8")


def _begin_table(files: ExitStack, path: Path, columns: Sequence[str]) -> Any:
    rows = csv.writer(files.enter_context(path.open("w", newline="", encoding="utf-8")), lineterminator="\n")
    rows.writerow(columns)
    return rows


def refuse_to_overwrite(
    path: Path,
    *,
    replace: bool,
    parts: Sequence[str] = FILES,
    what: str = "a dataset",
    error: type[SpheremouseError] = DatasetError,
) -> None:
    """Raise `error` if `path` is a file, has files other than the `parts`, or has any and you may not `replace` them.

    An empty folder passes. `what` names the whole in messages.
    """
    if not path.exists():
        return
    if not path.is_dir():
        raise error(f"{path}: is a file; name a folder to write to")
    content = {p.name for p in path.iterdir()}
    if odd := sorted(content - set(parts)):  # first, since --force does not replace these
        raise error(f"{path}: holds {odd[0]}, which is no part of {what}; it will not be replaced, name another folder")
    if content and not replace:
        raise error(f"{path}: is not empty; name another folder or use --force to replace it")


def _rate(stamps: list[float]) -> float:
    """Return frames per second from the median step of the stamps; 30 if there is none."""
    steps = np.diff(stamps)
    steps = steps[np.isfinite(steps) & (steps > 0.0)]
    return float(1.0 / np.median(steps)) if len(steps) else 30.0


def _sync(path: Path) -> None:
    """Flush the files to the disk, if the system allows it."""
    with suppress(OSError):  # some systems cannot open folders
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def device_description(rig: Rig) -> dict[str, Any]:
    """Return the entry of a device in scene.json, without covariances."""
    camera, targets = rig.camera, rig.targets
    description: dict[str, Any] = {
        "width": int(camera.width),
        "height": int(camera.height),
        "exposure_s": float(rig.exposure_s),
        "camera": camera_description(camera),
        "ball": {"radius": float(rig.ball.radius)},
        "targets": [
            {"id": int(i), "code": code, "position": position.tolist()}
            for i, code, position in zip(targets.ids, targets.codes, targets.position, strict=True)
        ],
    }
    if rig.disc_radius is not None:
        description["disc_radius"] = float(rig.disc_radius)
    if np.any(targets.radii):
        description["target_radii"] = targets.radii.tolist()
    if rig.readout_sigma_s == 0.0:
        description["readout_s"] = float(rig.readout_s)
    return description
