"""Manifolds of parameter blocks, by their names in the API."""

from __future__ import annotations

import operator
from collections.abc import Sequence

import numpy as np

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.checking.columns import Block
from bundle.checking.jacobian_deviation import Array
from bundle.errors import InputError, brief
from bundle.interface.option_fields import choice

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
    """Manifold of one block.

    Attributes:
        name: name in lower case.
        constant: constant entries of "subset".
        size: size of the block.
        tangent_size: dimension of the tangent space.
    """

    name: str
    constant: tuple[int, ...]
    size: int
    tangent_size: int

    @staticmethod
    def parse(given: ManifoldLike, size: int) -> Manifold:
        """Return the manifold with a name.

        Raises:
            InputError: the manifold does not exist, or it does not match a block of this size.
        """
        pair = given if isinstance(given, tuple) else (given or "euclidean", ())
        if len(pair) != 2:
            raise InputError(f"manifolds: expected a name or (name, entries), found {brief(given)}")
        name = choice("manifolds", pair[0], NAMES)
        try:
            entries = tuple(operator.index(entry) for entry in pair[1])
        except TypeError:
            raise InputError(
                f"manifolds: expected the constant entries, found {brief(pair[1])}"
            ) from None
        for entry in entries:
            if not 0 <= entry < size:
                raise InputError(f"manifolds: expected entries from 0 to {size - 1}, found {entry}")
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
