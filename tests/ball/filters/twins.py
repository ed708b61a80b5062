"""Twins in NumPy of the default filter's linear model. `body` is So3State.body, `points` SpherePoints.measurement."""

from typing import Any

import numpy as np

from spheremouse.ball.filters.so3_motion import AXES, CLONE_DIM, KINEMATIC_DIM, MAP_OFFSET, READOUT, RIG_ROW
from spheremouse.geometry.rotation import exp, hat, left_jacobian, log, tangent_basis

GATE, HORIZON, TOWARDS = 13.8, 0.2, np.array([0.0, 0.0, 1.0])


def drawn(seed, sigma=3e-3, m=12, foreign=3) -> tuple[Any, Any]:
    """Draw a ball of m discs in motion, and points of most of them in a random order, with some that are no disc."""
    rng = np.random.default_rng(seed)
    n = MAP_OFFSET + 2 * m + CLONE_DIM
    A = rng.normal(size=(n, 2 * n)) / np.sqrt(2 * n)
    scale = sigma * np.repeat([1.0, 10.0, 100.0, 0.3, 0.1, 1.0, 1.0], [3, 3, 3, 10, 1, 2 * m, 3])
    P = A @ A.T * np.outer(scale, scale)
    discs = rng.normal(size=(m, 3))
    discs /= np.linalg.norm(discs, axis=1, keepdims=True)
    motion = exp(rng.normal(size=3)), 3.0 * rng.normal(size=3), rng.normal(size=3)
    body = (
        *motion,
        discs,
        tangent_basis(discs),
        P,
        2e-3,
        1e-2 * rng.normal(size=4),
        m,
        False,
        0,
        1e-2 * rng.normal(size=3),
    )
    row, k = rng.uniform(-0.5, 0.5, m + foreign), m + foreign
    delay, radius = 0.01 * row, 0.6
    direction = [place(body, j, delay[j] + body[6] * row[j])[0] for j in range(m)] + [*rng.normal(size=(foreign, 3))]
    direction = np.array(direction)
    direction += 1.5 * sigma * rng.normal(size=(k, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    noise = rng.normal(size=(k, 3, 3)) * 1e-3 * radius
    noise = noise @ noise.transpose(0, 2, 1)
    order = np.flatnonzero(direction @ TOWARDS > HORIZON)
    rng.shuffle(order)
    fields = direction, noise, delay, row, (rng.normal(size=(k, 3, 4)) - np.eye(3, 4, 1)) / radius
    return body, (*(f[order].copy() for f in fields), radius, seen_rig(body) + 0.1 * sigma * rng.normal(size=4))


def place(body, j, delay):
    """Return the place of disc j, its axes, and the turn since the stamp."""
    attitude, rate, acceleration, discs, basis, *_ = body
    turn = rate * delay + 0.5 * acceleration * delay**2
    R = exp(turn) @ attitude
    return R @ discs[j], R @ basis[j], turn


def seen_rig(body):
    """Return the error of the rig, (4,), whose centre is that of the ball."""
    return body[7] + np.concatenate([[0.0], body[0] @ body[11]])


def seen_with_rig(body, points, i):
    """Return the direction of the point i, (3,), with the rig of the body, to first order in its error."""
    direction, *_, by_rig, _, rig_error = points
    moved = direction[i] + by_rig[i] @ (seen_rig(body) - rig_error)
    return moved / np.linalg.norm(moved)


def linear(body, points, i, j):
    """Return innovation, Jacobian by all errors, and image noise of the point i as the disc j."""
    _, noise, delay, row, by_rig, radius, _ = points
    t = delay[i] + body[6] * row[i]
    p, E, turn = place(body, j, t)
    turning = -E.T @ hat(p)
    H = np.zeros((2, len(body[5])))
    H[:, :3], H[:, 3:6] = turning @ exp(turn), t * turning @ left_jacobian(turn)
    H[:, 6:9] = 0.5 * t * H[:, 3:6]
    H[:, AXES:READOUT], H[:, READOUT] = -turning, turning @ body[1] * row[i]
    H[:, RIG_ROW:AXES] = -E.T @ by_rig[i]
    H[:, KINEMATIC_DIM:RIG_ROW] = H[:, RIG_ROW + 1 : AXES] @ body[0]
    H[:, MAP_OFFSET + 2 * j : MAP_OFFSET + 2 * j + 2] = np.eye(2)
    return E.T @ seen_with_rig(body, points, i), H, E.T @ noise[i] @ E / radius**2


def transfer(body, P, dx):
    """Return the matrix from the errors of a state with covariance P to those of the state moved by `dx`."""
    attitude, _, _, discs, basis, *_ = body
    m, at = len(discs), slice(MAP_OFFSET, len(P) - CLONE_DIM)
    G = P[:3, at] @ np.linalg.inv(P[at, at])
    shared = G @ dx[at]
    J, of_ball = left_jacobian(shared), log(exp(dx[:3]) @ exp(shared).T)
    S, K = exp(shared), left_jacobian(of_ball)
    turned = S @ attitude
    to = discs + np.einsum("kia,ka->ki", basis, dx[at].reshape(m, 2))
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    T = np.eye(len(P))
    T[:3, :3], T[:3, at] = K @ J, (exp(of_ball) @ S - K @ J) @ G
    for k in range(m):
        two = slice(MAP_OFFSET + 2 * k, MAP_OFFSET + 2 * k + 2)
        first = basis[k][:, 0] - to[k] @ basis[k][:, 0] * to[k]
        first /= np.linalg.norm(first)
        second = np.cross(to[k], first)
        second *= np.sign(second @ basis[k][:, 1])
        axes = np.stack([first, second], axis=1)
        A, B = -(attitude @ basis[k]).T @ hat(attitude @ discs[k]), -(turned @ axes).T @ hat(turned @ to[k])
        share = -np.trace(P[two, :3] @ A.T) / np.trace(A @ G @ P[at, at] @ G.T @ A.T)
        T[two, at] += np.clip(share, 0.0, 1.0) * (A - B @ S) @ G
    return T


def process(sigma):
    A = np.random.default_rng(99).normal(size=(KINEMATIC_DIM, KINEMATIC_DIM))
    return 0.1 * sigma**2 * A @ A.T
