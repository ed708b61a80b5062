"""Films of a ball that stands while something else moves: sheets, hands, beads, light, the lens, the camera.

Nothing but the ball may move the pointer. Each scene disturbs the picture for 12 s. Then it ends, and a hand turns
the ball. `film` makes the frames with their truth, and `judge` returns what a tracker made of them.
`python -m tests.standing_scenes --seeds 10` prints a table of all scenes; it takes half an hour.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from spheremouse.ball.build import begin, build
from spheremouse.ball.settings import Settings
from spheremouse.ball.track import step
from spheremouse.geometry.camera import unproject
from spheremouse.geometry.rotation import Array, exp
from spheremouse.output.counts import Counter, MotionSettings
from spheremouse.simulate.ball.backdrop import Backdrop, render_backdrop
from spheremouse.simulate.ball.events import PER_METRE, HandVisit, draw_hand, place_hand
from spheremouse.simulate.ball.profile import Gesture, Gestures
from spheremouse.simulate.ball.render import Renderer
from spheremouse.simulate.ball.scene import Scene, default_scene
from spheremouse.simulate.shapes import Sphere, look
from spheremouse.tracker import Event, Frame, Status

Picture = NDArray[np.float32]  # (h, w, 3) grey values without noise
Disturbance = Callable[[Picture, float], Picture]  # the picture at a time in s since the disturbance began

SECONDS = 12.0  # s, of a disturbance
FPS = 30.0
NOISE = 4.0  # grey values, standard deviation
_TURNED = 5.0  # s, before the disturbance: 4 s of turning and 1 s of rest
_CLEAR = 1.5  # s, from the end of the disturbance to the turn that follows
_PLAY = 2.0  # s, of the film from there on
_TOLD = 3.0  # counts, from which motion counts as seen
_AFTER = Gesture(0.0, 1.2, (0.6, 0.0, -0.8), 0.9)  # the turn that follows; its start is replaced
_WIDTH, _HEIGHT = 640, 480
_DARK, _LIGHT = 25.0, 225.0  # grey values of spots and sheets


class StandingFrame(NamedTuple):
    """A frame with the ball's true attitude."""

    frame: Frame
    attitude: Array  # (3, 3) R_obj_ball


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a tracker made of a film."""

    farthest: float  # counts, the greatest distance of the sums from where they were when the disturbance began
    delay: float  # s, from the true motion that follows to the first that is reported; inf: none is
    error: float  # counts, of the sum over the turn that follows
    lost: float  # share of the frames of the disturbance in which the ball was lost
    events: tuple[tuple[float, Event], ...]  # s since the disturbance began


def judge(frames: Iterator[StandingFrame], scene: Scene, turned: bool, settings: Settings | None = None) -> Outcome:
    """Track a film of `film` with the known camera pose, and compare the sums of its counts with the truth."""
    tracker = build(scene.rig(), scene.pose, settings or Settings())
    matrix = MotionSettings().matrix(scene.ball_radius)
    counter, state = Counter(matrix), None
    stamps, sums, truth, statuses, events = [], [np.zeros(3)], [np.zeros(3)], [], []
    start, before = _TURNED if turned else 0.0, None
    for frame, attitude in frames:
        state = begin(tracker, frame.stamp) if state is None else state
        state, motion, new = step(state, frame, tracker)
        before = attitude if before is None else before
        turn = attitude @ before.T
        truth.append(truth[-1] + matrix @ cv2.Rodrigues(turn)[0].ravel())
        sums.append(sums[-1] + np.array(counter.report(motion).counts))
        stamps.append(frame.stamp - start)
        statuses.append(state.status)
        events += [(frame.stamp - start, event) for event in new]
        before = attitude
    t, told, true = np.array(stamps), np.array(sums[1:]), np.array(truth[1:])
    during = (t >= 0.0) & (t < SECONDS + _CLEAR)
    origin = told[np.flatnonzero(t < 0.0)[-1]] if turned else np.zeros(3)
    farthest = float(np.linalg.norm(told[during] - origin, axis=1).max())
    after = np.flatnonzero(t >= SECONDS + _CLEAR - 0.5 / FPS)
    moved = [np.linalg.norm(x[after] - x[after[0] - 1], axis=1) for x in (true, told)]
    first = [float(t[after[np.argmax(m >= _TOLD)]]) if np.any(m >= _TOLD) else np.inf for m in moved]
    error = float(np.linalg.norm((told[-1] - told[after[0] - 1]) - (true[-1] - true[after[0] - 1])))
    lost = float(np.mean([s is Status.LOST for s, d in zip(statuses, during, strict=True) if d]))
    return Outcome(farthest, max(first[1] - first[0], 0.0), error, lost, tuple(events))


def film(
    name: str, seed: int, *, turned: bool = False, discs: int = 26, seconds: float = SECONDS
) -> tuple[Scene, Iterator[StandingFrame]]:
    """The scene at the start, and the frames of the scene `name`; `seed` draws discs, disturbance and noise.

    `turned`: a hand turns the ball first, for 4 s. The disturbance may be cut to `seconds`; then no turn follows.
    """
    scene = default_scene(discs, seed=seed)
    return scene, _frames(scene, name, seed, turned, seconds)


def _frames(scene: Scene, name: str, seed: int, turned: bool, seconds: float) -> Iterator[StandingFrame]:
    rng = np.random.default_rng([seed, 7])
    disturb = SCENES[name](scene, rng)
    start = _TURNED if turned else 0.0
    shown = (
        Gesture(0.3, 1.9, (0.8, 0.0, 0.6), 2.4),
        Gesture(2.2, 1.8, (-0.28, 0.96, 0.0), 2.1),
    )
    follows = replace(_AFTER, start=start + SECONDS + _CLEAR)
    end = start + (seconds if seconds < SECONDS else SECONDS + _CLEAR + _PLAY)
    profile = Gestures((*(shown if turned else ()), follows), end)
    renderer = Renderer(scene, backdrop=_backdrop())
    noise = _Noise(rng)
    for index in range(round(end * FPS)):
        t = index / FPS
        plain = renderer.frame(profile, t, index, rng)
        picture = plain.frame.image.astype(np.float32)
        if t >= start:
            picture = disturb(picture, t - start)
        yield StandingFrame(Frame(noise.added(picture), t, index), plain.attitude)


@cache
def _backdrop() -> Backdrop:
    """Everything but the discs, which the seed places."""
    return render_backdrop(default_scene())


class _Noise:
    """Normal noise: a random part of a field that is drawn once, which is faster than new noise for each frame."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._field = (NOISE * rng.standard_normal((_HEIGHT + 200, _WIDTH + 200, 3))).astype(np.float32)

    def added(self, picture: Picture) -> NDArray[np.uint8]:
        y, x = self._rng.integers(0, 200, 2)
        part = self._field[y : y + _HEIGHT, x : x + _WIDTH]
        return np.asarray(cv2.add(picture, part, dtype=cv2.CV_8U), dtype=np.uint8)


# ---- spotted things in front of the ball ----


@cache
def _pixels() -> tuple[Array, Array]:
    """x and y of all pixels, (h, w)."""
    y, x = np.mgrid[0:_HEIGHT, 0:_WIDTH].astype(float)
    return x, y


def _spots(x: Array, y: Array, radius: float, spacing: float, odd: float) -> Array:
    """Share of each pixel, at (x, y) px of a cloth, that dark spots cover; every second row is shifted by `odd`."""
    row = np.rint(y / spacing)
    column = np.rint(x / spacing - odd * (row % 2))
    distance = np.hypot(x - spacing * (column + odd * (row % 2)), y - spacing * row)
    return np.clip(0.5 + radius - distance, 0.0, 1.0)


class _Cloth(NamedTuple):
    """A spotted strip, longer than the picture."""

    angle: float  # rad, of its long axis against the rows
    half: float  # px, half its width
    radius: float  # px, of the spots
    spacing: float  # px
    odd: float  # share of the spacing, of every second row

    def over(self, picture: Picture, across: float, along: float = 0.0) -> Picture:
        """The picture behind the strip, whose middle lies `across` px beside the picture's, shifted by `along` px."""
        u, v = _pixels()
        c, s = np.cos(self.angle), np.sin(self.angle)
        x = c * (u - 0.5 * _WIDTH) + s * (v - 0.5 * _HEIGHT) - along
        y = -s * (u - 0.5 * _WIDTH) + c * (v - 0.5 * _HEIGHT) - across
        cover = np.clip(0.5 + self.half - np.abs(y), 0.0, 1.0)[..., None]
        shade = _LIGHT - (_LIGHT - _DARK) * _spots(x, y, self.radius, self.spacing, self.odd)[..., None]
        return (picture * (1.0 - cover) + cover * shade).astype(np.float32)


def _cloth(rng: np.random.Generator, half: float) -> _Cloth:
    return _Cloth(
        float(rng.uniform(0.0, 2.0 * np.pi)),
        half,
        float(rng.uniform(4.0, 9.0)),
        float(rng.uniform(32.0, 65.0)),
        float(rng.choice([0.0, 0.5])),
    )


def _sheet_stays(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """A sheet comes in front, stays there, trembling in a hand, and goes."""
    cloth, speed, come = _cloth(rng, 420.0), rng.uniform(300.0, 1500.0), rng.uniform(1.5, 3.0)
    tremble = rng.uniform(0.0, 1.5)

    def disturb(picture: Picture, t: float) -> Picture:
        across = -840.0 + min(speed * max(t - come, 0.0), 840.0) + speed * max(t - SECONDS, 0.0)
        if abs(across) >= 840.0:
            return picture
        return cloth.over(picture, across + tremble * np.sin(9.0 * t), tremble * np.sin(7.0 * t))

    return disturb


def _sheet_passes(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """A sheet passes, four times in all, there and back."""
    half = rng.uniform(150.0, 350.0)
    cloth, speed, first = _cloth(rng, half), rng.uniform(300.0, 1200.0), rng.uniform(1.0, 2.5)
    reach = half + 420.0

    def disturb(picture: Picture, t: float) -> Picture:
        visit, since = divmod(t - first, (SECONDS - first) / 4.0)
        across = -reach + speed * since
        if not 0 <= visit < 4 or across > reach:
            return picture
        return cloth.over(picture, across if visit % 2 == 0 else -across)

    return disturb


def _sleeve(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """A spotted sleeve wipes back and forth over the ball."""
    cloth = _cloth(rng, float(rng.uniform(50.0, 110.0)))
    reach, rate = rng.uniform(60.0, 180.0), 2.0 * np.pi * rng.uniform(0.3, 0.9)

    def disturb(picture: Picture, t: float) -> Picture:
        away = 500.0 * (2.0 - min(t, 1.0) - min(max(SECONDS - t, 0.0), 1.0))
        if away >= 500.0:
            return picture
        return cloth.over(picture, away + reach * np.sin(rate * t), 0.3 * reach * np.sin(0.7 * rate * t))

    return disturb


def _dots(picture: Picture, centre: Array, radius: Array) -> Picture:
    """Dark dots at (n, 2) px with radii (n,) px before the picture."""
    for (x, y), r in zip(centre, radius, strict=True):
        left, top = max(int(x - r - 2), 0), max(int(y - r - 2), 0)
        part = picture[top : max(int(y + r + 3), 0), left : max(int(x + r + 3), 0)]
        v, u = np.mgrid[0 : part.shape[0], 0 : part.shape[1]]
        share = np.clip(0.5 + r - np.hypot(u + left - x, v + top - y), 0.0, 1.0)[..., None]
        part += share * (_DARK - part)
    return picture


def _falling_dots(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """Dark dots fall through the picture, each at a speed of its own, or all at one."""
    n = int(rng.integers(8, 40))
    x, radius = rng.uniform(100.0, 540.0, n), rng.uniform(4.0, 9.0, n)
    speed = rng.uniform(30.0, 400.0) * (np.ones(n) if rng.random() < 0.5 else rng.uniform(0.6, 1.4, n))
    first, drift = rng.uniform(0.0, 560.0, n), rng.uniform(-0.2, 0.2)

    def disturb(picture: Picture, t: float) -> Picture:
        if not 0.5 < t < SECONDS:
            return picture
        y = (first + speed * t) % 560.0 - 40.0
        return _dots(picture, np.stack([x + drift * y, y], axis=1), radius)

    return disturb


def _pendant(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """A light pendant with dark beads swings before the ball."""
    n = int(rng.integers(4, 9))
    beads = rng.uniform((-60.0, 440.0), (60.0, 560.0), (n, 2))  # px from where it hangs
    radius = rng.uniform(4.0, 8.0, n)
    swing, rate = rng.uniform(0.1, 0.3), 2.0 * np.pi * rng.uniform(0.5, 1.0)

    def disturb(picture: Picture, t: float) -> Picture:
        if not 0.5 < t < SECONDS:
            return picture
        angle = swing * np.sin(rate * t)
        c, s = np.cos(angle), np.sin(angle)
        x, y = beads.T
        centre = np.stack([320.0 + c * x + s * y, -260.0 - s * x + c * y], axis=1)
        return _dots(picture, centre, radius)

    return disturb


def _spotted_hand(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """The simulated hand in a spotted glove and sleeve."""
    hand = draw_hand()
    y, x = np.mgrid[0 : hand.shape[0], 0 : hand.shape[1]].astype(float)
    radius, spacing = rng.uniform(0.009, 0.016) * PER_METRE, rng.uniform(0.05, 0.09) * PER_METRE
    hand[..., :3] *= 1.0 - 0.9 * _spots(x, y, radius, spacing, 0.5)[..., None].astype(np.float32)
    visits = [HandVisit(1.5, 11.5, bool(rng.random() < 0.5), float(rng.uniform(1.0, 1.6)))]
    if rng.random() < 0.5:
        visits.append(HandVisit(3.0, 9.0, not visits[0].right, float(rng.uniform(1.0, 1.6))))

    def disturb(picture: Picture, t: float) -> Picture:
        for placed in (place_hand(hand, visit, scene, t) for visit in visits):
            if placed is not None:
                picture[placed.place] *= 1.0 - placed.paint[..., 3:]
                picture[placed.place] += placed.paint[..., :3]
        return picture

    return disturb


# ---- light on the ball ----


def _leaves(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """Light through moving leaves: soft shadows wander over the ball."""
    n = 25
    place, radius = rng.uniform((120.0, 40.0), (520.0, 440.0), (n, 2)), rng.uniform(5.0, 14.0, n)
    rate, phase, reach = rng.uniform(0.5, 3.0, n), rng.uniform(0.0, 6.3, n), rng.uniform(3.0, 25.0, (n, 2))
    depth = rng.uniform(0.4, 0.8)

    def disturb(picture: Picture, t: float) -> Picture:
        if not 0.5 < t < SECONDS:
            return picture
        u, v = _pixels()
        light = np.ones_like(u)
        for k in range(n):
            x, y = place[k] + reach[k] * (np.sin(rate[k] * t + phase[k]), np.cos(0.8 * rate[k] * t + phase[k]))
            r = int(radius[k] + 4)
            part = (slice(int(y) - r, int(y) + r + 1), slice(int(x) - r, int(x) + r + 1))
            distance = np.hypot(u[part] - x, v[part] - y)
            light[part] *= 1.0 - depth * np.clip(0.5 + (radius[k] - distance) / 4.0, 0.0, 1.0)
        return (picture * light[..., None]).astype(np.float32)

    return disturb


def _mirrored_shirt(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """A person in a polka-dot shirt sways, mirrored in the gloss of the ball."""
    radius, spacing = rng.uniform(4.0, 8.0), rng.uniform(30.0, 50.0)
    rate, reach, share = 2.0 * np.pi * rng.uniform(0.1, 0.4), rng.uniform(20.0, 80.0), rng.uniform(0.2, 0.5)
    u, v = _pixels()
    inside = (np.hypot(u - 320.0, v - 240.0) < 120.0)[..., None]

    def disturb(picture: Picture, t: float) -> Picture:
        if not 0.5 < t < SECONDS:
            return picture
        x, y = u - 320.0 - reach * np.sin(rate * t), v - 240.0 - 0.2 * reach * np.sin(1.7 * rate * t)
        dark = _spots(x, y, radius, spacing, 0.5)[..., None] * inside * (np.abs(x) < 90.0)[..., None]
        return (picture * (1.0 - share * dark)).astype(np.float32)

    return disturb


# ---- lens and camera ----


def _breathing(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """The focal length varies by 5 % from end to end, as a lens that hunts for focus."""
    rate, sign = 2.0 * np.pi * rng.uniform(0.1, 0.5), rng.choice([-1.0, 1.0])

    def disturb(picture: Picture, t: float) -> Picture:
        if t >= SECONDS:
            return picture
        scale = 1.0 + sign * 0.025 * (1.0 - np.cos(rate * t)) * min(1.0, 2.0 * (SECONDS - t))
        cx, cy = scene.camera.cx, scene.camera.cy
        M = np.array([[scale, 0.0, (1.0 - scale) * cx], [0.0, scale, (1.0 - scale) * cy]])
        warped = cv2.warpAffine(picture, M, (_WIDTH, _HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(warped, dtype=np.float32)

    return disturb


class _MovedCamera:
    """The picture as a camera beside `scene.pose` takes it, by the depth of each pixel; for a few millimetres."""

    def __init__(self, scene: Scene) -> None:
        u, v = _pixels()
        xy, _ = unproject(np.stack([u.ravel(), v.ravel()], axis=1), scene.camera)
        shapes = (Sphere(np.zeros(3), scene.ball_radius, (1.0, 1.0, 1.0)), *scene.surroundings)
        _, depth = look(shapes, scene.pose.position, scene.pose.rotation).cast(xy.reshape(_HEIGHT, _WIDTH, 2))
        z = np.where(np.isfinite(depth), depth, 5.0).reshape(-1, 1)
        self._scene, self._points = scene, (np.concatenate([xy, np.ones((len(xy), 1))], axis=1) * z).astype(np.float32)

    def take(self, picture: Picture, shift: Array, turn: Array) -> Picture:
        """With the camera shifted by (3,) m and turned by (3,) rad along its own axes."""
        camera = self._scene.camera  # its lens does not distort
        x, y, z = (self._points @ exp(turn).T.astype(np.float32) + shift.astype(np.float32)).T
        u = (camera.fx * x / z + camera.cx).reshape(_HEIGHT, _WIDTH).astype(np.float32)
        v = (camera.fy * y / z + camera.cy).reshape(_HEIGHT, _WIDTH).astype(np.float32)
        taken = cv2.remap(picture, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(taken, dtype=np.float32)


def _drift(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """The camera sinks slowly, by some millimetres and tenths of a degree, and stays there."""
    camera = _MovedCamera(scene)
    shift = rng.uniform(1e-3, 4e-3) * _unit(rng)
    turn = np.radians(rng.uniform(0.1, 0.5)) * _unit(rng)

    def disturb(picture: Picture, t: float) -> Picture:
        part = min(t / SECONDS, 1.0)
        return camera.take(picture, part * shift, part * turn)

    return disturb


def _shaking(scene: Scene, rng: np.random.Generator) -> Disturbance:
    """The camera shakes on a table that somebody leans on."""
    camera = _MovedCamera(scene)
    shift = rng.uniform(0.1e-3, 1e-3, (3, 1)) * np.array([_unit(rng) for _ in range(3)])
    turn = np.radians(rng.uniform(0.01, 0.08, (3, 1))) * np.array([_unit(rng) for _ in range(3)])
    rate, phase = 2.0 * np.pi * rng.uniform(0.5, 9.0, 3), rng.uniform(0.0, 6.3, 3)

    def disturb(picture: Picture, t: float) -> Picture:
        if t >= SECONDS:
            return picture
        part = np.sin(rate * t + phase) * min(1.0, t, SECONDS - t)
        return camera.take(picture, part @ shift, part @ turn)

    return disturb


def _unit(rng: np.random.Generator) -> Array:
    v = rng.standard_normal(3)
    return v / np.linalg.norm(v)


SCENES: dict[str, Callable[[Scene, np.random.Generator], Disturbance]] = {
    "spotted sheet": _sheet_stays,
    "sheet passing": _sheet_passes,
    "falling dots": _falling_dots,
    "spotted hand": _spotted_hand,
    "focus breathing": _breathing,
    "camera drifting": _drift,
    "camera shaking": _shaking,
    "spotted sleeve": _sleeve,
    "swinging beads": _pendant,
    "light through leaves": _leaves,
    "mirrored shirt": _mirrored_shirt,
}


_DISCS = (16, 12, 26, 10)  # on the ball, in turn


def main() -> None:
    """Print the outcome of each scene for some seeds, and how many do not hold."""
    parser = argparse.ArgumentParser(description="Standing balls while something else moves.")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--scene", action="append", choices=list(SCENES))
    options = parser.parse_args()
    bad = total = 0
    for name in options.scene or SCENES:
        for seed in range(1, options.seeds + 1):
            for turned in (False, True):
                discs = _DISCS[seed % len(_DISCS)]
                scene, frames = film(name, seed, turned=turned, discs=discs)
                outcome = judge(frames, scene, turned)
                holds = outcome.farthest <= 5.0 and outcome.delay <= 0.3
                bad, total = bad + (not holds), total + 1
                print(
                    f"{name}, seed {seed}, {discs} discs, {'turned' if turned else 'never turned'}: "
                    f"farthest {outcome.farthest:.1f}, delay {outcome.delay:.2f} s, error {outcome.error:.1f} counts, "
                    f"lost {100 * outcome.lost:.0f} %{'' if holds else ': DOES NOT HOLD'}",
                    flush=True,
                )
    print(f"{bad} of {total} do not hold")


if __name__ == "__main__":
    main()
