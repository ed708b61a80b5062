"""The hand-held balls of `calibration/wand/`, of which the program knows Grzonka's alone."""

from pathlib import Path

from spheremouse.files.wand import load_wand
from spheremouse.wand.ball import WandBall

GIVEN = Path(__file__).parents[3] / "calibration/wand"


def contrast_ball() -> WandBall:
    """A ball with dark discs on white at uneven places, after Grzonka 2005 (section 5.2, figure 25)."""
    return load_wand(GIVEN / "contrast.yaml").ball


def led_ball() -> WandBall:
    """A black ball with lit discs (LEDs behind diffusers) at the same places."""
    return load_wand(GIVEN / "led.yaml").ball
