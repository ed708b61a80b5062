"""Options that describe a simulated camera, as a person types them."""

from spheremouse.errors import ConfigurationError
from spheremouse.files.pictures import FRAME_PIXELS

_LARGEST = 8192  # px, a side


def parse_size(text: str, least: int, example: str) -> tuple[int, int]:
    """Width and height in px of `640x480`; ConfigurationError where a side is below `least`."""
    width, _, height = text.lower().partition("x")
    fits = all(side.isdecimal() and len(side) < 10 and least <= int(side) <= _LARGEST for side in (width, height))
    if fits and int(width) * int(height) > FRAME_PIXELS:
        raise ConfigurationError(
            f"--size {text}: at most {FRAME_PIXELS // 1_000_000} megapixels (8K) can be read again"
        )
    if not fits:
        raise ConfigurationError(
            f"--size {text}: write WIDTHxHEIGHT in px, as in {example}, each from {least} to {_LARGEST}"
        )
    return int(width), int(height)


def parse_distortion(text: str, example: str) -> tuple[float, float, float, float, float]:
    """k1, k2, p1, p2, k3 of five numbers with commas."""
    try:
        k1, k2, p1, p2, k3 = (float(part) for part in text.split(","))
        if not all(abs(k) <= 2.0 for k in (k1, k2, p1, p2, k3)):  # nan, too: no lens bends more
            raise ValueError(text)
    except ValueError:
        raise ConfigurationError(
            f"--dist {text}: write five numbers k1,k2,p1,p2,k3 from -2 to 2, as in {example}"
        ) from None
    return k1, k2, p1, p2, k3
