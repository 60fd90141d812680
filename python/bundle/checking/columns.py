"""What the columns of a Jacobian are: names, groups, blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bundle.checking.jacobian_deviation import Array

__all__ = ["Block", "Column"]


@dataclass(frozen=True)
class Column:
    """One parameter: what a report calls it, and the group that gets a verdict with it."""

    name: str
    group: str


@dataclass(frozen=True, eq=False)
class Block:
    """Columns that lie side by side in memory, `start` to `stop`.

    ``rotation`` is "" or says how the columns turn: "tangent" (a manifold's increment), "vector"
    (the numbers of a rotation vector, whose values the points hold) or "quaternion".
    ``conventions`` are other tangent coordinates that one may have differentiated by: words, and
    for each sample the matrix by which the right columns become those (samples, size, size).
    """

    name: str
    start: int
    stop: int
    rotation: str = ""
    conventions: Mapping[tuple[str, str], Array] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of columns."""
        return self.stop - self.start

    @property
    def columns(self) -> range:
        """Indices of the columns."""
        return range(self.start, self.stop)
