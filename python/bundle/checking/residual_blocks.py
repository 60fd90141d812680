"""Parameter blocks of a user-defined residual: manifolds, names of columns, sample points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.checking.columns import Block, Column
from bundle.checking.jacobian_deviation import Array
from bundle.checking.manifolds import Manifold, ManifoldLike
from bundle.errors import InputError, brief

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
    """Mask (N,) of columns whose numbers are steps from a value instead of the value itself; ()
    without such columns.
    """

    @staticmethod
    def make(
        start: Sequence[Array],
        manifolds: Sequence[ManifoldLike] | None,
        names: Sequence[Name] | None,
    ) -> Layout:
        """Return the layout of blocks.

        Raises:
            InputError: manifolds or names do not match the blocks.
        """
        count = len(start)
        for what, given in (("manifolds", manifolds), ("names", names)):
            if given is not None and not isinstance(given, list | tuple):
                raise InputError(f"{what}: expected a list, one per block, found {brief(given)}")
        manifolds = [None] * count if manifolds is None else list(manifolds)
        names = [f"block {b}" for b in range(count)] if names is None else list(names)
        for what, given in (("manifolds", manifolds), ("names", names)):
            if len(given) != count:
                raise InputError(f"{what}: expected {count}, one per block, found {len(given)}")
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
