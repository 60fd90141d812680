"""What the columns of a Jacobian are: names, groups, blocks."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Block", "Column"]


@dataclass(frozen=True)
class Column:
    """One parameter: what a report calls it, and the group that gets a verdict with it."""

    name: str
    group: str


@dataclass(frozen=True)
class Block:
    """Columns that lie side by side in memory, `start` to `stop`.

    ``rotation`` is "" or says how the columns turn: "tangent" (a manifold's increment), "vector"
    (the numbers of a rotation vector, whose values the points hold) or "quaternion".
    """

    name: str
    start: int
    stop: int
    rotation: str = ""

    @property
    def size(self) -> int:
        """Number of columns."""
        return self.stop - self.start

    @property
    def columns(self) -> range:
        """Indices of the columns."""
        return range(self.start, self.stop)
