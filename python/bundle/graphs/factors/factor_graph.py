"""Factor graph: variables, factors, and the operations on both.

The alarm of the ordering needs the size of the matrix that a solve factorises. Two variables have a
block in Lambda = J^T J if a factor joins them. Ceres does not report its factor: it is counted
after the solve, in CHOLMOD's AMD order of these blocks, as for reconstructions. A dense factor has
n (n + 1) / 2 entries. METIS is compared if the factorisations take about a second.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import as_flag, check_function
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.tails import chi2_interval
from bundle.base.words import change, number, plural, seconds
from bundle.errors import InputError, brief, nearest
from bundle.graphs.factors.check_solve import Conditioning, SolvedGraph, checked
from bundle.graphs.factors.factor_check import check_graph
from bundle.graphs.factors.factor_report import FactorCheck
from bundle.graphs.factors.factors import Factor, WeightedFactor
from bundle.graphs.factors.marginals import GraphMarginals
from bundle.graphs.factors.same_problem import pose_graph_of, problem_of
from bundle.graphs.factors.variables import Array, Key, Variable, as_list
from bundle.interface.option_class import takes_options
from bundle.interface.options import CERES_ONLY, GraphOptions, SolveOptions
from bundle.interface.ordering_alarm import BestOrder, with_ordering_alarm
from bundle.interface.solve_record import Progress, SolveRecord, record_fields
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from bundle.interface.option_keywords import SolveKeywords


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GraphResult(SolveRecord):
    """Values at the end of a solve, with its summary.

    Attributes:
        values: one array per variable, by key, in the manifold's representation.
        options: all options as used.
        summary: the solver's summary; costs are 1/2 sum rho(||r||^2) over the factors.
        iterations: one array per field of Ceres' IterationSummary, one entry per iteration.
        build_time_in_seconds: time outside the solver.
        solve_time_in_seconds: time inside the solver.
        degrees_of_freedom: residuals minus free coordinates; None if chi2 has no expectation.
    """

    values: Mapping[Key, Array]
    degrees_of_freedom: int | None = None

    def _display(self) -> Display:
        summary = self.summary
        facts = [
            ("cost", change(summary.initial_cost, summary.final_cost)),
            ("time", f"{seconds(self.build_time_in_seconds + self.solve_time_in_seconds)} s"),
            ("solver", f"{summary.backend_used} {summary.linear_solver_type_used}"),
            ("graph", f"{plural(len(self.values), 'variable')}"),
            *(("warning", warning) for warning in summary.warnings),
        ]
        chi2, degrees = 2 * summary.final_cost, self.degrees_of_freedom or 0
        if degrees > 0 and summary.is_solution_usable:
            low, high = (number(one / degrees) for one in chi2_interval(degrees))
            said = f"{number(chi2)}, {number(chi2 / degrees)} per degree of freedom"
            facts.insert(1, ("chi2", f"{said} (expected {low} to {high})"))
        return Display(title=f"GraphResult: {self.outcome}", facts=tuple(facts))


_OF_OTHERS = (
    *("linear_solver_ordering", "loss", "loss_scale", "refine", "fixed_camera_ids"),
    *("fixed_image_ids", "fixed_point_ids", "refine_sensor_from_rig", "fixed_sensors"),
    *("gauge", "cheirality"),
)
"""Options of reconstructions that a factor graph does not support."""

_ELSEWHERE = {
    **dict.fromkeys(("optimize", "optimise", "minimize"), "graph.solve()"),
    **dict.fromkeys(("add", "push_back"), "graph.add_factor(factor)"),
    **dict.fromkeys(("marginal_covariance", "marginals"), "bundle.covariance(graph)"),
    "error": "graph.cost()",
    "insert": "graph.add_variable(key, value)",
    "marginal_information": "graph.information([key])",
}
"""Calls of this package by names of other packages, such as GTSAM."""

_MOST_COLUMNS_LOOKED_AT = 3000
"""A QR factorisation of this many columns takes about as long as a few steps."""


class FactorGraph(GraphMarginals):
    """Nonlinear least-squares problem of any structure: variables on manifolds and factors.

    A variable X moves by its tangent coordinates delta to X Exp(delta). Jacobians and information
    matrices refer to these coordinates:

    ===========  =========================  ==================================================
    manifold     value                      tangent coordinates
    ===========  =========================  ==================================================
    euclidean    n numbers                  the same n
    so2          angle                      angle
    so3          qx qy qz qw                rotation vector (3)
    se2          x y angle                  x y angle, in the frame of X
    se3          qx qy qz qw tx ty tz       rotation (3), then translation (3), in the frame of X
    ===========  =========================  ==================================================

    Angles are in radians. The information matrix of a graph is Lambda = J^T J and its vector is eta
    = -J^T r, with J and r of all factors at the variables' values, whitened and with losses
    applied. To second order, the cost is 1/2 delta^T Lambda delta - eta^T delta plus a constant.
    Example::

        graph = bundle.FactorGraph()
        graph.add_variable("a", [0, 0, 0], "se2", fixed=True)
        graph.add_variable("b", [1.1, 0, 0], "se2")
        graph.add_factor(bundle.BetweenFactor("a", "b", [1, 0, 0], information=100))
        graph.solve().values["b"]
    """

    @takes_options(SolveOptions)
    def solve(
        self,
        options: SolveOptions | None = None,
        *,
        progress: Progress | None = None,
        square_root: bool | None = None,
        **changes: Unpack[SolveKeywords],
    ) -> GraphResult:
        """Minimise 1/2 sum rho(||r||^2) over the factors, from the variables' values.

        The default is Ceres with normal equations. With ``square_root``, the same trust region uses
        a sparse QR factorisation of the whitened Jacobian: slower, on one thread, without bounds,
        with twice the digits (:meth:`digits`). A graph of linear factors ends at its minimum up to
        rounding for any tolerances, because a last QR step is added.

        The graph keeps its values; :meth:`with_values` applies those of the result. The GIL is
        released except for factors in Python. Ctrl-C stops the solve and keeps the best state; a
        solve that does not converge also returns a result.

        Args:
            options: solve options. Options of reconstructions must have their defaults;
                trust_region_strategy_type may also be "gauss_newton".
            progress: called after each iteration, as by :func:`bundle.solve`.
            square_root: True for QR, False for normal equations. By default, QR is used if normal
                equations would leave fewer than 4 digits. The default checks the digits only for
                graphs of at most 3000 free coordinates, without bounds and functions in Python,
                and only if linear solver and backend have their defaults.
            **changes: options by name, which replace those in ``options``.

        Raises:
            InputError: a free variable has no factor, a residual or Jacobian is not finite at the
                start or has the wrong shape, or options contradict each other. Exceptions of your
                functions are passed on.
            KeyboardInterrupt: Ctrl-C before the start was evaluated.
        """
        options, defaults = GraphOptions.of(options, changes, "solve"), SolveOptions()
        check_function("progress", progress)
        for name in _OF_OTHERS:
            default, found = (getattr(one, name) for one in (defaults, options))
            if found != default:
                raise InputError(
                    f"{name}: expected the default for a factor graph, found {brief(found)}"
                )
        cores = _core.hardware_threads()
        options = options.replace(num_threads=min(options.num_threads or cores, cores))
        as_core = options.asdict() | {"gauge": "none", "cheirality": "algebraic"}
        # read before the variables, because the graph may grow in between
        factors = list(self._factors)
        variables = dict(self._variables)
        keys = list(variables)
        core = self._core(keys, factors=factors)
        by_root, why, conditioning = self._choose_square_root(square_root, options, core, factors)
        output = _core.solve_graph(*core, as_core, progress, by_root)
        if why:
            output["summary"]["linear_solver_choice"] = why
        if options.check_solution:
            output["summary"] = checked(output, SolvedGraph(variables, factors, core, conditioning))
            output["summary"] = with_counts(output["summary"], variables, factors)
        return GraphResult(
            values=dict(zip(keys, output["values"], strict=True)),
            options=options,
            degrees_of_freedom=degrees_of_freedom(output["summary"], variables, factors),
            **record_fields(output),
        )

    def as_pose_graph(self) -> PoseGraph | None:
        """Return the pose graph of poses on se2 or se3 and BetweenFactors without loss; else None.

        Its error is "log". :func:`bundle.solve` has a solver of its own for it.
        """
        found = pose_graph_of(self)
        return None if found is None else found.graph

    def as_problem(self) -> tuple[Problem, SolveOptions] | None:
        """Return the problem of a graph of ReprojectionFactors and its options; else None.

        The options have the constants and the loss of the graph, and no gauge.
        """
        found = problem_of(self)
        return None if found is None else (found.problem, found.options)

    def digits(self) -> DigitsLeft:
        """Return the digits of a step that normal equations and a QR factorisation preserve.

        Raises:
            InputError: all coordinates are fixed, or a factor does not have a finite value.
        """
        return DigitsLeft.of(*_core.graph_conditioning(*self._core()))

    def _choose_square_root(
        self, wanted: bool | None, options: SolveOptions, core: Any, factors: list[Factor]
    ) -> tuple[bool, str, Conditioning | None]:
        """Return True for QR, the reason if it was chosen automatically, and the conditioning."""
        if wanted is not None:
            by_root, defaults = as_flag("square_root", wanted), SolveOptions()
            for name in ("backend", "linear_solver_type", *CERES_ONLY) if by_root else ():
                default, found = (getattr(one, name) for one in (defaults, options))
                if found != default:
                    raise InputError(f"{name}: expected {default} with square_root, found {found}")
            return by_root, "", None
        variables = self._variables.values()
        free = sum(len(v.coordinates) - sum(v.held) for v in variables)
        if (
            not 0 < free <= _MOST_COLUMNS_LOOKED_AT
            or not options.backend == options.linear_solver_type == "auto"
            or set(options.changed()) & set(CERES_ONLY)
            or any(len(v.lower) for v in variables)
            or any(factor.kind == "function" for factor in factors)
        ):
            return False, "", None
        found = _core.graph_conditioning(*core)
        digits = DigitsLeft.of(*found)
        if not digits.needs_square_root:
            return False, "", found
        why = (
            f"Normal equations would leave {plural(digits.normal_equations, 'digit')} of a "
            f"step, a QR factorisation {digits.square_root}."
        )
        return True, why, found

    if not TYPE_CHECKING:  # a type checker refuses unknown names

        def __getattr__(self, name: str) -> Any:
            """Raise an AttributeError that points to the name of this package."""
            own = {one: one for one in dir(type(self)) if not one.startswith("_")}
            hint = "" if name.startswith("_") else nearest(name, own | _ELSEWHERE)
            raise AttributeError(f"FactorGraph has no attribute {name!r}{hint}")

    def cost(self) -> float:
        """Return 1/2 sum rho(||r||^2) at the variables' values."""
        return _core.graph_cost(*self._core())

    def check_gradients(
        self,
        factors: Iterable[Factor] | Factor | None = None,
        *,
        most_of_a_kind: int | None = None,
        progress: Callable[[int], None] | None = None,
        **settings: Any,
    ) -> FactorCheck:
        """Check the Jacobians of factors as :func:`bundle.check_gradients` does.

        Args:
            factors: factors of the graph; by default all.
            most_of_a_kind: largest number of factors to check of those with the same code and the
                same manifolds; None: all.
            progress: called with the number of checked factors.
            **settings: num_samples (default 3), radius, seed, tolerance and tangent of
                :func:`bundle.check_gradients`; the radius refers to tangent coordinates, and for
                Euclidean variables to relative changes. A solve requires the default tangent.

        Returns:
            Report that is true if all Jacobians are right. Its findings name factor, variables,
            rows and columns; printing it explains them.

        Raises:
            InputError: a factor is not in the graph, or a function returns wrong shapes.
        """
        chosen = self._factors if factors is None else self._chosen(factors)
        check_function("progress", progress)
        return check_graph(self, chosen, most_of_a_kind, progress, settings)

    def _chosen(self, factors: Iterable[Factor] | Factor) -> list[Factor]:
        given = [factors] if isinstance(factors, Factor) else as_list("factors", "factors", factors)
        every = {id(factor) for factor in self._factors}
        for factor in given:
            if id(factor) not in every:
                raise InputError(f"factors: expected factors of the graph, found {brief(factor)}")
        return list(given)

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


DIGITS = 16
ENOUGH = 4


@dataclass(frozen=True, repr=False)
class DigitsLeft(Displayed):
    """Digits of a step by normal equations and by a QR factorisation.

    J is the whitened Jacobian with its columns scaled to norm 1, so that units have no effect.
    Normal equations square the condition number of J and lose twice as many digits as QR.

    Attributes:
        condition_number: kappa(J), the ratio of the largest and the smallest singular value,
            accurate to a few percent; infinite for dependent columns, as in a graph without a
            prior.
        rank: rank of J according to the QR factorisation.
        num_columns: number of free coordinates.
    """

    condition_number: float
    rank: int
    num_columns: int

    @staticmethod
    def of(largest: float, least: float, num_columns: int, dependent: Sequence[int]) -> DigitsLeft:
        """Return the digits for two singular values and the dependent columns."""
        rank = num_columns - len(dependent)
        condition = largest / least if least > 0 and rank == num_columns else math.inf
        return DigitsLeft(max(condition, 1.0), rank, num_columns)

    @property
    def normal_equations(self) -> int:
        """Digits of a step by normal equations: 16 - 2 log10 kappa, at least 0."""
        return self._digits(2)

    @property
    def square_root(self) -> int:
        """Digits of a step by QR: 16 - log10 kappa, at least 0."""
        return self._digits(1)

    @property
    def needs_square_root(self) -> bool:
        """True if normal equations leave fewer than 4 digits and J has full rank."""
        return self.rank == self.num_columns and self.normal_equations < ENOUGH

    def _digits(self, power: int) -> int:
        if math.isinf(self.condition_number):
            return 0
        return max(0, round(DIGITS - power * math.log10(self.condition_number)))

    def _display(self) -> Display:
        return Display(
            title="DigitsLeft",
            facts=(
                ("condition of J", f"{self.condition_number:.1e}"),
                ("rank", f"{self.rank} of {plural(self.num_columns, 'free coordinate')}"),
                ("normal equations", plural(self.normal_equations, "digit")),
                ("square root", plural(self.square_root, "digit")),
            ),
        )


LEAST_FLOPS = 2e9
"""Flops of all factorisations, about a second, of which a look takes a small share."""


class FreePattern(NamedTuple):
    """Lower triangle of Lambda over the free variables, by block columns."""

    sizes: NDArray[np.int32]
    begin: NDArray[np.int64]
    rows: NDArray[np.int32]


def degrees_of_freedom(
    summary: Mapping[str, Any], variables: Mapping[Key, Variable], factors: Sequence[Factor]
) -> int | None:
    """Return those of chi2; None with a loss, bounds, free directions or unknown information."""
    is_plain = all(isinstance(one, WeightedFactor) and one.loss == "trivial" for one in factors)
    has_bounds = any(len(variable.lower) for variable in variables.values())
    held = sum(sum(variable.held) for variable in variables.values())
    is_held = held > 0 or any(len(one.keys) == 1 for one in factors)  # if not checked: costly
    if not (is_plain and is_held) or has_bounds or "free_directions" in summary["warning_kinds"]:
        return None
    size = sum(len(variable.coordinates) for variable in variables.values())
    return int(summary["num_residuals"]) - size + held


def with_counts(
    summary: Mapping[str, Any], variables: Mapping[Key, Variable], factors: Sequence[Factor]
) -> dict[str, Any]:
    """Return the fields of a summary with the size of the factor and the alarm of its order."""
    begun = perf_counter()
    pattern = free_pattern(variables, factors)
    wide = pattern.sizes.astype(np.int64)
    columns = int(wide.sum())
    pairs = wide[pattern.rows] * np.repeat(wide, np.diff(pattern.begin))
    fields = {**summary, "num_information_nonzeros": int(2 * pairs.sum() - (wide**2).sum())}
    kind = fields["linear_solver_type_used"]
    if kind == "SPARSE_NORMAL_CHOLESKY":
        best = _count(pattern, "amd")
    elif kind == "DENSE_NORMAL_CHOLESKY":
        c = np.arange(columns, dtype=float)
        flops, entries = float((c * c + 3 * c).sum()), columns * (columns + 1) / 2
        best = BestOrder(ordering="natural", flops=flops, nonzeros=entries)
    else:  # by QR or conjugate gradients
        return fields
    fields |= {
        "num_factor_columns": columns,
        "num_reduced_nonzeros": (
            columns**2 if kind.startswith("DENSE") else fields["num_information_nonzeros"]
        ),
        "num_factor_nonzeros": int(best.nonzeros),
        "factor_flops": best.flops,
        "factor_ordering": best.ordering,
        "symbolic_time_in_seconds": perf_counter() - begun,
    }

    def look() -> BestOrder:
        return min(best, _count(pattern, "metis"), key=lambda one: one.flops)

    is_sparse = kind.startswith("SPARSE")
    return with_ordering_alarm(
        fields, lambda: pattern, look if is_sparse else None, least_flops=LEAST_FLOPS
    )


def _count(pattern: FreePattern, name: str) -> BestOrder:
    counts = _core.count_factor(*pattern, _core.order_blocks(*pattern, name))
    return BestOrder(ordering=name, flops=counts["flops"], nonzeros=counts["entries"])


def free_pattern(variables: Mapping[Key, Variable], factors: Sequence[Factor]) -> FreePattern:
    """Return the pattern of Lambda over the variables with a free coordinate."""
    sizes = {key: len(v.coordinates) - sum(v.held) for key, v in variables.items()}
    place = {key: k for k, key in enumerate(key for key, size in sizes.items() if size)}
    count = len(place)
    groups: dict[int, list[list[int]]] = {}
    for factor in factors:
        joined = [place[key] for key in factor.keys if key in place]
        groups.setdefault(len(joined), []).append(joined)
    codes = [np.arange(count) * (count + 1)]
    for num_keys, members in groups.items():
        if num_keys > 1:
            table = np.sort(np.array(members, np.int64), axis=1)
            first, second = np.triu_indices(num_keys, 1)
            codes.append(np.unique(table[:, first] * count + table[:, second]))
    columns, rows = np.divmod(np.unique(np.concatenate(codes)), max(count, 1))
    begin = np.searchsorted(columns, np.arange(count + 1)).astype(np.int64)
    free = np.array([size for size in sizes.values() if size], np.int32)
    return FreePattern(free, begin, rows.astype(np.int32))
