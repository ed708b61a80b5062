"""Make the README's pictures: the demo's video, animated, and the live page of a simulated film. `make picture`."""

import io
import shutil
import tempfile
from pathlib import Path

import cv2
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
SHOWN = range(180, 270, 3)  # frames, of three seconds in which the ball turns fast
SIZE, COLOURS = (400, 300), 32  # less than 1 MB


PAGE_SECONDS = 11.0  # after which the plots are full
PAGE_SIZE, PAGE_QUALITY = (1280, 800), 85  # less than 150 kB


def main() -> None:
    """Write both pictures."""
    demo()
    page()


def demo() -> None:
    """Read demo/overlay.mp4, write docs/images/demo.gif."""
    film = cv2.VideoCapture(str(ROOT / "demo" / "overlay.mp4"))
    images = []
    for index in SHOWN:
        film.set(cv2.CAP_PROP_POS_FRAMES, index)
        small = cv2.resize(film.read()[1], SIZE, interpolation=cv2.INTER_AREA)
        image = Image.fromarray(cv2.cvtColor(small, cv2.COLOR_BGR2RGB))
        images.append(image.quantize(COLOURS, dither=Image.Dither.NONE))
    interval_ms = 1000 * SHOWN.step / film.get(cv2.CAP_PROP_FPS)
    images[0].save(
        IMAGES / "demo.gif", save_all=True, append_images=images[1:], duration=interval_ms, loop=0, optimize=True
    )


def page() -> None:
    """Open the live page of a service that tracks a simulated film, and write docs/images/page.webp."""
    from playwright.sync_api import sync_playwright
    from view_world import Service

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        service = Service(Path(folder))
        try:
            service.reach(state="tracking")
            browser = play.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--disable-gpu", "--no-sandbox"]
            )
            width, height = PAGE_SIZE
            shown = browser.new_page(viewport={"width": width, "height": height}, color_scheme="dark")
            shown.goto(service.owner_url)
            shown.wait_for_timeout(1000 * PAGE_SECONDS)
            image = Image.open(io.BytesIO(shown.screenshot())).convert("RGB")
        finally:
            service.close()
    image.save(IMAGES / "page.webp", quality=PAGE_QUALITY, method=6)


if __name__ == "__main__":
    main()
