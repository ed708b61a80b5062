"""`synthetic[:KEY=VALUE,...]`: a simulated camera films a simulated ball; keys as in `spheremouse simulate`.

For example `synthetic:motion=play,seconds=10,noise=5`; lists in brackets, as in `size=[1280,960]`.
"""

import re

from spheremouse.capture import Stream, paced
from spheremouse.files.config import override
from spheremouse.simulate.ball.film import Simulation, SimulationOptions, prepare, simulate


def open(argument: str, realtime: bool) -> Stream:
    """The frames of a simulation, and the rig that it films."""
    simulation = check(argument)
    frames = (made.frame for made in simulate(simulation))
    return Stream(
        paced(frames) if realtime else frames,
        rig=simulation.scene.rig(),
        fps=simulation.fps,
        count=simulation.frames,
    )


def check(argument: str) -> Simulation:
    """The simulation, nothing rendered yet; ConfigurationError where the argument is of no use."""
    options = SimulationOptions()
    for item in re.split(r",(?![^\[]*\])", argument):
        if item.strip():
            options = override(options, item, label="synthetic: ")
    return prepare(options, named=lambda field: f"synthetic: {field}")
