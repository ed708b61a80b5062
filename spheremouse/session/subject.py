"""The subject of a recording: its description, and the part of the pictures that is kept."""

from typing import Any, Protocol

from spheremouse.geometry.camera import InteriorOrientation
from spheremouse.session.overlay.pen import Image


class Subject(Protocol):
    """A tracker's ball before its camera; another one as soon as the camera stands elsewhere."""

    @property
    def camera(self) -> InteriorOrientation:
        """The camera, with the size of its pictures."""
        ...

    @property
    def view(self) -> object:
        """The same as long as the camera stands."""
        ...

    @property
    def parts(self) -> str:
        """The kept part of a picture, in words; empty if the whole picture is needed."""
        ...

    def kept(self) -> Image:
        """255 where a recording keeps a pixel, 0 where it is black, (h, w) uint8. Raises PoseError without a ball."""
        ...

    def scene(self) -> dict[str, Any]:
        """Return the contents of scene.json."""
        ...

    def files(self) -> dict[str, str]:
        """Further files of the dataset, name and text: what tracks it again as it is tracked now."""
        ...
