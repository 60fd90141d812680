"""Base class of priors from marginalization: factors about linearization points."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Self
from weakref import WeakSet

import numpy as np

import bundle._core as _core
from bundle.base.display import Display
from bundle.base.memory_sizes import format_size
from bundle.base.words import plural
from bundle.errors import InputError, brief
from bundle.graphs.factors.factors import Factor
from bundle.graphs.factors.spectrum import PriorSpectrum
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
            if not isinstance(given, Mapping):
                raise InputError(
                    f"{self.name}: {what}: expected a dict by key, found {brief(given)}"
                )
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
        if not isinstance(values, Mapping):
            raise InputError(f"values: expected a dict by key, found {brief(values)}")
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

    def _moved(self, moved: Self, jump: float) -> Self:
        """Complete the re-anchored prior with its cost jump and sources."""
        moved._set("cost_jump", jump)
        if self._sources:
            moved.made_of(self._sources)
        return moved

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
        """Return the warning of the spectrum, or "".

        The spectrum of a prior with more than `largest` columns is not computed for this.
        """
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
