"""User-defined residual: calls, and checks of what it returns.

Functions such as ``math.sqrt`` raise outside their domain where NumPy returns nan. Both mean that
the residual has no value there. Only the first call, which counts the residuals, must succeed.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import as_array, check_type
from bundle.base.words import plural
from bundle.errors import InputError, brief

Array = NDArray[np.float64]
ResidualFunction = Callable[[list[Array]], tuple[Any, Sequence[Any]]]


class UserFunction:
    """Function of several arrays that returns a residual and Jacobians; checks what it returns.

    ``sizes``: columns of each Jacobian. ``name``: beginning of messages. ``labels``: names of the
    Jacobians in messages. ``is_vector``: refuse a residual of several rows and columns.
    """

    def __init__(
        self,
        function: Callable[[list[Array]], Any],
        sizes: Sequence[int],
        name: str = "function",
        labels: Sequence[str] = (),
        is_vector: bool = False,
    ) -> None:
        self.function, self.sizes, self.name, self.is_vector = function, sizes, name, is_vector
        self.labels = labels or [f"Jacobian {b}" for b in range(len(sizes))]
        self.num_residuals = 0

    @classmethod
    def at(
        cls, function: ResidualFunction, blocks: Sequence[Array], num_residuals: int = 0
    ) -> Self:
        """Return a function of blocks, called once if the number of residuals is not given."""
        user = cls(function, [len(block) for block in blocks])
        user.num_residuals = num_residuals
        if not num_residuals:
            user._parts(called(user.name, function, blocks))
        return user

    @staticmethod
    def check_call(function: Any, blocks: Any) -> None:
        """Refuse a function that does not take one list, and blocks that are no list of arrays."""
        check_type("function", function, Callable, "a function")
        is_vector = isinstance(blocks, np.ndarray) and blocks.ndim < 2  # one block or several?
        is_list = isinstance(blocks, Iterable) and not isinstance(blocks, str | bytes | Mapping)
        if is_vector or not is_list:
            joined = "; try lambda b: (residual(b[0]), [jacobian(b[0])])" * callable(blocks)
            hint = "; try [blocks]" if is_vector else joined
            raise InputError(f"blocks: expected a list of arrays, found {brief(blocks)}{hint}")
        try:
            inspect.signature(function).bind(blocks)
        except TypeError as error:
            raise InputError(f"function: expected one argument, the blocks: {error}") from None
        except ValueError:
            pass  # compiled functions have no signature

    def __call__(
        self, values: list[Array], jacobians: bool
    ) -> tuple[Array, list[Array] | None] | None:
        """Return residual and Jacobians for ``_core``; None if the residual is not finite."""
        return self._finite(self.function(values), jacobians)

    def core(self, blocks: list[Array], jacobians: bool) -> tuple[Array, list[Array] | None] | None:
        """Return the same, and None where the function has no value."""
        answer = self._inside(blocks)
        found = None if answer is None else self._finite(answer, jacobians)
        return None if found is None else (found[0].copy(), found[1])  # of a buffer used again

    def evaluate(self, blocks: Sequence[Array]) -> tuple[Array, Array]:
        """Return the residual (R,) and the Jacobians of all blocks, concatenated to (R, N)."""
        answer = self._inside(blocks)
        if answer is None:
            size = self.num_residuals
            return np.full(size, np.nan), np.full((size, sum(self.sizes)), np.nan)
        residual, jacobians = self._parts(answer)
        return residual.copy(), np.hstack(self._jacobians(jacobians))

    def _finite(self, answer: Any, jacobians: bool) -> tuple[Array, list[Array] | None] | None:
        residual, given = self._parts(answer)
        if not np.isfinite(residual).all():
            return None
        return residual, self._jacobians(given) if jacobians else None

    def _inside(self, blocks: Sequence[Array]) -> Any:
        try:
            return called(self.name, self.function, blocks)
        except InputError:
            raise
        except (ArithmeticError, ValueError):
            return None

    def _parts(self, answer: Any) -> tuple[Array, Any]:
        """Return the residual (R,), and the Jacobians as they are."""
        if not isinstance(answer, tuple | list) or len(answer) != 2:
            raise InputError(
                f"{self.name}: expected (residual, list of Jacobians), "
                f"found {type(answer).__name__}"
            )
        residual = as_array(f"{self.name}: residual", answer[0])
        if self.is_vector and residual.size != max(residual.shape, default=1):
            raise InputError(
                f"{self.name}: residual: expected a 1-D array of numbers, found shape "
                f"{residual.shape}"
            )
        residual = residual.reshape(-1)
        if not len(residual):
            raise InputError(f"{self.name}: expected at least one residual, found 0")
        self.num_residuals = self.num_residuals or len(residual)
        if len(residual) != self.num_residuals:
            raise InputError(
                f"{self.name}: expected {plural(self.num_residuals, 'residual')} as in earlier "
                f"calls, found {len(residual)}"
            )
        return residual, answer[1]

    def _jacobians(self, given: Any) -> list[Array]:
        is_list = isinstance(given, list | tuple) or (isinstance(given, np.ndarray) and given.ndim)
        if not is_list or len(given) != len(self.sizes):
            is_one = len(self.sizes) == 1 and getattr(given, "ndim", 0) == 2
            raise InputError(
                f"{self.name}: expected {plural(len(self.sizes), 'Jacobian')}, one per variable, "
                f"found {len(given) if is_list else brief(given)}{'; try [jacobian]' * is_one}"
            )
        matrices = []
        for label, size, jacobian in zip(self.labels, self.sizes, given, strict=True):
            place = f"{self.name}: {label}"
            matrix = as_array(place, jacobian)
            expected = (self.num_residuals, size)
            if matrix.ndim == 1 and self.num_residuals == 1:
                matrix = matrix.reshape(1, -1)
            if matrix.shape != expected:
                is_tangent = size in (4, 7) and matrix.shape == (self.num_residuals, size - 1)
                hint = " (transposed?)" * (matrix.shape == expected[::-1])
                hint += "; tangent='gtsam' takes tangent coordinates" * is_tangent
                raise InputError(f"{place}: expected shape {expected}, found {matrix.shape}{hint}")
            matrices.append(matrix)
        return matrices


def called(name: str, function: Callable[[list[Array]], Any], blocks: Sequence[Array]) -> Any:
    """Call a function with copies of the blocks; refuse changes of its arguments."""
    given = [block.copy() for block in blocks]
    answer = function(given)
    for b, (one, other) in enumerate(zip(given, blocks, strict=True)):
        if one.tobytes() != other.tobytes():
            raise InputError(
                f"{name}: expected a function that does not change its arguments, found block {b} "
                "changed by a call; compute with a copy of it"
            )
    return answer
