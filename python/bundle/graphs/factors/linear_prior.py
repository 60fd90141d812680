"""Quadratic priors on several variables, the results of marginalization.

``LinearPrior`` stores the information matrix, ``SquareRootPrior`` its square root from QR.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import field
from typing import Any, Self
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike

import bundle._core as _core
from bundle.base.arrays import Array as Declared
from bundle.base.arrays import check_type, check_values
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import format_size, plural
from bundle.errors import InputError, brief
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.variables import MANIFOLDS, Array, Key, as_keys, as_row, variable_name
from bundle.interface.option_fields import choice


class AnchoredFactor(Factor):
    """Factor of d = Log(X*^-1 X) over several variables, about linearization points X*."""

    linearization_point: Mapping[Key, Any]
    manifolds: Mapping[Key, str]

    cost_jump = 0.0
    """Value of 1/2 d^T Lambda d - eta^T d at the step d of the last re-anchoring.

    The quadratic form about the new points omits this constant: at the new values it is 0.
    """

    _sources: Iterable[Factor] = ()
    _spectrum: PriorSpectrum | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_sources"}

    def __copy__(self) -> Self:
        return self  # its factors cannot change

    @property
    def sources(self) -> tuple[Factor, ...]:
        """Factors that were marginalized into this prior and still exist.

        A graph refuses to hold a prior together with a factor that the prior contains. Pickles and
        deep copies lose their sources.
        """
        return tuple(self._sources)

    def made_of(self, factors: Iterable[Factor]) -> Self:
        """Store factors and their sources as weak references, so that a window does not grow."""
        sources: WeakSet[Factor] = WeakSet()
        for factor in factors:
            sources.add(factor)
            if isinstance(factor, AnchoredFactor):
                sources.update(factor._sources)
        self._set("_sources", sources)
        return self

    def _check_anchor(self) -> int:
        """Check keys, points and manifolds; return the sum of the tangent sizes."""
        for what in ("linearization_point", "manifolds"):
            given = getattr(self, what)
            check_type(f"{self.name}: {what}", given, Mapping, "a dict by key")
            for key in given:
                if key not in self.keys:
                    raise InputError(f"{self.name}: {what}: there is no variable {brief(key)}")
        points, manifolds = {}, {}
        size = 0
        for key in self.keys:
            if key not in self.linearization_point:
                raise InputError(
                    f"{self.name}: linearization_point: expected a value for {brief(key)}"
                )
            where = f"{self.name}: manifold of {brief(key)}"
            manifolds[key] = choice(where, self.manifolds.get(key, "euclidean"), MANIFOLDS)
            where = f"{self.name}: linearization_point of {brief(key)}"
            value = as_row(where, self.linearization_point[key])
            points[key], names = _core.check_value(where, manifolds[key], value)
            size += len(names)
        self._set("linearization_point", points)
        self._set("manifolds", manifolds)
        return size

    def _keys_first(self) -> None:
        """Convert the given keys to a tuple, because messages name the factor by its keys."""
        self._set("keys", as_keys(f"{type(self).__name__}: keys", self.keys))

    def _step_to(self, values: Mapping[Key, Any]) -> tuple[dict[Key, Array], Array]:
        """Return new linearization points taken from values, and the step from the old ones."""
        points, steps = {}, []
        check_type("values", values, Mapping, "a dict by key")
        for key in self.keys:
            if key not in values:
                raise InputError(f"values: expected a value for {variable_name(key)}")
            manifold = self.manifolds[key]
            value = as_row(variable_name(key), values[key])
            points[key], _ = _core.check_value(variable_name(key), manifold, value)
            old = np.asarray(self.linearization_point[key])
            if len(points[key]) != len(old):
                raise InputError(
                    f"{variable_name(key)}: expected {plural(len(old), 'number')}, "
                    f"found {len(points[key])}"
                )
            steps.append(_core.local_coordinates(manifold, old, points[key]))
        return points, np.concatenate(steps)

    def reanchor(self, values: Mapping[Key, ArrayLike]) -> Self:
        """Return the same prior about other values: eta - Lambda d, or b - R d.

        The matrix stays. On Euclidean variables the cost is the same function up to the constant
        1/2 d^T Lambda d - eta^T d, which is ``cost_jump`` of the result. The cost of the factor,
        whose minimum is 0 about any point, does not change. On curved manifolds the quadratic form
        is kept, with the Jacobians of the first linearization point (first-estimate Jacobians).

        Args:
            values: new linearization points by key; other keys are ignored.

        Raises:
            InputError: a value is missing or does not lie on its manifold.
        """
        points, step = self._step_to(values)
        matrix, vector = self._form()
        change = matrix @ step
        given: dict[str, Any] = {"loss": self.loss, "loss_scale": self.loss_scale}
        kind: Any = type(self)
        moved: Self = kind(
            matrix, vector - change, points, self.keys, manifolds=self.manifolds, **given
        )
        moved._set("cost_jump", self._rise(step, change))
        if self._sources:
            moved.made_of(self._sources)
        return moved

    def _form(self) -> tuple[Array, Array]:
        """Return Lambda and eta, or R and b."""
        raise NotImplementedError

    def _rise(self, step: Array, change: Array) -> float:
        """Return 1/2 d^T Lambda d - eta^T d; ``change`` is the matrix times d."""
        raise NotImplementedError

    def _matrix(self) -> Array:
        """Return Lambda."""
        raise NotImplementedError

    def _find_spectrum(self) -> PriorSpectrum:
        return PriorSpectrum.of(self._matrix())

    @property
    def spectrum(self) -> PriorSpectrum:
        """Eigenvalues and asymmetry of Lambda; computed on first access."""
        if self._spectrum is None:
            self._set("_spectrum", self._find_spectrum())
        assert self._spectrum is not None
        return self._spectrum

    def alarm(self, largest: int) -> str:
        """Return the warning of a spectrum with at most ``largest`` columns, or ""."""
        if self._spectrum is None and len(self._matrix()) > largest:
            return ""
        return self.spectrum.warning

    def _display(self) -> Display:
        shown = super()._display()
        size = len(self._matrix())
        facts = [*shown.facts, ("coordinates", f"{size}, {format_size(8 * size * size)}")]
        facts.append(("spectrum", self.spectrum.line()))
        if self.spectrum.warning:
            facts.append(("warning", self.spectrum.warning))
        if self.cost_jump:
            facts.append(("re-anchored", f"without a constant of {self.cost_jump:g}"))
        return Display(title=shown.title, facts=tuple(facts))


@dataclass(frozen=True, eq=False, repr=False)
class LinearPrior(AnchoredFactor):
    """Quadratic cost 1/2 d^T Lambda d - eta^T d of d = Log(X*^-1 X) over several variables.

    The cost of the factor is this plus a constant that makes its minimum 0. Lambda may be singular;
    gauge directions then stay free.

    Attributes:
        Lambda: (n, n) symmetric positive semidefinite, n the sum of the tangent sizes, variables in
            the order of ``keys``.
        eta: (n,), in the range of Lambda.
        linearization_point: values X* by key, in the manifolds' representation.
        keys: the variables.
        manifolds: manifolds by key; "euclidean" if missing.

    Further attributes are ``spectrum`` (:class:`bundle.PriorSpectrum` of Lambda), ``cost_jump`` of
    the last re-anchoring and, for results of :meth:`bundle.FactorGraph.marginalize`, ``sources``.

    Raises:
        InputError: shapes, keys or manifolds do not fit each other.
            :meth:`bundle.FactorGraph.add_factor` refuses an asymmetric or indefinite Lambda.
    """

    Lambda: ArrayLike
    eta: ArrayLike
    linearization_point: Mapping[Key, ArrayLike]
    keys: tuple[Key, ...]
    manifolds: Mapping[Key, str] = field(default_factory=dict, kw_only=True)

    kind = "linear"

    def __post_init__(self) -> None:
        self._keys_first()
        super().__post_init__()
        self._freeze_matrix("Lambda")
        self._freeze_row("eta")
        size = self._check_anchor()
        if np.shape(self.Lambda) != (size, size) or np.shape(self.eta) != (size,):
            raise InputError(
                f"{self.name}: expected Lambda of shape {(size, size)} and eta of {(size,)}, "
                f"found {np.shape(self.Lambda)} and {np.shape(self.eta)}"
            )

    def _form(self) -> tuple[Array, Array]:
        return np.asarray(self.Lambda), np.asarray(self.eta)

    def _rise(self, step: Array, change: Array) -> float:
        return float(step @ (change / 2 - np.asarray(self.eta)))

    def _matrix(self) -> Array:
        return np.asarray(self.Lambda)

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:  # noqa: ARG002
        """See :meth:`Factor.core_arguments`."""
        return [self.linearization_point[key] for key in self.keys], self.Lambda, self.eta


@dataclass(frozen=True, eq=False, repr=False)
class SquareRootPrior(AnchoredFactor):
    """Quadratic cost 1/2 ||R d - b||^2 of d = Log(X*^-1 X) over several variables.

    The information R^T R is positive semidefinite for any R, and has twice the digits of a
    :class:`bundle.LinearPrior`. That class explains ``spectrum``, ``cost_jump`` and ``sources``.

    Attributes:
        root: R, (rows, n), n the sum of the tangent sizes, variables in the order of ``keys``.
        vector: b, (rows,).
        linearization_point: values X* by key, in the manifolds' representation.
        keys: the variables.
        manifolds: manifolds by key; "euclidean" if missing.

    Raises:
        InputError: shapes, keys or manifolds do not fit each other, or a number is not finite.
    """

    root: ArrayLike
    vector: ArrayLike
    linearization_point: Mapping[Key, ArrayLike]
    keys: tuple[Key, ...]
    manifolds: Mapping[Key, str] = field(default_factory=dict, kw_only=True)

    kind = "square_root"

    def __post_init__(self) -> None:
        self._keys_first()
        super().__post_init__()
        self._freeze_matrix("root")
        self._freeze_row("vector")
        size = self._check_anchor()
        root, vector = np.asarray(self.root), np.asarray(self.vector)
        if root.ndim != 2 or root.shape[1] != size or vector.shape != root.shape[:1] or not size:
            raise InputError(
                f"{self.name}: expected root of shape (rows, {size}) and vector of (rows,), "
                f"found {root.shape} and {vector.shape}"
            )
        for name, array in (("root", root), ("vector", vector)):
            check_values(f"{self.name}: {name}", array, Declared(("rows",), "finite"))
        if not root.any():
            raise InputError(f"{self.name}: root: expected at least one row, found 0")

    @property
    def Lambda(self) -> Array:  # noqa: N802
        """Information matrix R^T R, (n, n)."""
        root: Array = np.asarray(self.root)
        return np.asarray(root.T @ root)

    @property
    def eta(self) -> Array:
        """Information vector R^T b, (n,)."""
        return np.asarray(np.asarray(self.root).T @ np.asarray(self.vector))

    def _form(self) -> tuple[Array, Array]:
        return np.asarray(self.root), np.asarray(self.vector)

    def _rise(self, step: Array, change: Array) -> float:  # noqa: ARG002
        return float(change @ (change / 2 - np.asarray(self.vector)))

    def _matrix(self) -> Array:
        return self.Lambda

    def _find_spectrum(self) -> PriorSpectrum:
        return PriorSpectrum.of_root(np.asarray(self.root))

    def core_arguments(self, name: str, sizes: tuple[int, ...]) -> tuple[Any, ...]:
        """See :meth:`Factor.core_arguments`."""
        if np.asarray(self.root).shape[1] != sum(sizes):
            raise InputError(
                f"{name}: expected {plural(sum(sizes), 'column')} of root, one per tangent "
                f"coordinate, found {np.asarray(self.root).shape[1]}"
            )
        return [self.linearization_point[key] for key in self.keys], self.root, self.vector


ASYMMETRY_LIMIT = 1e-9
CONDITION_LIMIT = 1e8


@dataclass(frozen=True, repr=False)
class PriorSpectrum(Displayed):
    """Eigenvalues of the information matrix of a prior, in the units of its coordinates.

    A healthy prior of a sliding window keeps its ratio above 1e-6 without a trend. In single
    precision, the ratio falls over some hundred windows until the smallest eigenvalue is negative.

    Attributes:
        min_eigenvalue: smallest eigenvalue; rounding error if the prior has a null space.
        max_eigenvalue: largest eigenvalue.
        nullity: dimension of the null space: number of eigenvalues that are rounding errors after
            the diagonal is scaled to 1.
        ratio: smallest eigenvalue outside the null space relative to the largest.
        asymmetry: largest difference of two symmetric entries relative to the largest entry.
    """

    min_eigenvalue: float
    max_eigenvalue: float
    nullity: int
    ratio: float
    asymmetry: float

    @staticmethod
    def of(matrix: Array) -> PriorSpectrum:
        """Return the spectrum of a square matrix of finite numbers in its own precision."""
        n = len(matrix)
        largest_entry = float(np.abs(matrix).max(initial=0.0))
        difference = float(np.abs(matrix - matrix.T).max(initial=0.0))
        rounding = 16 * n * float(np.finfo(matrix.dtype).eps)
        symmetric = (matrix.astype(np.float64) + matrix.astype(np.float64).T) / 2
        eigenvalues = np.linalg.eigvalsh(symmetric)
        diagonal = np.diag(symmetric)
        scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        scaled = np.linalg.eigvalsh(scale[:, None] * symmetric * scale)
        nullity = int((np.abs(scaled) <= rounding * np.abs(scaled).max(initial=0.0)).sum())
        largest = float(eigenvalues[-1]) if n else 0.0
        # The null space has the eigenvalues nearest to 0.
        others = np.sort(eigenvalues[np.argsort(np.abs(eigenvalues), kind="stable")[nullity:]])
        return PriorSpectrum(
            float(eigenvalues[0]) if n else 0.0,
            largest,
            nullity,
            float(others[0]) / largest if len(others) and largest else 0.0,
            difference / largest_entry if largest_entry else 0.0,
        )

    @staticmethod
    def of_root(root: Array) -> PriorSpectrum:
        """Return the spectrum of R^T R from the singular values of R, with twice the digits."""
        rows, n = root.shape
        padded = np.vstack((root, np.zeros((max(n - rows, 0), n))))
        norms = np.linalg.norm(padded, axis=0)
        scaled = np.linalg.svd(padded / np.where(norms > 0, norms, 1.0), compute_uv=False)
        rounding = 16 * n * float(np.finfo(root.dtype).eps)
        nullity = int((scaled <= rounding * scaled[0]).sum())
        values = np.linalg.svd(padded, compute_uv=False) ** 2
        least = float(values[n - nullity - 1]) if nullity < n else 0.0
        largest = float(values[0])
        return PriorSpectrum(
            float(values[-1]), largest, nullity, least / largest if largest else 0.0, 0.0
        )

    @property
    def warning(self) -> str:
        """Warning if the prior should not be trusted, otherwise ""."""
        if self.asymmetry > ASYMMETRY_LIMIT:
            return f"asymmetry {self.asymmetry:.1e} is above {ASYMMETRY_LIMIT:g}"
        if self.ratio < 0:
            return f"the smallest eigenvalue is negative, {self.min_eigenvalue:.3g}"
        if self.ratio < 1 / CONDITION_LIMIT:
            return f"condition {1 / self.ratio if self.ratio else np.inf:.1e} is above " + (
                f"{CONDITION_LIMIT:g}"
            )
        return ""

    def line(self) -> str:
        """Return all values in one line."""
        free = f", {self.nullity} free" if self.nullity else ""
        return (
            f"{self.min_eigenvalue:.3g} to {self.max_eigenvalue:.3g}, "
            f"ratio {self.ratio:.1e}{free}, asymmetry {self.asymmetry:.1e}"
        )

    def _display(self) -> Display:
        facts = [
            ("eigenvalues", f"{self.min_eigenvalue:.6g} to {self.max_eigenvalue:.6g}"),
            ("free directions", str(self.nullity)),
            ("ratio", f"{self.ratio:.3g}"),
            ("asymmetry", f"{self.asymmetry:.3g}"),
        ]
        if self.warning:
            facts.append(("warning", self.warning))
        return Display(title="PriorSpectrum", facts=tuple(facts))
