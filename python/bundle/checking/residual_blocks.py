"""Parameter blocks of a user-defined residual: manifolds, names of columns, sample points."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import check_type, refuse_row
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.checking.jacobian_deviation import Array
from bundle.errors import InputError, brief
from bundle.interface.option_fields import choice

Name = str | tuple[str, Sequence[str]]


@dataclass(frozen=True)
class Layout:
    """Names of the columns, for the parameters and for the tangent space."""

    manifolds: list[Manifold]
    columns: list[Column]
    tangent_columns: list[Column]
    blocks: list[Block]
    tangent_blocks: list[Block]
    is_step: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    """Mask (N,) of columns whose numbers are increments of a value instead of the value; () without
    such columns.
    """

    @staticmethod
    def make(
        start: Sequence[Array],
        manifolds: Sequence[ManifoldLike] | None,
        names: Sequence[Name] | None,
    ) -> Layout:
        """Return the layout of blocks."""
        count = len(start)
        for what, given in (("manifolds", manifolds), ("names", names)):
            check_type(what, given, list | tuple | None, "a list, one per block")
            if given is not None and len(given) != count:
                raise InputError(f"{what}: expected {count}, one per block, found {len(given)}")
        manifolds = [None] * count if manifolds is None else list(manifolds)
        names = [f"block {b}" for b in range(count)] if names is None else list(names)
        layout = Layout([], [], [], [], [])
        for block, manifold, name in zip(start, manifolds, names, strict=True):
            layout._add(Manifold.parse(manifold, len(block)), name)
        return layout

    def _add(self, manifold: Manifold, name: Name) -> None:
        if isinstance(name, str):
            group, parameters = name, manifold.parameter_names(name)
        elif (
            isinstance(name, tuple | list) and len(name) == 2 and isinstance(name[1], list | tuple)
        ):
            group, parameters = str(name[0]), [*map(str, name[1])]
        else:
            raise InputError(
                f"names: expected a name or (name, names of its parameters), found {brief(name)}"
            )
        if len(parameters) != manifold.size:
            raise InputError(
                f"names: expected {plural(manifold.size, 'name')} for {group}, "
                f"found {len(parameters)}"
            )
        self.manifolds.append(manifold)
        self.blocks.extend(manifold.blocks(group, len(self.columns), tangent=False))
        self.tangent_blocks.extend(manifold.blocks(group, len(self.tangent_columns), tangent=True))
        self.columns.extend(Column(parameter, group) for parameter in parameters)
        self.tangent_columns.extend(
            Column(parameter, group) for parameter in manifold.tangent_names(group, parameters)
        )

    @property
    def core(self) -> list[tuple[str, list[int]]]:
        """Manifolds in the format of ``_core``."""
        return [manifold.core for manifold in self.manifolds]

    @property
    def is_curved(self) -> bool:
        """True if tangent coordinates of some block differ from its parameters."""
        return any(manifold.is_curved for manifold in self.manifolds)


def sample(manifold: Manifold, x: Array, radius: float, rng: np.random.Generator) -> Array:
    """Return a random point near x."""
    if manifold.is_curved and manifold.name not in ("subset", "se3"):
        return manifold.plus(x, radius * rng.standard_normal(manifold.tangent_size))
    if manifold.name == "angle_axis":
        return x + radius * rng.standard_normal(3)
    sizes = np.abs(x)
    nonzero = sizes[sizes > 0]
    usual = min(1.0, float(nonzero.min())) if len(nonzero) else 1.0
    delta: Array = radius * np.where(sizes > 0, sizes, usual) * rng.standard_normal(len(x))
    if manifold.name == "subset":
        delta[list(manifold.constant)] = 0
    if manifold.name == "se3":
        turned = manifold.plus(x, np.append(radius * rng.standard_normal(3), np.zeros(3)))
        delta[:4] = 0
        return turned + delta
    return x + delta


ManifoldLike = str | tuple[str, Sequence[int]] | None

NAMES = (
    "euclidean",
    "angle_axis",
    "quaternion_wxyz",
    "quaternion_xyzw",
    "se3",
    "sphere",
    "subset",
)

_PARAMETERS = {
    "quaternion_wxyz": ("qw", "qx", "qy", "qz"),
    "quaternion_xyzw": ("qx", "qy", "qz", "qw"),
    "se3": ("qx", "qy", "qz", "qw", "tx", "ty", "tz"),
    "angle_axis": ("rotation x", "rotation y", "rotation z"),
}
_TANGENT = {
    "quaternion_wxyz": ("rotation x", "rotation y", "rotation z"),
    "quaternion_xyzw": ("rotation x", "rotation y", "rotation z"),
    "se3": (
        "rotation x", "rotation y", "rotation z", "translation x", "translation y", "translation z",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Manifold:
    """Manifold of one block."""

    name: str  # name in lower case
    constant: tuple[int, ...]  # constant entries of "subset"
    size: int  # size of the block
    tangent_size: int  # dimension of the tangent space

    @staticmethod
    def parse(given: ManifoldLike, size: int) -> Manifold:
        """Return the manifold with a name."""
        pair = given if isinstance(given, tuple) else (given or "euclidean", ())
        if len(pair) != 2:
            raise InputError(f"manifolds: expected a name or (name, entries), found {brief(given)}")
        if str(pair[0]).lower() in ("so2", "so3", "se2"):  # of factor graphs
            raise InputError(
                'manifolds: expected tangent="gtsam" or another library as well, the one whose '
                f"coordinates the Jacobians have, found {pair[0]!r} alone"
            )
        name = choice("manifolds", pair[0], NAMES)
        try:
            entries = tuple(operator.index(entry) for entry in pair[1])
        except TypeError:
            raise InputError(
                f"manifolds: expected the constant entries, found {brief(pair[1])}"
            ) from None
        refuse_row(
            [not 0 <= entry < size for entry in entries],
            lambda k: f"manifolds: expected entries from 0 to {size - 1}, found {entries[k]}",
        )
        if name == "angle_axis" and size != 3:
            raise InputError(f"manifolds: angle_axis expects a block of 3 numbers, found {size}")
        core = (_core_name(name), list(entries))
        return Manifold(name, entries, size, _core.manifold_tangent_size(core, size))

    @property
    def core(self) -> tuple[str, list[int]]:
        """Arguments of ``_core``; for Ceres, a rotation vector is a vector space."""
        return _core_name(self.name), list(self.constant)

    @property
    def is_curved(self) -> bool:
        """True if tangent coordinates differ from the parameters."""
        return self.core[0] != "euclidean"

    def plus(self, x: Array, delta: Array) -> Array:
        """Return x plus a tangent vector ``delta`` (Ceres' Plus)."""
        return _core.manifold_plus(self.core, x, np.ascontiguousarray(delta))

    def parameter_names(self, block: str) -> list[str]:
        """Return names for the parameters of a block."""
        if self.size == 1:
            return [block]
        names = _PARAMETERS.get(self.name)
        return [f"{block} {n}" for n in names or [f"[{j}]" for j in range(self.size)]]

    def tangent_names(self, block: str, parameters: Sequence[str]) -> list[str]:
        """Return names for the tangent directions of a block."""
        if not self.is_curved:
            return list(parameters)
        if self.name == "subset":
            return [name for j, name in enumerate(parameters) if j not in self.constant]
        names = _TANGENT.get(self.name)
        return [f"{block} {n}" for n in names or [f"direction {j}" for j in range(self.size - 1)]]

    def blocks(self, name: str, start: int, *, tangent: bool) -> list[Block]:
        """Return the block and its sub-blocks for the signatures; `start` is the first column."""
        size = self.tangent_size if tangent else self.size
        blocks = [Block(name, start, start + size)]
        if self.name == "angle_axis":
            return [Block(name, start, start + 3, "vector")]
        if self.name.startswith("quaternion"):
            return [Block(name, start, start + size, "tangent" if tangent else "quaternion")]
        if self.name == "se3":
            split = start + (3 if tangent else 4)
            kind = "tangent" if tangent else "quaternion"
            blocks += [
                Block(f"{name} rotation", start, split, kind),
                Block(f"{name} translation", split, split + 3),
            ]
            return blocks[1:] + blocks[:1]
        return blocks


def _core_name(name: str) -> str:
    return "euclidean" if name == "angle_axis" else name


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
