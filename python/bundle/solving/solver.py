"""Solver of one structure, set up once for repeated solves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import check_function
from bundle.base.display import Display, Displayed
from bundle.base.words import contents, plural
from bundle.errors import InputError, brief, first_line
from bundle.interface.option_class import takes_options
from bundle.interface.options import SolveOptions
from bundle.interface.solve_record import Progress
from bundle.io.files import Source, as_problem
from bundle.model.problem import Problem
from bundle.solving.executors import KeptSolver, solve_prepared
from bundle.solving.prepare import prepare
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.interface.option_keywords import SolveKeywords
    from bundle.solving.constraints.ends import Applied
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule


class Solver(Displayed):
    """Bundle adjustment of one structure, set up once for repeated solves.

    The structure consists of the tracks, the camera models, the refined variables, the options, the
    factors and the bounds. The set-up that depends on the structure alone is done once: threads,
    unknowns, elimination order, symbolic analysis of the linear solver, and buffers. Each solve
    starts at the values of a problem: poses, camera parameters, points, observed pixels. It takes
    the same steps as :func:`bundle.solve`, bit for bit, and spends nearly all its time in them.
    There are two exceptions. Ceres on several threads sums in varying order. Relative priors of
    ``constraints`` stay relative to the problem of the constructor.

    Each solve runs in this process alone: a division among processes would repeat the set-up.

    Ceres has no such solver: with Ceres as the backend, each solve starts from scratch. The set-up
    is also repeated if other values change which numbers the gauge fixes. The two-level
    preconditioner forms its clusters from the values in each solve.

    A pickled solver contains its problem, options, factors and bounds, and is set up again when it
    is unpickled. Functions of factors must be picklable, too.

    Args:
        problem: the structure, and the default start values of :meth:`solve`; also a path or a
            pycolmap.Reconstruction.
        options: solve options; the defaults of :class:`SolveOptions` if not given. Options that
            depend on the source of the problem or on factors (``gauge``, ``cheirality``) are
            resolved here.
        factors: factors in addition to the observations, as in :func:`bundle.solve`. Their
            measurements are constant, in the world frame of the problem, for any start values.
        bounds: bounds of camera parameters, as in :func:`bundle.solve`. Every solve must start
            within them.
        constraints: rules, as in :func:`bundle.solve`. Rules about the start refer to the values of
            this problem; shared parameters start at one common value.
        **changes: options by name, which replace those in ``options``.

    Raises:
        KeyboardInterrupt, MemoryError, InputError, OSError: for the reasons of
            :func:`bundle.solve`.
    """

    @takes_options(SolveOptions)
    def __init__(
        self,
        problem: Source,
        options: SolveOptions | None = None,
        *,
        factors: Iterable[Factor] = (),
        bounds: Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]] | None = None,
        constraints: Constraints | Iterable[str | Rule] | Applied = (),
        **changes: Unpack[SolveKeywords],
    ) -> None:
        self._prepared = prepare(  # no priors, so the problem is not moved
            SolveRequest(
                problem=as_problem(problem),
                options=SolveOptions.of(options, changes, "Solver"),
                factors=factors,
                bounds=bounds,
                constraints=constraints,
            )
        )
        layout = self._prepared.layout
        self._options, _, self._limits = layout
        self._core = _core.Solver(
            self.problem, self._options.asdict(), self._limits, layout.core_factors()
        )

    @property
    def problem(self) -> Problem:
        """Problem of the constructor."""
        return self._prepared.start

    @property
    def options(self) -> SolveOptions:
        """Options as used, before the changes in :meth:`solve`."""
        return self._options

    @property
    def factors(self) -> tuple[Factor, ...]:
        """Factors in addition to the observations."""
        return self._prepared.request.factors

    @property
    def bounds(self) -> dict[tuple[str, int], tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Bounds of cameras: {("camera", camera_id): (lower, upper)}."""
        if self._limits is None or self._limits.bounds is None:
            return {}
        return self._limits.bounds.given(self.problem)

    @property
    def constraints(self) -> Constraints:
        """Rules of the constructor."""
        from bundle.solving.constraints.rule_list import Constraints

        return Constraints(() if self._applied is None else self._applied.rules)

    @property
    def _applied(self) -> Applied | None:
        return self._prepared.applied

    def solve(
        self, problem: Source | None = None, *, progress: Progress | None = None, **changes: Any
    ) -> Result:
        """Refine a problem of this structure, from its values; see :func:`bundle.solve`.

        A solver runs one solve at a time; each thread needs its own solver. After any exception the
        solver can be used again.

        Args:
            problem: problem with the start values, which is not changed; by default the problem of
                the constructor. Its poses, camera parameters, points and observed pixels may
                differ; all other inputs of a solve must be the same.
            progress: as in :func:`bundle.solve`.
            **changes: options for this solve only: radii, ``min_relative_decrease`` and
                ``max_num_consecutive_invalid_steps`` of the trust region, ``loss``,
                ``loss_scale``, ``max_num_iterations``, ``function_tolerance``,
                ``gradient_tolerance``, ``parameter_tolerance``, ``check_solution``.

        Raises:
            InputError: the problem has another structure, a camera parameter is not within its
                bounds, a factor has no value at the start, an option is not in this list, or the
                solver is in use.
            KeyboardInterrupt, MemoryError, OSError: for the reasons of :func:`bundle.solve`.
        """
        problem = self.problem if problem is None else as_problem(problem)
        check_function("progress", progress)
        options = self._options
        if changes:
            options = SolveOptions.of(options, changes, "Solver.solve")
            changeable = _core.changeable_options()
            for name in changes:
                if name not in changeable:
                    raise InputError(
                        f"{name}: expected one of {', '.join(changeable)}, which may differ from "
                        "solve to solve; other options need another Solver"
                    )
        if self._limits is not None and problem is not self.problem:
            self._core.check_structure(problem)
            self._limits.check_start(problem)
        prepared = self._prepared.laid_out_at(problem, options)
        return solve_prepared(prepared, progress, KeptSolver(self._core))

    def __copy__(self) -> Solver:
        return _make_solver(*self._parts())

    def __deepcopy__(self, _memo: Any) -> Solver:
        return self.__copy__()  # a solver is immutable

    def __reduce__(self) -> tuple[Any, ...]:
        for position, factor in enumerate(self.factors):
            _check_pickles(f"factor {position}, {factor.name}", factor)
        return _make_solver, self._parts()

    def _parts(self) -> tuple[Any, ...]:
        applied = () if self._applied is None else self._applied
        return self.problem, self._options, self.factors, self.bounds, applied

    def _display(self) -> Display:
        changed = ", ".join(f"{name}={value!r}" for name, value in self._options.changed().items())
        facts = [("problem", contents(self.problem)), ("options", changed or "defaults")]
        if self.factors:
            facts.append(("factors", f"{len(self.factors)}"))
        if self.bounds:
            facts.append(("bounds", f"of {plural(len(self.bounds), 'camera')}"))
        if self._applied is not None:
            facts.append(("constraints", plural(len(self._applied.rules), "rule")))
        return Display(title="Solver", facts=tuple(facts))


def _make_solver(
    problem: Problem,
    options: SolveOptions,
    factors: Iterable[Factor],
    bounds: Any,
    constraints: Any = (),
) -> Solver:
    return Solver(problem, options, factors=factors, bounds=bounds, constraints=constraints)


def _check_pickles(name: str, factor: Factor) -> None:
    """Raise an InputError if the factor is a Python function that cannot be pickled."""
    function = getattr(factor, "function", None)
    if function is None:
        return
    import pickle

    try:
        pickle.dumps(function)
    except Exception as error:
        raise InputError(
            f"{name}: expected a function that can be pickled, such as a function of a module, "
            f"found {brief(function)} ({first_line(error)})"
        ) from None
