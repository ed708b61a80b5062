"""Make the README's animated picture from the video of the demo: `make picture`."""

from pathlib import Path

import cv2
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
BEGIN, STEP, COUNT = 180, 2, 45  # every second frame of three seconds in which the ball turns fast
SIZE, COLOURS = (480, 360), 48


def main() -> None:
    """Read demo/overlay.mp4, write docs/images/demo.gif."""
    film = cv2.VideoCapture(str(ROOT / "demo" / "overlay.mp4"))
    film.set(cv2.CAP_PROP_POS_FRAMES, BEGIN)
    interval_ms = 1000 * STEP / film.get(cv2.CAP_PROP_FPS)
    frames = []
    while len(frames) < STEP * COUNT and (read := film.read())[0]:
        frames.append(cv2.cvtColor(cv2.resize(read[1], SIZE, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2RGB))
    first, *rest = (Image.fromarray(f).quantize(COLOURS, dither=Image.Dither.NONE) for f in frames[::STEP])
    target = ROOT / "docs" / "images" / "demo.gif"
    first.save(target, save_all=True, append_images=rest, duration=interval_ms, loop=0, optimize=True)


if __name__ == "__main__":
    main()
