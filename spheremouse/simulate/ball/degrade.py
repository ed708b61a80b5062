"""Films made worse after the event: noise and light (Wittich 2017, section 4.9)."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from spheremouse.tracker import Frame

_SEED = 0  # of the noise added: the same frame gets the same noise in every run


def degraded(frames: Iterator[Frame], noise: float, brightness: float) -> Iterator[Frame]:
    """Frames with normal noise on every channel and a constant added (Wittich 2017, section 4.9), 8 bits again."""
    for frame in frames:
        if noise == 0.0 and brightness == 0.0:
            yield frame
            continue
        rng = np.random.default_rng([_SEED, frame.sequence])
        values = frame.image + np.float32(brightness)
        if noise:
            values += np.float32(noise) * rng.standard_normal(values.shape, dtype=np.float32)
        yield replace(frame, image=np.clip(np.rint(values), 0, 255).astype(np.uint8))
