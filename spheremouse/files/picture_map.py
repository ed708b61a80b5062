"""The text of a map of a pattern: its header, and the picture as one block of base64.

The block is large, so the reader of YAML does not see it. zlib (RFC 1950) has compressed it, with a checksum. It holds
the fine and then the coarse picture, cells by face, row and column. First come the contrasts in units of 1/1024, as 16
bits in two's complement, all low bytes before all high bytes. Then come the weights in units of 1/8 as a byte.
"""

import base64
import zlib
from typing import Annotated

import numpy as np
from pydantic import Field

from spheremouse.ball.texture.picture import Picture
from spheremouse.ball.texture.picture_map import PictureMap, with_known
from spheremouse.ball.texture.view import COARSEST, FINEST, TILE
from spheremouse.files.disc_map import LandmarksFile, landmark_lines, landmark_problems, landmarks
from spheremouse.files.validate import validate
from spheremouse.files.yaml import Document, Problem, without_schema

_VALUE, _WEIGHT = 1.0 / 1024.0, 1.0 / 8.0  # of a contrast; of a view
_MAX_LINE_CHARACTERS = 120  # characters

Share = Annotated[float, Field(ge=0, le=1)]
Cells = Annotated[int, Field(ge=COARSEST, le=FINEST, multiple_of=TILE)]


class PictureMapFile(LandmarksFile):
    noise: float = Field(gt=0, lt=10, description="standard deviation of a contrast in one view")
    correlation: Share = Field(description="usual correlation of a frame with the picture")
    details: Share = Field(description="usual part of a frame that shows a detail")
    cells: tuple[Cells, Cells] = Field(description="cells along a face of the fine and of the coarse picture")


def lines(header: list[str], picture_map: PictureMap) -> list[str]:
    fine, coarse = picture_map.fine, picture_map.coarse
    data = b"".join(_pack(picture) for picture in (fine, coarse))
    block = base64.b64encode(zlib.compress(data)).decode()
    return [
        "# The pattern of one ball, as tracked. Written by spheremouse and read at the next start; without it a new",
        "# one is made as the ball turns. The cells are on the faces of a cube.",
        *header,
        f"noise: {float(picture_map.noise)!r}  # standard deviation of a contrast in one view",
        f"correlation: {float(picture_map.correlation)!r}  # usual one of a frame with the picture",
        f"details: {float(picture_map.details)!r}  # usual part of a frame that shows one",
        f"cells: [{fine.value.shape[1]}, {coarse.value.shape[1]}]  # along a face, fine and coarse",
        *landmark_lines(picture_map.parts),
        "picture: |",
        *(f"  {block[k : k + _MAX_LINE_CHARACTERS]}" for k in range(0, len(block), _MAX_LINE_CHARACTERS)),
    ]


def parse(document: Document, block: bytes) -> tuple[PictureMapFile, PictureMap]:
    """Return the content of a file and its map. Raise ConfigurationError with all problems."""
    file = validate(without_schema(document, "map"), PictureMapFile)
    problems, pictures = [*landmark_problems(file)], _unpack(block, file.cells)
    if pictures is None:
        problems.append(Problem((), "picture: is damaged, or has another number of cells"))
    if problems or pictures is None:
        raise document.error(problems)
    return file, PictureMap(*pictures, landmarks(file), file.noise, file.correlation, file.details)


def _pack(picture: Picture) -> bytes:
    """Return a picture as bytes that compress well: values by high and low bytes, then weights."""
    known = picture.weight > 0.5 * _WEIGHT
    value = np.where(known, np.clip(np.rint(picture.value / _VALUE), -32768, 32767), 0).astype("<i2")
    weight = np.clip(np.rint(picture.weight / _WEIGHT), 0, 255).astype(np.uint8)
    return value.reshape(-1).view(np.uint8).reshape(-1, 2).T.tobytes() + weight.tobytes()


def _unpack(block: bytes, cells: tuple[int, int]) -> tuple[Picture, Picture] | None:
    size = [6 * n * n for n in cells]
    try:
        reader = zlib.decompressobj()
        data = reader.decompress(base64.b64decode(b"".join(block.split()), validate=True), 3 * sum(size) + 1)
    except (ValueError, zlib.error):
        return None
    if len(data) != 3 * sum(size) or not reader.eof:
        return None
    found, at = [], 0
    for n, count in zip(cells, size, strict=True):
        low_high = np.frombuffer(data, np.uint8, 2 * count, at).reshape(2, count)
        value = np.ascontiguousarray(low_high.T).view("<i2").reshape(6, n, n) * _VALUE
        weight = np.frombuffer(data, np.uint8, count, at + 2 * count).reshape(6, n, n) * _WEIGHT
        found.append(with_known(value, weight))
        at += 3 * count
    return found[0], found[1]
