"""User-defined residual: calls, checks of shapes, and the points at which it is checked.

Functions such as ``math.sqrt`` raise outside their domain where NumPy returns nan. Both mean that
the residual has no value there. Only the first call, which counts the residuals, must succeed.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.base.arrays import as_array, check_type
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.checking.classify import rounds_to_single
from bundle.checking.jacobian_deviation import Array, JacobianDeviation
from bundle.checking.residual_blocks import Layout
from bundle.checking.step_curve import Line, acquitted, walk
from bundle.checking.tally import CHECKER_PRECISION
from bundle.errors import InputError, brief

ResidualFunction = Callable[[list[Array]], tuple[Any, Sequence[Any]]]


class UserFunction:
    """Function of parameter blocks that returns residual and Jacobians.

    If the number of residuals is not given, the function is called once to find it.
    """

    def __init__(
        self, function: ResidualFunction, blocks: Sequence[Array], num_residuals: int = 0
    ) -> None:
        self.function = function
        self.sizes = [len(block) for block in blocks]
        self.num_residuals = num_residuals or len(self._residual(self._call(blocks)[0]))

    @staticmethod
    def check_call(function: Any, blocks: Any) -> None:
        """Refuse a function that does not take one list, and blocks that are no list of arrays."""
        check_type("function", function, Callable, "a function")
        is_vector = isinstance(blocks, np.ndarray) and blocks.ndim < 2  # one block or several?
        is_list = isinstance(blocks, Iterable) and not isinstance(blocks, str | bytes | Mapping)
        if is_vector or not is_list:
            hint = "; try [blocks]" if is_vector else ""
            raise InputError(f"blocks: expected a list of arrays, found {brief(blocks)}{hint}")
        try:
            inspect.signature(function).bind(blocks)
        except TypeError as error:
            raise InputError(
                f"function: expected one argument, the list of blocks: {error}"
            ) from None
        except ValueError:
            pass  # compiled functions have no signature

    def evaluate(self, blocks: Sequence[Array]) -> tuple[Array, Array]:
        """Return the residual (R,) and the Jacobians of all blocks, concatenated to (R, N)."""
        answer = self._inside(blocks)
        if answer is None:
            return np.full(self.num_residuals, np.nan), np.full(
                (self.num_residuals, sum(self.sizes)), np.nan
            )
        residual, jacobians = answer
        values = self._residual(residual)
        if len(values) != self.num_residuals:
            raise InputError(
                f"function: expected {plural(self.num_residuals, 'residual')} as in earlier "
                f"calls, found {len(values)}"
            )
        return values, np.hstack(self._jacobians(jacobians))

    def core(self, blocks: list[Array], jacobians: bool) -> tuple[Array, list[Array] | None] | None:
        """Return the values for ``_core``; None if the residual is not finite."""
        answer = self._inside(blocks)
        if answer is None:
            return None
        residual, matrices = answer
        values = self._residual(residual)
        if not np.isfinite(values).all():
            return None
        return values, self._jacobians(matrices) if jacobians else None

    def _inside(self, blocks: Sequence[Array]) -> tuple[Any, Sequence[Any]] | None:
        try:
            return self._call(blocks)
        except InputError:
            raise
        except (ArithmeticError, ValueError):
            return None

    def _call(self, blocks: Sequence[Array]) -> tuple[Any, Sequence[Any]]:
        given = [block.copy() for block in blocks]
        answer = self.function(given)
        check_unchanged("function", given, blocks)
        if not isinstance(answer, tuple | list) or len(answer) != 2:
            raise InputError(
                f"function: expected (residual, list of Jacobians), found {type(answer).__name__}"
            )
        residual, jacobians = answer
        if not isinstance(jacobians, list | tuple | np.ndarray):
            raise InputError(
                f"function: expected a list of Jacobians, found {type(jacobians).__name__}"
            )
        if isinstance(jacobians, np.ndarray) and jacobians.ndim == 0:
            raise InputError("function: expected a list of Jacobians, found a single number")
        return residual, list(jacobians)

    @staticmethod
    def _residual(residual: Any) -> Array:
        values = as_array("function: residual", residual).reshape(-1).copy()
        if not len(values):
            raise InputError("function: expected at least one residual, found 0")
        return values

    def _jacobians(self, jacobians: Sequence[Any]) -> list[Array]:
        if len(jacobians) != len(self.sizes):
            raise InputError(
                f"function: expected {plural(len(self.sizes), 'Jacobian')}, one per block, "
                f"found {len(jacobians)}"
            )
        result = []
        for b, (jacobian, size) in enumerate(zip(jacobians, self.sizes, strict=True)):
            matrix = as_array(f"function: Jacobian {b}", jacobian)
            expected = (self.num_residuals, size)
            if matrix.shape != expected and not (
                matrix.ndim == 1 and matrix.size == size and self.num_residuals == 1
            ):
                hint = " (transposed?)" if matrix.shape == expected[::-1] else ""
                raise InputError(
                    f"function: expected Jacobian {b} of shape {expected}, "
                    f"found {matrix.shape}{hint}"
                )
            result.append(matrix.reshape(expected))
        return result


def check_unchanged(name: str, given: Sequence[Array], before: Sequence[Array]) -> None:
    """Raise an InputError if a call has changed its arguments."""
    for b, (one, other) in enumerate(zip(given, before, strict=True)):
        if one.tobytes() != other.tobytes():
            raise InputError(
                f"{name}: expected a function that does not change its arguments, found block {b} "
                "changed by a call; compute with a copy of it"
            )


Probe = tuple[bool, Array | None, Array | None, str]


@dataclass(frozen=True, eq=False)
class SamplePoint:
    """Values of the blocks at which a function is checked; each point may have its own function."""

    user: UserFunction
    blocks: list[Array]

    def evaluate(self) -> tuple[Array, Array]:
        """Return the residual (R,) and the Jacobians of all blocks, concatenated to (R, N)."""
        return self.user.evaluate(self.blocks)

    def reference(
        self, manifolds: list[tuple[str, list[int]]], minuends: Sequence[float] = ()
    ) -> Any:
        """Return the result of Richardson extrapolation.

        ``minuends``: size of the numbers whose difference is each residual, if known: their
        rounding errors are also those of the residual.
        """
        return _core.richardson_jacobian(
            self.user.core, self.user.num_residuals, self.blocks, manifolds, list(minuends)
        )

    def rounds_to_single(self) -> bool:
        """Return True if the function rounds a parameter to single precision."""
        return rounds_to_single(lambda blocks: self.user.evaluate(blocks)[0], self.blocks)

    def probe(self, manifolds: list[tuple[str, list[int]]]) -> Probe:
        """Return the result of ceres::GradientChecker."""
        return _core.gradient_checker(
            self.user.core, self.user.num_residuals, self.blocks, manifolds, CHECKER_PRECISION
        )

    def reference_without(
        self, parameter: int, manifolds: list[tuple[str, list[int]]]
    ) -> Array | None:
        """Return the reference with one parameter set to zero; None if it has none there."""
        flat = np.concatenate(self.blocks)
        flat[parameter] = 0.0
        there = SamplePoint(self.user, np.split(flat, np.cumsum(self.user.sizes)[:-1]))
        try:
            if self.user.core(there.blocks, False) is None:
                return None
            values, uncertainty, *_ = there.reference(manifolds)
        except Exception:  # the user's function may fail at a zero that it never meets
            return None
        return values if np.isfinite(uncertainty).all() else None


@dataclass(frozen=True, eq=False)
class SampleLines:
    """Sample points with their residuals; lines through them along columns of the Jacobian."""

    samples: Sequence[SamplePoint]
    residuals: Sequence[Array]
    layout: Layout

    def appealed(
        self,
        deviations: JacobianDeviation,
        samples: Sequence[int],
        tolerance: float,
        *,
        along_manifold: bool,
    ) -> JacobianDeviation:
        """Return the deviations; a derivative at another scale makes an entry undecided."""
        wrong = deviations.error > tolerance
        if not wrong.any():
            return deviations
        uncertainty = deviations.uncertainty.copy()
        off = np.abs(deviations.analytic - deviations.reference)
        for k, j in zip(*np.nonzero(wrong.any(axis=1)), strict=True):
            if not np.isfinite(deviations.analytic[k, :, j]).all():
                continue
            line = self.line(samples[k], int(j), along_manifold=along_manifold)
            scale = deviations.scale[k, :, j]
            found = acquitted(line, deviations.analytic[k, :, j], off[k, :, j], scale)
            found &= wrong[k, :, j]
            uncertainty[k, found, j] += off[k, found, j]
        return JacobianDeviation(
            deviations.analytic, deviations.reference, uncertainty, deviations.tolerance
        )

    def line(self, sample: int, column: int, *, along_manifold: bool) -> Line:
        """Return the residuals at steps along a column of the Jacobian."""
        at = self.samples[sample]
        manifolds = self.layout.manifolds
        sizes = [m.tangent_size if along_manifold else m.size for m in manifolds]
        b = int(np.searchsorted(np.cumsum(sizes), column, side="right"))
        direction = np.zeros(sizes[b])
        direction[column - sum(sizes[:b])] = 1.0
        is_curved = along_manifold and manifolds[b].is_curved

        def values(step: float) -> Array | None:
            blocks = [block.copy() for block in at.blocks]
            move = step * direction
            blocks[b] = manifolds[b].plus(blocks[b], move) if is_curved else blocks[b] + move
            answer = at.user.core(blocks, False)
            return None if answer is None else answer[0]

        size = 1.0 if is_curved else float(at.blocks[b] @ direction)
        return walk(values, self.residuals[sample], size)
