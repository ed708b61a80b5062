"""A simulated scene: camera, ball with its discs, the device's frame with its targets, a cluttered room, and the light.

`default_scene` has the geometry of the reference recordings (the frame of `far26`) and the cameras of Wittich 2017,
table 2. Two struts in front of the ball carry four ring targets on white cards, and bolts that look exactly like discs.
The room holds false candidates: black dots, single coloured discs, coloured rings in wrong nestings. No ring target of
the room is a valid one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from spheremouse.ball.rig import Ball, Rig, Targets
from spheremouse.geometry.camera import InteriorOrientation, Pose
from spheremouse.geometry.rotation import Array, from_euler
from spheremouse.simulate.ball.options import View
from spheremouse.simulate.ball.pattern import Pattern
from spheremouse.simulate.cast import Viewpoint
from spheremouse.simulate.light import Lamp, Lighting, Strip
from spheremouse.simulate.shapes import Colour, Face, Ring, Shape, Sphere, box, post

# Shares of light given back: blue, green, red
INK: dict[str, Colour] = {"C": (0.74, 0.72, 0.008), "M": (0.58, 0.010, 0.72), "Y": (0.008, 0.66, 0.78)}
PAPER: Colour = (0.74, 0.76, 0.77)
BLACK: Colour = (0.012, 0.012, 0.012)  # discs and bolts alike
WHITE_BALL: Colour = (0.66, 0.70, 0.72)
_STEEL: Colour = (0.235, 0.215, 0.205)
_WOOD: Colour = (0.07, 0.13, 0.22)
_WALL: Colour = (0.33, 0.37, 0.36)
_BOARDS: Colour = (0.105, 0.165, 0.235)

FRONT = np.array([0.0, 0.0, 1.0])
CARD_MARGIN = 1.22  # outer radii from the middle of a target to the edge of its card
_FLOOR_Y, _BACK_Z, _SIDE_X, _TOP_Y = -1.15, -1.75, 2.7, 2.5

STRIPS = (Strip((-0.3724, -0.2764), (-0.75, 0.277), 0.5489), Strip((0.2776, 0.3736), (-0.75, 0.277), 0.5489))
LAMPS = (
    Lamp(*np.array([(-0.7, 2.3, 1.3), (0.6, 0.0, 0.0), (0.0, 0.10, -0.30), (21.0, 22.5, 23.5)])),
    Lamp(*np.array([(2.4, 0.9, 2.0), (0.0, 0.0, -0.6), (0.0, 0.7, 0.0), (3.6, 3.2, 2.8)])),
)


def frame(targets: Targets, bolt_radius: float) -> list[Shape]:
    """Return struts, feet, cradle, bolts of `bolt_radius` m, and the targets on their cards."""
    shapes: list[Shape] = []
    for strip in STRIPS:
        (x0, x1), (y0, y1) = strip.x, strip.y
        x = 0.5 * (x0 + x1)
        shapes += box((x0, y0, 0.5369), (x1, y1, 0.5609), _STEEL)
        shapes += box((x0 + 0.01, _FLOOR_Y, 0.47), (x1 - 0.01, y0, 0.5609), _STEEL)
        shapes += box((x0 - 0.02, _FLOOR_Y, 0.42), (x1 + 0.02, _FLOOR_Y + 0.05, 0.62), _STEEL)
        shapes += box((x - 0.03, -0.86, -0.45), (x + 0.03, -0.80, 0.50), _STEEL)
        for y in (0.238, -0.052, -0.302, -0.452, -0.702):
            shapes.append(Ring(np.array([x, y, 0.5612]), FRONT, 0.0, bolt_radius, BLACK))
    shapes += box((-0.32, -0.88, 0.49), (0.32, -0.80, 0.54), _STEEL)
    shapes += post((0.0, -0.52, 0.0), (0.0, -0.44, 0.0), 0.425, _STEEL, sides=48)  # the cradle the ball lies in
    for x, z in ((0.15, 0.38), (-0.15, 0.38), (0.22, -0.35), (-0.22, -0.35)):
        shapes += post((x, _FLOOR_Y, z), (x, -0.5, z), 0.022, _STEEL)
    for code, position in zip(targets.codes, targets.position, strict=True):
        shapes += ring_target(position, targets.radii, code)
    return shapes


def ring_target(centre: Array, radii: Array, code: str) -> list[Shape]:
    """Return a target with radii (3,) m on its card."""
    half = CARD_MARGIN * float(radii[2])
    rings = _rings(centre, [(INK[c], float(r)) for c, r in zip(code, radii, strict=True)])
    return [card(centre - 0.001 * FRONT, half, half), *rings]


def room() -> list[Shape]:
    """Walls, floor, shelves, posters with false candidates, a lamp and a plant."""
    shapes: list[Shape] = [*_walls(), *_shelves(), *_posters()]
    x, z = -1.35, -0.95  # a floor lamp
    shapes += post((x, _FLOOR_Y, z), (x, 1.02, z), 0.018, BLACK)
    shapes += post((x, 0.95, z), (x, 1.25, z), 0.20, (0.04, 0.42, 0.62), top_radius=0.12)
    shapes += post((x, _FLOOR_Y, z), (x, _FLOOR_Y + 0.03, z), 0.15, BLACK, top_radius=0.14)
    shapes += post((1.12, _FLOOR_Y, -1.1), (1.12, -0.82, -1.1), 0.13, (0.10, 0.16, 0.42), top_radius=0.17)  # a plant
    leaves = ((0, -0.60, 0, 0.17), (0.12, -0.44, 0.05, 0.12), (-0.13, -0.46, -0.04, 0.13), (0, -0.30, 0, 0.1))
    shapes += [Sphere(np.array([1.12 + dx, y, -1.1 + dz]), r, (0.06, 0.20, 0.07)) for dx, y, dz, r in leaves]
    return shapes


def card(centre: Array, half_x: float, half_y: float, colour: Colour = PAPER, turn: float = 0.0) -> Face:
    """A sheet that faces the camera, turned in its own plane."""
    c, s = np.cos(turn), np.sin(turn)
    right, up = np.array([c, s, 0.0]) * half_x, np.array([-s, c, 0.0]) * half_y
    return Face(np.array([centre - right - up, centre + right - up, centre + right + up, centre - right + up]), colour)


def _rings(centre: Array, colours: Sequence[tuple[Colour, float]]) -> list[Ring]:
    """Return nested rings from their colours and outer radii, the innermost first."""
    inner = (0.0, *(outer for _, outer in colours))
    return [Ring(centre, FRONT, inner[k], outer, colour) for k, (colour, outer) in enumerate(colours)]


def _walls() -> list[Shape]:
    """Return the room around the ball."""
    x, low, back = _SIDE_X, _FLOOR_Y, _BACK_Z
    sides = box((-x, low, back), (x, _TOP_Y, 4.0), _WALL)
    colours = ((0.40, 0.38, 0.33), (0.40, 0.38, 0.33), _BOARDS, (0.7, 0.7, 0.7), _WALL, (0.3, 0.3, 0.3))
    shapes: list[Shape] = [Face(side.corners, colour) for side, colour in zip(sides, colours, strict=True)]
    shapes[2] = Face(np.roll(sides[2].corners[::-1], 2, axis=0), _BOARDS, stripes=0.16)  # boards along z
    return shapes + box((-x, low, back), (x, low + 0.09, back + 0.02), (0.6, 0.62, 0.62))


def _shelves() -> list[Shape]:
    """Two boards on the back wall, above the ball, with books, boxes and small balls.

    They are false candidates: many have the colours of the targets, or the black of the discs. Every second book stands
    on the upper board too, mirrored and in the colour of another one.
    """
    back, shapes = _BACK_Z, []
    for y in (0.98, 1.47):
        shapes += box((-1.7, y - 0.03, back), (1.7, y, back + 0.28), _WOOD)
    books = (  # x of the left side, width and height, m; colour
        (-1.62, 0.09, 0.30, INK["M"]), (-1.52, 0.06, 0.26, (0.45, 0.12, 0.06)), (-1.45, 0.10, 0.33, (0.10, 0.10, 0.11)),
        (-1.34, 0.05, 0.27, PAPER), (-0.95, 0.16, 0.14, INK["C"]), (-0.52, 0.08, 0.31, (0.05, 0.28, 0.08)),
        (-0.43, 0.07, 0.27, (0.03, 0.06, 0.45)), (-0.35, 0.10, 0.30, INK["Y"]), (-0.24, 0.05, 0.24, (0.35, 0.2, 0.3)),
        (0.10, 0.22, 0.16, _WOOD), (0.42, 0.07, 0.29, INK["C"]), (0.50, 0.08, 0.32, (0.40, 0.10, 0.36)),
        (0.59, 0.06, 0.25, PAPER), (0.95, 0.12, 0.20, (0.02, 0.25, 0.60)), (1.25, 0.08, 0.30, (0.45, 0.20, 0.04)),
        (1.34, 0.09, 0.33, INK["M"]), (1.44, 0.06, 0.28, (0.12, 0.12, 0.13)),
    )  # fmt: skip
    for i, (x, width, height, colour) in enumerate(books):
        low, high = (x, 0.98, back + 0.03), (x + width - 0.008, 0.98 + height, back + 0.22)
        shapes += box(low, high, colour, 0.02 * (i % 3 - 1))
        if i % 2 == 0:
            low, high = (-x - width, 1.47, back + 0.04), (-x, 1.47 + 0.9 * height, back + 0.2)
            shapes += box(low, high, books[-1 - i][3])
    for x, y, r, colour in (
        (-1.12, 0.98, 0.085, (0.40, 0.16, 0.42)), (-0.68, 0.98, 0.06, (0.05, 0.08, 0.6)), (0.80, 0.98, 0.075, INK["M"]),
        (1.14, 0.98, 0.06, BLACK), (-0.05, 0.98, 0.05, BLACK), (0.72, 1.47, 0.08, (0.5, 0.2, 0.05)),
    ):  # fmt: skip
        shapes.append(Sphere(np.array([x, y + r, back + 0.15]), r, colour))
    return shapes


def _posters() -> list[Shape]:
    """Sheets on the wall with shapes that resemble discs or targets, and a wheel that leans in the corner."""
    c, m, y, k, w = INK["C"], INK["M"], INK["Y"], BLACK, PAPER
    eye = [(k, 0.022), (w, 0.045), (k, 0.055)]
    sheets = (  # x, y, half width and height, turn, and marks: x, y, rings
        (-1.22, 0.42, 0.26, 0.20, 0.03, [  # doubles and singles
            (-0.13, 0.07, [(m, 0.03), (c, 0.075)]), (0.06, 0.09, [(y, 0.06)]), (-0.05, -0.10, [(m, 0.032)]),
            (0.15, -0.09, [(k, 0.022)]),
        ]),
        (1.22, 0.50, 0.27, 0.22, -0.04, [  # wrong nestings: a colour twice, a gap in the middle
            (-0.12, 0.08, [(y, 0.03), (m, 0.06), (y, 0.09)]), (0.13, 0.06, [(w, 0.025), (c, 0.05), (m, 0.08)]),
            (0.10, -0.12, [(k, 0.024)]), (-0.10, -0.12, [(c, 0.035), (m, 0.06), (c, 0.085)]),
        ]),
        (-1.25, -0.45, 0.25, 0.24, 0.02, [  # black dots
            (-0.13, 0.11, [(k, 0.042)]), (0.10, 0.13, [(k, 0.030)]), (0.02, -0.02, [(k, 0.036)]),
            (-0.12, -0.13, [(k, 0.025)]), (0.15, -0.12, [(k, 0.040)]),
        ]),
        (1.28, -0.10, 0.18, 0.20, 0.05, [(-0.07, 0.04, eye), (0.07, 0.04, eye), (0.0, -0.11, [(m, 0.03)])]),
    )  # fmt: skip
    shapes: list[Shape] = []
    z = _BACK_Z + 0.012
    for x, up, half_x, half_y, turn, marks in sheets:
        shapes.append(card(np.array([x, up, z]), half_x, half_y, PAPER, turn))
        for dx, dy, rings in marks:
            shapes += _rings(np.array([x + dx, up + dy, z + 0.004]), rings)
    for inner, outer, colour in ((0.0, 0.07, PAPER), (0.07, 0.21, BLACK)):
        across = np.array([0.0, 0.24, 0.97]) / np.hypot(0.24, 0.97)
        shapes.append(Ring(np.array([0.86, -0.93, -0.62]), across, inner, outer, colour))
    return shapes


# Wittich 2017, table 2: focal length (px), position (m), and omega, phi, kappa (deg) of R_obj_cam with the z axis
# of `cam` forward; the table's angles mean the same rotation.
_VIEWS: dict[str, tuple[float, tuple[float, float, float], tuple[float, float, float]]] = {
    "far": (640.0, (0.0, 0.0, 2.35), (180.0, 0.0, 90.0)),
    "near": (320.0, (0.0, -0.45, 1.27), (-170.0, 0.0, 0.0)),
}
_TARGET_RADII = np.array([0.012, 0.024, 0.036])
_BOLT_RADIUS = 0.0105  # m, as far26: the size of a disc that lies a little aslant
_TARGET_POSITIONS = np.array(
    [[-0.3244, 0.1546, 0.5629], [-0.3244, -0.5954, 0.5629], [0.3256, -0.5954, 0.5629], [0.3256, 0.1546, 0.5629]]
)


@dataclass(frozen=True, slots=True)
class Scene:
    """All that does not change during a recording but the ball's attitude."""

    camera: InteriorOrientation
    pose: Pose
    ball_radius: float  # m
    disc_directions: Array  # (n, 3) unit vectors, ball
    disc_radius: float  # m, along the ball's surface
    targets: Targets
    surroundings: tuple[Shape, ...]  # frame, bolts, cards, targets, room
    lighting: Lighting
    exposure_s: float = 0.0  # s
    readout_s: float = 0.0  # s, row v of h is exposed around stamp + readout_s * ((v + 1/2) / h - 1/2)
    ball_colour: Colour = WHITE_BALL
    disc_colour: Colour = BLACK
    fallen: tuple[int, ...] = ()  # discs that are no longer on the ball
    pattern: Pattern | None = None  # under the discs; None: the ball has one colour
    scale: float = 1.0  # m, the unit of length of `surroundings` and `lighting`

    @property
    def disc_angle(self) -> float:
        """rad, between the centre of a disc and its edge, seen from the ball's centre."""
        return self.disc_radius / self.ball_radius

    def viewpoint(self, *, ball: bool = True) -> Viewpoint:
        """Return all shapes before the camera. The ball is the first; if it is left out, it is behind the camera."""
        centre = np.zeros(3) if ball else self.pose.position - 10.0 * self.pose.rotation[:, 2]
        return Viewpoint([Sphere(centre, self.ball_radius, self.ball_colour), *self.surroundings], self.pose)

    def scaled(self, factor: float) -> "Scene":
        """The same scene in another size."""
        targets, pose = self.targets, self.pose
        return replace(
            self,
            pose=Pose(pose.rotation, factor * pose.position),
            ball_radius=factor * self.ball_radius,
            disc_radius=factor * self.disc_radius,
            targets=replace(targets, position=factor * targets.position, radii=factor * targets.radii),
            scale=factor * self.scale,
        )

    def rig(self) -> Rig:
        """The device as it is known beforehand, without the camera's pose."""
        disc_radius = self.disc_radius if len(self.disc_directions) else None
        rig = Rig(self.camera, Ball(self.ball_radius), self.targets, disc_radius)
        return replace(rig, readout_s=self.readout_s, exposure_s=self.exposure_s)


def default_scene(
    discs: int = 26,
    view: View = "far",
    seed: int = 0,
    *,
    width: int = 640,
    height: int = 480,
    distortion: Array | None = None,
    pattern: Pattern | None = None,
) -> Scene:
    """Return the reference geometry. `seed` places the discs. Other sizes than 640 x 480 keep the whole view.

    `distortion` (5,) is k1, k2, p1, p2, k3; None: a lens without distortion. A ball with a `pattern` may have no discs.
    """
    focal, position, angles = _VIEWS[view]
    focal *= min(width / 640.0, height / 480.0)
    lens = np.zeros(5) if distortion is None else np.asarray(distortion, dtype=float)
    targets = Targets((1, 2, 3, 4), ("MCY", "CYM", "YMC", "CMY"), _TARGET_POSITIONS, np.zeros((12, 12)), _TARGET_RADII)
    ball_radius, disc_radius = 0.6, 0.02
    directions = np.zeros((0, 3))
    if discs > 0 or pattern is None:
        directions = spread_directions(discs, 3.0 * disc_radius / ball_radius, np.random.default_rng(seed))
    camera = InteriorOrientation(width, height, focal, focal, width / 2.0, height / 2.0, lens)
    pose, lighting = Pose(from_euler(np.radians(angles)), np.array(position)), Lighting(LAMPS, STRIPS, ball_radius)
    shapes = (*frame(targets, _BOLT_RADIUS), *room())
    return Scene(camera, pose, ball_radius, directions, disc_radius, targets, shapes, lighting, pattern=pattern)


def spread_directions(n: int, apart: float, rng: np.random.Generator) -> Array:
    """Return unit vectors, (n, 3), spread irregularly over the sphere, no two nearer than `apart` rad.

    Random points repel each other, like electrons on a sphere. The iteration stops before they settle, since a regular
    pattern would look alike from several sides. Raises ValueError if `n` do not fit.
    """
    if n < 1:
        raise ValueError("a ball needs at least one disc")
    if n * 0.5 * (1.0 - np.cos(0.5 * apart)) > 0.5:  # caps in the densest packing fill 0.9 of a plane
        raise ValueError(f"{n} discs do not fit on the ball")
    u = rng.standard_normal((n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    spacing = np.sqrt(4.0 * np.pi / n)
    for step in range(400):
        offset = u[:, None] - u[None]
        distance = np.linalg.norm(offset, axis=2) + np.eye(n)
        nearest = np.min(distance + 10.0 * np.eye(n))
        if step >= 12 and nearest > 2.0 * np.sin(0.5 * max(apart, 0.55 * spacing)):
            break
        push = np.sum(offset / distance[..., None] ** 3, axis=1)
        push -= np.sum(push * u, axis=1, keepdims=True) * u
        length = np.linalg.norm(push, axis=1, keepdims=True)
        u += push * np.minimum(0.02 * spacing**3, 0.1 * spacing / np.maximum(length, 1e-12))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
    if np.max(u @ u.T - 2.0 * np.eye(n)) > np.cos(apart):
        raise ValueError(f"{n} discs do not fit on the ball")
    return u
