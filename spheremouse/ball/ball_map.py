"""The knowledge of a ball that a run passes on to the next one: its discs, or a picture of its pattern."""

from typing import ClassVar, Protocol, Self

from spheremouse.geometry.rotation import Array


class MapComparison(Protocol):
    """Comparison of map `a` with map `b`."""

    @property
    def rotation(self) -> Array:
        """(3, 3), directions of b ~ those of a @ rotation.T."""
        ...

    @property
    def same_ball(self) -> bool:
        """Return whether both show the same ball."""
        ...

    @property
    def text(self) -> str:
        """Equal and different parts, in words."""
        ...


class BallMap(Protocol):
    """A map in the frame `ball`. Only maps of one kind are compared."""

    kind: ClassVar[str]  # what it shows, in words
    alteration: ClassVar[str]  # why that of the same ball may have changed, in words

    @property
    def amount(self) -> float:
        """Measure of its contents, for a comparison with other maps."""
        ...

    @property
    def text(self) -> str:
        """The contents in words."""
        ...

    @property
    def is_finite(self) -> bool:
        """Return whether all its numbers are finite."""
        ...

    def compare(self, other: Self) -> MapComparison | None:
        """Compare with another map in any frame. Return None if they show no sign of the same ball."""
        ...

    def compare_at(self, other: Self, rotation: Array) -> MapComparison:
        """Compare with another map, whose directions are about those of this one @ rotation.T, (3, 3)."""
        ...

    def improves(self, saved: Self) -> bool:
        """Return whether it holds more than a saved map, so that it is worth saving."""
        ...

    def turned(self, rotation: Array) -> Self:
        """Return the map in a frame rotated by (3, 3): the new directions are the old ones @ rotation.T."""
        ...
