"""`synthetic[:KEY=VALUE,...]`: a simulated film of a ball, with the keys of `spheremouse simulate`.

For example `synthetic:motion=play,seconds=10,noise=5`. Lists are in brackets, as in `size=[1280,960]`.
"""

import re

from spheremouse.capture import Stream, pace
from spheremouse.files.config import override
from spheremouse.simulate.ball.film import Simulation, SimulationOptions, prepare, simulate


def open(argument: str, realtime: bool) -> Stream:
    simulation = check(argument)
    frames = (rendered.frame for rendered in simulate(simulation))
    return Stream(
        pace(frames) if realtime else frames, rig=simulation.scene.rig(), fps=simulation.fps, count=simulation.frames
    )


def check(argument: str) -> Simulation:
    """Return the simulation without rendering it. Raise ConfigurationError if the argument is invalid."""
    options = SimulationOptions()
    for item in re.split(r",(?![^\[]*\])", argument):
        if item.strip():
            options = override(options, item, label="synthetic: ")
    return prepare(options, named=lambda field: f"synthetic: {field}")
