"""Panels, fields and the picture of the live page in a browser."""

import io
import re

import numpy as np
from PIL import Image
from view_world import wait_for


def choose(page, panel):
    page.locator(f"#tab-{panel}").click()


def field(page, panel, key):
    return page.locator(f'[id="{panel}-{key}"]')


def enter(control, text):
    control.fill(text)
    control.press("Enter")


def refusal(page, panel, key):
    return page.locator(f'[id="{panel}-{key}-error"]')


def pixels(page):
    """Return the middle of the camera's picture, where the ball is, as numbers."""
    picture = np.asarray(Image.open(io.BytesIO(page.locator("#picture").screenshot())).convert("L"), dtype=float)
    rows, columns = picture.shape
    return picture[rows // 4 : -rows // 4, columns // 3 : -columns // 3]


def drag(page, *places):
    """Press the mouse at the first place, move it to the others, and release it."""
    (x, y), *others = places
    page.mouse.move(x, y)
    page.mouse.down()
    for place in others:
        page.mouse.move(*place, steps=4)
    page.mouse.up()


def middle(locator):
    box = locator.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def begin_drawing(page):
    """Open the panel Draw, and wait until the rectangles of the test before are gone from it."""
    choose(page, "Draw")
    wait_for("no rectangle", lambda: page.locator(".masks li").count() == 0)


def masks(service):
    """Return the numbers of all places without discs."""
    return [float(n) for n in re.findall(r"-?[\d.]+", value(service, "discs.masks") or "")]


def value(service, key):
    """Return a setting as the daemon reports it."""
    changes = dict(change.split("=", 1) for change in service.status()["changes"])
    return changes.get(key)
