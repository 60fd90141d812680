"""Columns of a Jacobian: names, groups, blocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from bundle.base.records import dataclass
from bundle.checking.jacobian_deviation import Array


@dataclass(frozen=True)
class Column:
    """A parameter: its name in reports, and the group of its verdict."""

    name: str
    group: str


@dataclass(frozen=True, eq=False)
class Block:
    """Adjacent columns, `start` to `stop` (exclusive).

    ``rotation`` is "" or the kind of rotation: "tangent" (a manifold's increment), "vector" (the
    numbers of a rotation vector, whose values are in the points) or "quaternion". ``conventions``
    lists other tangent coordinates by which users may differentiate. Each entry has a description
    and, for each sample, the matrix from the correct columns to these columns (samples, size,
    size).
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
