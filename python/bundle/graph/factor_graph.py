"""A factor graph: what to estimate, what is known of it, and everything that is asked of both."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from bundle import _core
from bundle.arguments import check_function
from bundle.display import Display
from bundle.errors import InputError, brief
from bundle.graph.check_factors import FactorCheck, check_factors
from bundle.graph.contents import GraphContents, factor_name
from bundle.graph.factors import Factor
from bundle.graph.graph_result import GraphResult
from bundle.graph.linear_prior import LinearPrior
from bundle.graph.variables import (
    Array,
    Key,
    Variable,
    as_keys,
    as_list,
    variable_name,
)
from bundle.option_fields import choice
from bundle.options import SolveOptions
from bundle.solve_record import Progress, record_fields
from bundle.words import plural

__all__ = ["FactorGraph"]

_OF_OTHERS = (
    "linear_solver_ordering",
    "loss",
    "loss_scale",
    "refine",
    "fixed_camera_ids",
    "fixed_image_ids",
    "fixed_point_ids",
    "refine_sensor_from_rig",
    "fixed_sensors",
    "gauge",
    "cheirality",
)
"""Options that say something of reconstructions, and nothing of a factor graph."""


class FactorGraph(GraphContents):
    """Variables on manifolds and factors between them: a least-squares problem of any structure.

    A variable X moves by its tangent coordinates delta to X Exp(delta). Residuals are
    differentiated and information matrices are ordered by these:

    ===========  =========================  ==================================================
    manifold     value                      tangent coordinates
    ===========  =========================  ==================================================
    euclidean    n numbers                  the same n
    so2          angle                      angle
    so3          qx qy qz qw                rotation vector (3)
    se2          x y angle                  x y angle, in the frame of X
    se3          qx qy qz qw tx ty tz       rotation (3), then translation (3), in the frame of X
    ===========  =========================  ==================================================

    Angles are radians. The information matrix of a graph is Lambda = J^T J and its vector
    eta = -J^T r, with J and r of all factors at the variables' values, whitened, losses applied:
    the cost is 1/2 delta^T Lambda delta - eta^T delta and a constant, to second order. Example::

        graph = bundle.FactorGraph()
        graph.add_variable("a", [0, 0, 0], "se2", fixed=True)
        graph.add_variable("b", [1.1, 0, 0], "se2")
        graph.add_factor(bundle.BetweenFactor("a", "b", [1, 0, 0], information=100))
        graph.solve().values["b"]
    """

    def solve(
        self,
        options: SolveOptions | None = None,
        *,
        progress: Progress | None = None,
        **changes: Any,
    ) -> GraphResult:
        """Minimise 1/2 sum rho(||r||^2) over the factors, from the variables' values. By Ceres.

        The graph keeps its values; :meth:`with_values` takes over those of the result. The GIL is
        released but for factors in Python. Ctrl-C stops the solve and keeps the best state; not
        converging is a result as well.

        Args:
            options: how to solve. Those that concern reconstructions must have their defaults.
            progress: called after each iteration, as by :func:`bundle.solve`.
            **changes: options by name, in place of those in ``options``.

        Raises:
            InputError: a free variable has no factor, a residual or Jacobian has no finite value at
                the start or the wrong shape, or options exclude each other. What a function of
                yours raises comes through.
            KeyboardInterrupt: Ctrl-C before the start was evaluated.
        """
        options = SolveOptions.of(options, changes, "solve")
        check_function("progress", progress)
        defaults = SolveOptions()
        for option in _OF_OTHERS:
            if getattr(options, option) != getattr(defaults, option):
                raise InputError(
                    f"{option}: expected the default for a factor graph, "
                    f"found {brief(getattr(options, option))}"
                )
        cores = _core.hardware_threads()
        options = options.replace(num_threads=min(options.num_threads or cores, cores))
        as_core = options.asdict() | {"gauge": "none", "cheirality": "algebraic"}
        factors = list(self._factors)  # before the variables: the graph may grow meanwhile
        keys = list(self._variables)
        output = _core.solve_graph(*self._core(keys, factors=factors), as_core, progress)
        return GraphResult(
            values=dict(zip(keys, output["values"], strict=True)),
            options=options,
            **record_fields(output),
        )

    def cost(self) -> float:
        """Return 1/2 sum rho(||r||^2) at the variables' values."""
        return _core.graph_cost(*self._core())

    def information(self, keys: Iterable[Key] | None = None) -> tuple[Array, Array]:
        """Return what all factors together know of some variables, all others eliminated.

        The marginal information at the variables' values: with a the free coordinates of all other
        variables and b those asked for,

            Lambda = L_bb - L_ba L_aa^-1 L_ab,    eta = e_b - L_ba L_aa^-1 e_a

        by one factorisation of L_aa, without an inverse. Bounds do not count. Fixed coordinates of
        the variables asked for count as if they were free; those of others stay.

        Args:
            keys: the variables, in the order of the result; all of the graph if not given.

        Returns:
            Lambda (n, n), symmetric to the last bit, and eta (n,), n the sum of tangent sizes.

        Raises:
            InputError: a key is unknown, or the factors do not determine what is eliminated; the
                message names a variable.
        """
        positions = range(len(self._factors))
        members = self.keys
        return self._marginal(
            members if keys is None else as_keys("keys", keys), members, positions
        )

    def marginalize(self, keys: Iterable[Key]) -> LinearPrior:
        """Return what eliminating variables leaves on those that their factors touch.

        Only the factors of these variables are used, linearised at the variables' values;
        :meth:`without` drops the same factors, so that ``graph.without(keys)`` and the prior
        together stand for the graph. The graph stays as it is.

        Args:
            keys: the variables to eliminate.

        Raises:
            InputError: a key is unknown, the factors touch nothing else, or do not determine what
                is eliminated.
        """
        gone = set(self._checked_keys(keys))
        used = [i for i, factor in enumerate(self._factors) if not gone.isdisjoint(factor.keys)]
        touched = {key for i in used for key in self._factors[i].keys}
        for key in gone - touched:
            raise InputError(f"{variable_name(key)}: expected a factor that touches it, found none")
        kept = [key for key in self._variables if key in touched - gone]
        if not kept:
            raise InputError("keys: expected factors that touch other variables too, found none")
        members = [key for key in self._variables if key in touched]
        matrix, vector = self._marginal(kept, members, used)
        prior = LinearPrior(
            matrix,
            vector,
            {key: self._variables[key].value for key in kept},
            tuple(kept),
            manifolds={key: self._variables[key].manifold for key in kept},
        )
        return prior.made_of(self._factors[i] for i in used)

    def forget(self, keys: Iterable[Key], how: str = "marginalize") -> FactorGraph:
        """Return the graph after variables left it, as a window that slides forgets its oldest.

        Args:
            keys: the variables that leave.
            how: "marginalize": their factors become a prior on what they touched, which is exact
                where these are linear; "drop": their factors are lost, with what they knew of the
                others, the gauge perhaps; "keep": nothing leaves, for comparison.

        Raises:
            InputError: as by :meth:`marginalize`, or another word.
        """
        how = choice("how", how, ("marginalize", "drop", "keep"))
        keys = self._checked_keys(keys)
        if how == "keep":
            return self.with_values({})
        graph = self.without(keys)
        if how == "marginalize":
            graph.add_factor(self.marginalize(keys))
        return graph

    def check_gradients(
        self, factors: Iterable[Factor] | Factor | None = None, **settings: Any
    ) -> FactorCheck:
        """Check the Jacobians of factors as :func:`bundle.check_gradients` does.

        Args:
            factors: of the graph; all if not given.
            **settings: num_samples (3 if not given), radius, seed, tolerance of
                :func:`bundle.check_gradients`; the radius is that of tangent coordinates, and of
                Euclidean variables relative to their values.

        Returns:
            A report that is true if all is well, and explains itself when printed.

        Raises:
            InputError: a factor is not of the graph, or a function answers with wrong shapes.
        """
        wanted = [factors] if isinstance(factors, Factor) else factors
        every = {id(factor): i for i, factor in enumerate(self._factors)}
        chosen = list(range(len(self._factors)))
        if wanted is not None:
            for factor in (wanted := as_list("factors", "factors", wanted)):
                if id(factor) not in every:
                    raise InputError(f"factors: expected some of the graph, found {brief(factor)}")
            chosen = [every[id(factor)] for factor in wanted]
        return check_factors(
            [(factor_name(i, self._factors[i]), *self._one(i)) for i in chosen], settings
        )

    def _one(self, position: int) -> tuple[list[Variable], Any]:
        """Return the variables of a factor, and its function of their values."""
        factor = self._factors[position]
        variables, (given,) = self._core(factor.keys, [position], [factor])
        return (
            [self._variables[key] for key in factor.keys],
            _core.factor_function(variables, given),
        )

    def _marginal(
        self, kept: Iterable[Key], members: Iterable[Key], positions: Iterable[int]
    ) -> tuple[Array, Array]:
        members, positions = list(members), list(positions)
        places = {key: i for i, key in enumerate(members)}
        for key in kept:
            self._known("keys", key)
        core = self._core(members, positions, [self._factors[i] for i in positions])
        return _core.marginal_information(*core, [places[key] for key in kept])

    def _display(self) -> Display:
        manifolds = Counter(variable.manifold for variable in self._variables.values())
        kinds = Counter(type(factor).__name__ for factor in self._factors)
        size = sum(len(v.coordinates) - sum(v.held) for v in self._variables.values())
        return Display(
            title=f"FactorGraph: {plural(len(self._variables), 'variable')}, "
            f"{plural(len(self._factors), 'factor')}",
            facts=(
                ("variables", ", ".join(f"{n} {name}" for name, n in manifolds.items()) or "none"),
                ("factors", ", ".join(f"{n} {name}" for name, n in kinds.items()) or "none"),
                ("free", plural(size, "coordinate")),
            ),
        )
