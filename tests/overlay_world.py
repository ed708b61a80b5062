"""A ball at rest with plain discs, for the tests of what is marked on a frame."""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from spheremouse.ball.build import begin, build
from spheremouse.ball.settings import Settings
from spheremouse.ball.state import Epoch
from spheremouse.ball.track import step
from spheremouse.geometry.camera import project
from spheremouse.geometry.rotation import tangent_basis
from spheremouse.simulate.ball.scene import default_scene
from spheremouse.tracker import Frame


def epochs(width, height, detector="default", frames=1) -> Iterator[tuple]:
    scene = default_scene(60, "near", 3, width=width, height=height)
    rig = replace(scene.rig(), pose=scene.pose)
    image = np.full((height, width, 3), 200, np.uint8)
    tracker = build(rig, scene.pose, Settings(detector=detector))
    towards = scene.pose.position / np.linalg.norm(scene.pose.position)
    turn = np.linspace(0.0, 2.0 * np.pi, 60)[:, None]
    for u in scene.disc_directions[scene.disc_directions @ towards > 0.75]:
        e, alpha = tangent_basis(u), scene.disc_angle
        rim = np.cos(alpha) * u + np.sin(alpha) * (np.cos(turn) * e[:, 0] + np.sin(turn) * e[:, 1])
        uv = project(scene.pose.to_cam(scene.ball_radius * rim), scene.camera)[0]
        cv2.fillPoly(image, [np.rint(uv * 16).astype(np.int32)], (30, 30, 30), cv2.LINE_AA, 4)
    state = begin(tracker, 0.0)
    for k in range(frames):
        frame = Frame(image, k / 30, k)
        state, motion, events = step(state, frame, tracker)
        yield tracker, Epoch(frame, state, motion, events, {"detect": 0.0, "filter": 0.0})
