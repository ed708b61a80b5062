"""What the evening's simulated camera shows, as films for `evening_camera.py`: one cabinet, one camera, five scenes.

    python evening_films.py OUT

OUT/board, device, axes, play (YUYV pictures one behind the other), OUT/ball (the first of axes), OUT/device.yaml (what
a person measured with a tape), OUT/truth.json (that of `calibrate practice`) and OUT/attitude.npy, R_obj_ball of play.
"""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
from film import convert

SIZE, SEED = "1280x720", 3
FPS = {"axes": 8, "play": 30}  # shown more slowly: a guest takes up to a third of a second for a picture


def main() -> None:
    """Simulate, and write."""
    out = Path(sys.argv[1])
    out.mkdir()
    for motion in ("axes", "play"):
        seconds = () if motion == "axes" else ("--seconds", 5)
        spheremouse(
            "simulate", out / f"{motion}_dataset", "--motion", motion, *seconds, "--fps", FPS[motion], "--noise", 2
        )
        convert(out / f"{motion}_dataset", out / f"{motion}_film")
        (out / f"{motion}_film" / "YUYV").rename(out / motion)
    camera = json.loads((out / "axes_dataset" / "scene.json").read_text())["camera"]
    lens = ("--focal", camera["fx"], "--dist", ",".join(map(str, camera["dist"])))
    spheremouse(
        "calibrate", "practice", out / "practice", "--like", out / "axes_dataset", "--photos", 14, "--boards", 30,
        "--no-film", *lens
    )  # fmt: skip
    for part in ("board", "device"):
        with (out / part).open("wb") as film:
            for path in sorted((out / "practice" / part).glob("*.jpg")):
                image = cv2.imread(str(path))
                assert image is not None
                film.write(cv2.cvtColor(image, cv2.COLOR_BGR2YUV_YUY2).tobytes())
    width, height = map(int, SIZE.split("x"))
    (out / "ball").write_bytes(np.fromfile(out / "axes", np.uint8, 2 * width * height).tobytes())
    np.save(out / "attitude.npy", np.load(out / "play_film" / "attitude.npy"))
    for name in ("device.yaml", "truth.json"):
        (out / "practice" / name).rename(out / name)


def spheremouse(*arguments: object) -> None:
    """One command, of which a simulation takes the size and the seed."""
    words = [*map(str, arguments), "--size", SIZE, "--seed", str(SEED)]
    subprocess.run([sys.executable, "-m", "spheremouse", *words], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main()
