"""Writes dataset folders: all of one or nothing.

Frames go into a lossless video where OpenCV gives them back bit for bit, into PNG files otherwise.
"""

import csv
import json
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np

from spheremouse.dataset_format import DISC_COLUMNS, FILES, TRUTH_COLUMNS, video_images
from spheremouse.errors import DatasetError
from spheremouse.folders import begin_folder, finish_folder
from spheremouse.frame import Frame
from spheremouse.rotation import Array, to_euler
from spheremouse.simulate import Change, Simulation, simulate
from spheremouse.simulate.truth import DiscTruth

CENTRE_COLUMNS = ("bx", "by", "bz")  # of truth.csv, where the ball leaves its place

_CODECS = ("FFV1", "HFYU")  # in this order: smaller first


@cache
def _lossless_codec(width: int, height: int, folder: Path) -> str | None:
    """The first codec that OpenCV writes and reads back bit for bit at that size, tried on noise; None: PNG files."""
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (2, height, width, 3), dtype=np.uint8)
    for codec in _CODECS:
        path = folder / "trial.mkv"
        video = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), 30.0, (width, height))
        if video.isOpened():
            for image in images:
                video.write(image)
            video.release()
            back = list(video_images(path))
            path.unlink(missing_ok=True)
            if len(back) == len(images) and all(np.array_equal(a, b) for a, b in zip(images, back, strict=True)):
                return codec
    return None


class DatasetWriter:
    """Writes a dataset folder: all of it or, after an exception or a kill, nothing.

    Everything goes to a temporary folder beside `path` that takes its name at the end.
    """

    def __init__(
        self, path: Path | str, scene: dict[str, Any], *, replace: bool = False, centres: bool = False
    ) -> None:
        """`scene`: the content of scene.json without `frames`. A non-empty `path` is refused unless `replace`,
        and even then replaced only if all it holds is a dataset. `centres`: the ball's centre moves and is written."""
        self._path = Path(path).absolute()
        self._scene = scene
        self._replace = replace
        self._centres = centres
        self._size = (int(scene["width"]), int(scene["height"]))
        self._frames = 0
        self._video: cv2.VideoWriter | None = None

    def __enter__(self) -> Self:
        self._refuse_to_overwrite()
        self._folder = begin_folder(self._path, DatasetError)
        try:
            self._folder.chmod(0o755)
            codec = _lossless_codec(*self._size, self._folder)
            if codec is None:
                (self._folder / "frames").mkdir()
            else:
                self._video = cv2.VideoWriter(
                    str(self._folder / "video.mkv"),
                    cv2.CAP_FFMPEG,
                    cv2.VideoWriter.fourcc(*codec),
                    float(self._scene["fps"]),
                    self._size,
                )
            self._truth_file = (self._folder / "truth.csv").open("w", newline="", encoding="utf-8")
            self._discs_file = (self._folder / "discs.csv").open("w", newline="", encoding="utf-8")
            self._truth_rows = csv.writer(self._truth_file, lineterminator="\n")
            self._disc_rows = csv.writer(self._discs_file, lineterminator="\n")
            self._truth_rows.writerow((*TRUTH_COLUMNS, *CENTRE_COLUMNS) if self._centres else TRUTH_COLUMNS)
            self._disc_rows.writerow(DISC_COLUMNS)
        except BaseException:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise
        return self

    def add(self, frame: Frame, attitude: Array, rate: Array, discs: DiscTruth, centre: Array | None = None) -> None:
        """One frame with R_obj_ball (3, 3), w_obj (3,) rad/s and the rows of its discs (their `frame` is not used).

        `centre`: (3,) m in obj, of the ball, where `centres` are written.
        """
        assert frame.image.shape == (self._size[1], self._size[0], 3)
        index = self._frames
        if self._video is not None:
            self._video.write(frame.image)
        elif not cv2.imwrite(str(self._folder / "frames" / f"{index:06d}.png"), frame.image):
            raise DatasetError(f"{self._path}: frame {index} could not be written; is the disk full?")
        numbers = [frame.stamp, *attitude.ravel(), *rate, *to_euler(attitude)]
        if self._centres:
            numbers += [0.0, 0.0, 0.0] if centre is None else list(centre)
        self._truth_rows.writerow([index, *(repr(float(x)) for x in numbers)])
        for k in range(len(discs)):
            blob = (*discs.blob_centre[k], discs.area[k])
            self._disc_rows.writerow(
                [
                    index,
                    int(discs.disc[k]),
                    *(f"{x:.4f}" for x in discs.centre[k]),
                    *("" if np.isnan(x) else f"{x:.4f}" for x in blob),
                    int(discs.state[k]),
                ]
            )
        self._frames += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._close()
            if kind is None:
                self._publish()
        except OSError as e:
            raise DatasetError(f"{self._path}: cannot be written ({e.strerror})") from None
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _close(self) -> None:
        if self._video is not None:
            self._video.release()
        self._truth_file.close()
        self._discs_file.close()

    def _publish(self) -> None:
        if self._frames == 0:
            raise DatasetError(f"{self._path}: nothing to write, the recording would have no frame")
        if self._video is not None:
            written = cv2.VideoCapture(str(self._folder / "video.mkv"), cv2.CAP_FFMPEG)
            count = round(written.get(cv2.CAP_PROP_FRAME_COUNT)) if written.isOpened() else 0
            written.release()
            if count != self._frames:  # OpenCV's writer reports no errors
                raise DatasetError(f"{self._path}: the video could not be written; is the disk full?")
        (self._folder / "scene.json").write_text(
            json.dumps({**self._scene, "frames": self._frames}, indent=1) + "\n", encoding="utf-8"
        )
        self._refuse_to_overwrite()  # once more: somebody may have come first
        finish_folder(self._folder, self._path)

    def _refuse_to_overwrite(self) -> None:
        if not self._path.exists():
            return
        if not self._path.is_dir():
            raise DatasetError(f"{self._path}: is a file; name a folder to write to")
        content = {p.name for p in self._path.iterdir()}
        if content and not self._replace:
            raise DatasetError(f"{self._path}: is not empty; name another folder or use --force to replace it")
        if content - set(FILES):
            odd = sorted(content - set(FILES))[0]
            raise DatasetError(f"{self._path}: holds {odd}, which is no part of a dataset; it will not be replaced")


def scene_description(simulation: Simulation, name: str) -> dict[str, Any]:
    """The content of scene.json, but for `frames`; the truth under keys that begin with `truth_`."""
    scene, camera = simulation.scene, simulation.scene.camera
    description: dict[str, Any] = {
        "name": name,
        "made_by": "spheremouse simulate",
        "width": camera.width,
        "height": camera.height,
        "fps": simulation.fps,
        "exposure_s": scene.exposure_s,
        "camera": {
            "fx": camera.fx,
            "fy": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            "dist": camera.distortion.tolist(),
        },
        "ball": {"radius": scene.ball_radius},
        "disc_radius": scene.disc_radius,
        "targets": [
            {"id": i, "code": code, "position": position.tolist()}
            for i, code, position in zip(scene.targets.ids, scene.targets.codes, scene.targets.position, strict=True)
        ],
        "target_radii": scene.targets.radii.tolist(),
        "readout_s": scene.readout_s,
        "truth_T_obj_cam": scene.pose.matrix().tolist(),
        "truth_disc_directions": scene.disc_directions.tolist(),
    }
    if simulation.changes:
        description["truth_changes"] = [_change(change) for change in simulation.changes]
        bumps = [change for change in simulation.changes if change.what == "bump"]
        if bumps:
            description["truth_bump"] = {"t": bumps[0].time, "T_obj_cam": bumps[0].scene.pose.matrix().tolist()}
    return description


def _change(change: Change) -> dict[str, Any]:
    said: dict[str, Any] = {"t": change.time, "what": change.what}
    if change.disc is not None:
        said["disc"] = change.disc
    if change.what == "disc moved":
        said["direction"] = change.scene.disc_directions[change.disc].tolist()
    return said


def write_simulation(path: Path | str, simulation: Simulation, *, replace: bool = False) -> Iterator[int]:
    """Film a simulation into a dataset folder, giving the number of frames done after each; complete at the end.

    Raises DatasetError as DatasetWriter does. An iterator that is closed early writes nothing.
    """
    description, centres = scene_description(simulation, Path(path).absolute().name), simulation.options.reach > 0.0
    with DatasetWriter(path, description, replace=replace, centres=centres) as writer:
        for done, filmed in enumerate(simulate(simulation), start=1):
            writer.add(filmed.frame, filmed.attitude, filmed.rate, filmed.discs, filmed.centre)
            yield done
