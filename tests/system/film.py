"""What the guest needs and is too slow to make: films for a camera. Run by tests/system/run.

    python tests/system/film.py OUT [--short]

Each film is a folder in OUT: `YUYV` (pictures one behind the other), `attitude.npy` (n, 3, 3) R_obj_ball, `rig.yaml`.
"""

import subprocess
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from spheremouse.ball.settings import LossSettings, Settings
from spheremouse.files.dataset.ball import open_dataset
from spheremouse.files.dataset.frames import read_frames
from spheremouse.files.rig import rig_text

# The pictures come six times as slowly as those of a usual camera: so the tracker waits six times as long.
SLOW = Settings(loss=LossSettings(lost_after=1.8, reset_after=6.0))


def convert(dataset: Path, folder: Path) -> None:
    """A dataset's frames as a film, but for those before the ball begins to turn."""
    recording = open_dataset(dataset)
    assert recording.truth is not None
    folder.mkdir()
    rate = np.linalg.norm(recording.truth.rate, axis=1)
    first = max(0, int(np.argmax(rate > 0.0)) - 2)
    with (folder / "YUYV").open("wb") as file:
        for frame in islice(read_frames(recording), first, None):
            file.write(cv2.cvtColor(frame.image, cv2.COLOR_BGR2YUV_YUY2).tobytes())
    np.save(folder / "attitude.npy", recording.truth.attitude[first:])
    (folder / "rig.yaml").write_text(rig_text(replace(recording.rig, pose=None)), encoding="utf-8")


def main() -> None:
    """The film of the ball; without --short a longer one."""
    out, short = Path(sys.argv[1]), "--short" in sys.argv
    seconds, fps = (3, 16) if short else (4, 30)
    words = f"simulate {out / 'dataset'} --motion play --seed 7 --seconds {seconds} --fps {fps} --noise 2"
    subprocess.run([sys.executable, "-m", "spheremouse", *words.split()], check=True, stdout=subprocess.DEVNULL)
    convert(out / "dataset", out / "play")


if __name__ == "__main__":
    main()
