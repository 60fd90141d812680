"""Factor whose residual and Jacobians are a Python function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from bundle.base.arguments import as_array
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, brief
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.variables import Array, Key, as_keys, variable_name

FactorFunction = Callable[[list[Array]], tuple[Any, Sequence[Any]]]


@dataclass(frozen=True, eq=False, repr=False)
class FunctionFactor(Factor):
    """User-defined residual: ``function(values) -> (residual, jacobians)``.

    ``values`` is a list of arrays, one per key, in the manifold's representation: (n,) for
    "euclidean", (angle,) for "so2", (qx, qy, qz, qw) for "so3", (x, y, angle) for "se2", (qx, qy,
    qz, qw, tx, ty, tz) for "se3"; quaternions have norm 1. The function returns the whitened
    residual (m,) and a list of Jacobians, one per key. Jacobian k has shape (m, d) with d the
    tangent size of variable k. It is the derivative of the residual with respect to delta at delta
    = 0, where X moves to X Exp(delta):

    - "euclidean": delta (n) is added; this is the usual Jacobian;
    - "so2": delta (1) is added to the angle;
    - "so3": delta (3) is a rotation vector in the frame of X: R becomes R Exp(delta);
    - "se2": delta = (x, y, angle) in the frame of X: the translation t becomes t + R (x, y) to
      first order, and the angle grows by that of delta;
    - "se3": delta = (rotation (3), translation (3)) in the frame of X: R becomes R Exp(rotation),
      t becomes t + R translation to first order.

    Check Jacobians with :meth:`bundle.FactorGraph.check_gradients`. The function is called from the
    solving thread with the GIL held; a graph with such a factor is evaluated on one thread. An
    exception of the function ends the solve and is passed on.

    Attributes:
        keys: the variables.
        function: function of their values, as above. m must not change between calls. A residual
            that is not finite rejects the step.

    Raises:
        InputError: keys is not a list, or the function is not callable. A solve raises it if the
            function returns other shapes; the message names factor and variable.
    """

    keys: tuple[Key, ...]
    function: FactorFunction

    kind = "function"

    seconds_a_call = np.inf
    """Duration of the fastest call within solves."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "keys", as_keys("FunctionFactor: keys", self.keys))
        super().__post_init__()
        if not self.keys:
            raise InputError("FunctionFactor: keys: expected at least one variable, found 0")
        if not callable(self.function):
            raise InputError(f"{self.name}: expected a function, found {brief(self.function)}")

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:
        """See :meth:`Factor.core_arguments`."""
        return (_CheckedFunction(self, name, sizes),)


class _CheckedFunction:
    """Wrapper of the user's function that checks the returned values for ``_core``."""

    def __init__(self, factor: FunctionFactor, name: str, sizes: tuple[int, ...]) -> None:
        self.factor, self.name, self.sizes = factor, name, sizes
        self.num_residuals = 0

    def __call__(self, values: list[Array], jacobians: bool) -> tuple[Array, Any] | None:
        began = perf_counter()
        answer = self.factor.function(values)
        seconds = min(self.factor.seconds_a_call, perf_counter() - began)
        self.factor._set("seconds_a_call", seconds)
        if not isinstance(answer, tuple | list) or len(answer) != 2:
            raise InputError(
                f"{self.name}: expected (residual, list of Jacobians), "
                f"found {type(answer).__name__}"
            )
        residual = as_array(f"{self.name}: residual", answer[0])
        if residual.size != max(residual.shape, default=1):  # a column is accepted as a row
            raise InputError(
                f"{self.name}: residual: expected a 1-D array of numbers, found shape "
                f"{residual.shape}"
            )
        residual = residual.reshape(-1)
        if not self.num_residuals:
            if not len(residual):
                raise InputError(f"{self.name}: residual: expected at least one number, found 0")
            self.num_residuals = len(residual)
        if len(residual) != self.num_residuals:
            raise InputError(
                f"{self.name}: expected {plural(self.num_residuals, 'residual')} as in earlier "
                f"calls, found {len(residual)}"
            )
        if not np.isfinite(residual).all():
            return None
        return residual, self._jacobians(answer[1]) if jacobians else None

    def _jacobians(self, given: Any) -> list[Array]:
        if not isinstance(given, list | tuple) or len(given) != len(self.sizes):
            found = f"{len(given)}" if isinstance(given, list | tuple) else brief(given)
            raise InputError(
                f"{self.name}: expected a list of {plural(len(self.sizes), 'Jacobian')}, one "
                f"per variable, found {found}"
            )
        matrices = []
        for key, size, jacobian in zip(self.factor.keys, self.sizes, given, strict=True):
            where = f"{self.name}: {variable_name(key)}: Jacobian"
            matrix = as_array(where, jacobian)
            expected = (self.num_residuals, size)
            if matrix.ndim == 1 and self.num_residuals == 1:
                matrix = matrix.reshape(1, -1)
            if matrix.shape != expected:
                hint = " (transposed?)" if matrix.shape == expected[::-1] else ""
                raise InputError(f"{where}: expected shape {expected}, found {matrix.shape}{hint}")
            matrices.append(matrix)
        return matrices
