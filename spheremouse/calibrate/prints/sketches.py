"""The drawings of the capture recipe: board in the picture, targets on the frame, places of the camera. SVG as text."""

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from spheremouse.calibrate.prints.sheets import TARGETS
from spheremouse.files.report import svg
from spheremouse.files.report.style import BLUE
from spheremouse.geometry.rotation import Array, exp

_INK = {"C": "#00ffff", "M": "#ff00ff", "Y": "#ffff00"}
_RINGS = (12.0, 24.0, 36.0)  # mm

# Where discs are on the drawn ball, of its radius.
_DISCS = (
    (-0.08, -0.62), (0.46, -0.55), (-0.58, -0.52), (0.17, -0.2), (-0.36, -0.08), (0.63, -0.05), (-0.82, 0.12),
    (-0.05, 0.28), (0.42, 0.4), (-0.5, 0.5), (0.1, 0.72), (0.84, 0.3), (0.02, -0.9),
)  # fmt: skip

# Title, tilt about the picture's x and y in degrees, turn in its plane, and where the board's centre is in the picture
# (of its half width and height), at which distance (board widths).
_VIEWS = (
    ("straight, near", 0, 0, 0, 0.0, 0.0, 1.55),
    ("tilted to the left", 0, -40, 0, 0.0, 0.0, 1.7),
    ("tilted to the right", 0, 40, 0, 0.0, 0.0, 1.7),
    ("tilted back", -40, 0, 0, 0.0, 0.0, 1.5),
    ("tilted forward", 40, 0, 0, 0.0, 0.0, 1.5),
    ("upper left corner", 15, 30, 5, -0.5, -0.29, 2.3),
    ("upper right corner", 15, -30, -5, 0.5, -0.29, 2.3),
    ("lower left corner", -15, 30, 0, -0.5, 0.29, 2.3),
    ("lower right corner", -15, -30, 0, 0.5, 0.29, 2.3),
    ("turned by 90 degrees", 0, 30, 90, 0.0, 0.0, 2.1),
)


def sketches() -> dict[str, Markup]:
    """SVG text by name, as the recipe's comments `<!-- sketch: NAME -->` call for them."""
    return {
        "board": svg.drawing(
            900, 268, "Ten photos of the board: straight, tilted four ways, in four corners, turned", _views()
        ),
        "frame": svg.drawing(
            840, 470, "The frame from the front: a target at each corner, and the distances between them", _front()
        ),
        "device": svg.drawing(900, 360, "Where to stand, from above and from the side", _places()),
    }


def _line(a: Array | tuple[float, float], b: Array | tuple[float, float], **look: str | float) -> Markup:
    return svg.element("line", x1=a[0], y1=a[1], x2=b[0], y2=b[1], **look)


def _text(x: float, y: float, text: str, size: float, anchor: str = "start", **look: str) -> Markup:
    return svg.element("text", text, x=x, y=y, font_size=size, text_anchor=anchor, **look)


# ---- the board in the picture ----


def _views() -> Iterator[Markup]:
    w, h = 160.0, 90.0
    for k, (title, pitch, yaw, roll, u, v, distance) in enumerate(_VIEWS):
        left, top = 5.0 + 182.5 * (k % 5), 5.0 + 138.0 * (k // 5)
        turn = exp(np.radians([pitch, 0, 0])) @ exp(np.radians([0, yaw, 0])) @ exp(np.radians([0, 0, roll]))
        centre = np.array([u * w / 2, v * h / 2, w]) * distance / w
        yield svg.element("rect", x=left, y=top, width=w, height=h, fill="#eee", stroke="#000")
        for dark, quad in _quads():
            cam = quad @ turn.T + centre
            xy = cam[:, :2] / cam[:, 2:] * w + [left + w / 2, top + h / 2]
            yield svg.element("polygon", points=xy, fill="#000" if dark else "#fff")
        yield _text(left + w / 2, top + h + 17, title, 14, "middle")


def _quads() -> Iterator[tuple[bool, Array]]:
    """A white sheet one wide and the dark squares of a small chessboard on it, (4, 3) each."""
    columns, rows, square = 8, 6, 0.115

    def quad(x0: float, y0: float, x1: float, y1: float) -> Array:
        return np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])

    x, y = 0.5 * columns * square, 0.5 * rows * square
    yield False, quad(-x - 0.04, -y - 0.04, x + 0.04, y + 0.04)
    for i in range(columns):
        for j in range(rows):
            if (i + j) % 2 == 0:
                a, b = i * square - x, j * square - y
                yield True, quad(a, b, a + square, b + square)


# ---- targets on the frame ----


def _front() -> Iterator[Markup]:
    x0, x1, y0, y1 = 220.0, 620.0, 40.0, 430.0
    outer = {"x": x0 - 28, "y": y0 - 28, "width": x1 - x0 + 56, "height": y1 - y0 + 56}
    yield svg.element("rect", **outer, fill="none", stroke="#999", stroke_width=16)
    cx, cy, r = 420.0, 235.0, 172.0
    yield svg.element("circle", cx=cx, cy=cy, r=r, fill="#f6f4ee", stroke="#000")
    for u, v in _DISCS:
        x, y, short = cx + r * u, cy + r * v, 9.0 * np.sqrt(1.0 - u**2 - v**2)
        turn = f"rotate({np.degrees(np.arctan2(v, u)):.0f} {x:.1f} {y:.1f})"
        yield svg.element("ellipse", cx=x, cy=y, rx=short, ry=9, transform=turn)
    corners = [(x0, y0), (x0, y1), (x1, y1), (x1, y0)]
    for i, a in enumerate(corners):
        yield _line(a, corners[i - 1], stroke=BLUE, stroke_width=1.6, stroke_dasharray="7 5")
    for (number, code), (x, y) in zip(TARGETS.items(), corners, strict=False):
        yield svg.element("rect", x=x - 27, y=y - 27, width=54, height=54, fill="#fff", stroke="#999", stroke_width=0.6)
        for radius, ink in zip(reversed(_RINGS), reversed(code), strict=True):
            yield svg.element("circle", cx=x, cy=y, r=0.6 * radius, fill=_INK[ink])
        side, anchor = (-44.0, "end") if x < cx else (44.0, "start")
        words = svg.element("tspan", str(number), font_weight="bold") + f" {code}"
        yield _text(x + side, y + 6, words, 17, anchor)
    for k, words in enumerate(("dashed: distances", "to measure, from", "centre to centre")):
        yield _text(666, 218 + 20 * k, words, 15)
    for k, words in enumerate(("targets in one plane,", "flat, facing you,", "no code twice")):
        yield _text(174, 218 + 20 * k, words, 15, "end")


# ---- places of the camera ----


def _places() -> Iterator[Markup]:
    for left, title, angles, ends in (
        (0.0, "from above", (-55.0, -28.0, 0.0, 28.0, 55.0), ("left", "right")),
        (450.0, "from the side", (-30.0, 0.0, 30.0), ("low", "high")),
    ):
        cx, cy = (left + 225.0, 52.0) if left == 0.0 else (left + 110.0, 165.0)
        straight = 90.0 if left == 0.0 else 0.0
        yield _text(left + 225, 352, title, 17, "middle", font_weight="bold")
        yield svg.element("circle", cx=cx, cy=cy, r=46, fill="#f6f4ee", stroke="#000")
        across = np.array([1.0, 0.0]) if left == 0.0 else np.array([0.0, 1.0])
        front = np.array([cx, cy]) + 36.0 * across[::-1]
        a, b = front - 62.0 * across, front + 62.0 * across
        yield _line(a, b, stroke="#999", stroke_width=7)
        for at in (a, b):
            yield svg.element("circle", cx=at[0], cy=at[1], r=7, fill=_INK["M"], stroke="#000", stroke_width=0.6)
        for angle in angles:
            yield from _camera(front, straight - angle, 205.0)
        for angle, words in ((angles[0], ends[0]), (angles[-1], ends[1])):
            out = np.radians(straight - angle) if left == 0.0 else np.radians(-angle)
            x, y = front + 205.0 * np.array([np.cos(out), np.sin(out)])
            y += 44.0 if left == 0.0 else 5.0
            anchor, x = ("middle", x) if left == 0.0 else ("start", x + 26.0)
            yield _text(x, y, f"far {words}", 15, anchor)


def _camera(towards: Array, degrees: float, distance: float) -> Iterator[Markup]:
    """A camera that looks back at a point from a direction, with its line of sight."""
    out = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    side = np.array([-out[1], out[0]])
    at = towards + distance * out
    body = np.array([at + 9 * side, at + 9 * side + 18 * out, at - 9 * side + 18 * out, at - 9 * side])
    lens = np.array([at, at - 11 * out + 8 * side, at - 11 * out - 8 * side])
    near, far = towards + 30.0 * out, at - 16 * out
    yield _line(near, far, stroke=BLUE, stroke_dasharray="2 5")
    yield svg.element("polygon", points=body)
    yield svg.element("polygon", points=lens)
