"""Make the README's animated picture from the video of the demo: `make picture`."""

from pathlib import Path

import cv2
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
SHOWN = range(180, 270, 3)  # frames, of three seconds in which the ball turns fast
SIZE, COLOURS = (400, 300), 32  # less than 1 MB


def main() -> None:
    """Read demo/overlay.mp4, write docs/images/demo.gif."""
    film = cv2.VideoCapture(str(ROOT / "demo" / "overlay.mp4"))
    images = []
    for index in SHOWN:
        film.set(cv2.CAP_PROP_POS_FRAMES, index)
        small = cv2.resize(film.read()[1], SIZE, interpolation=cv2.INTER_AREA)
        image = Image.fromarray(cv2.cvtColor(small, cv2.COLOR_BGR2RGB))
        images.append(image.quantize(COLOURS, dither=Image.Dither.NONE))
    interval_ms = 1000 * SHOWN.step / film.get(cv2.CAP_PROP_FPS)
    target = ROOT / "docs" / "images" / "demo.gif"
    images[0].save(target, save_all=True, append_images=images[1:], duration=interval_ms, loop=0, optimize=True)


if __name__ == "__main__":
    main()
