"""User-defined residual: calls, checks of shapes, flattening.

Functions such as ``math.sqrt`` raise outside their domain where NumPy returns nan. Both mean that
the residual has no value there. Only the first call, which counts the residuals, is to succeed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bundle.base.arguments import as_array
from bundle.base.words import plural
from bundle.checking.jacobian_deviation import Array
from bundle.errors import InputError

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

    def evaluate(self, blocks: Sequence[Array]) -> tuple[Array, Array]:
        """Return the residual (R,) and the Jacobians of all blocks, concatenated to (R, N).

        Raises:
            InputError: the returned values have wrong shapes.
        """
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
        """Return residual and Jacobians; None outside the function's domain."""
        try:
            return self._call(blocks)
        except InputError:
            raise
        except (ArithmeticError, ValueError):
            return None

    def _call(self, blocks: Sequence[Array]) -> tuple[Any, Sequence[Any]]:
        answer = self.function([block.copy() for block in blocks])
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
