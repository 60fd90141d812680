"""Executors: they run the core's solver in this process or in all processes of mpirun."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import bundle._core as _core
from bundle.base.arrays import check_function
from bundle.base.own_process import log, logged_iterations
from bundle.base.records import dataclass
from bundle.interface.solve_record import Progress
from bundle.solving.layout import refuse_shrinking
from bundle.solving.prepare import Executor, Prepared
from bundle.solving.ranks.launch import current
from bundle.solving.ranks.partition import warning
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.model.problem import Problem
    from bundle.solving.rounds.plan import State


class ThisProcess:
    """The core's solver in this process."""

    @staticmethod
    def run(prepared: Prepared, progress: Progress | None) -> dict[str, Any]:
        """See :meth:`Executor.run`."""
        options, _, limits = layout = prepared.layout
        return _core.solve(
            prepared.start, options.asdict(), progress, limits, layout.core_factors()
        )


@dataclass(frozen=True)
class KeptSolver:
    """A core solver that was set up before, for starts of the same structure.

    It runs in this process only: a division among processes would repeat the set-up in each solve.
    """

    solver: _core.Solver

    def run(self, prepared: Prepared, progress: Progress | None) -> dict[str, Any]:
        """See :meth:`Executor.run`."""
        output = self.solver.solve(prepared.start, prepared.layout.options.asdict(), progress)
        crew = current()
        if crew is not None:
            output["alone"] = warning("A bundle.Solver stays in one process.", crew.num_ranks)
        return output


def solve_prepared(
    prepared: Prepared, progress: Progress | None, executor: Executor | None = None
) -> Result:
    """Run an executor and return the result for the start.

    ``executor``: executor; None: all processes of mpirun, or this process if it is the only one.
    """
    check_function("progress", progress)
    executor = _default_executor() if executor is None else executor
    refuse_shrinking(prepared.layout)
    log("info", "solving %s", prepared.start)
    result = prepared.result(executor.run(prepared, logged_iterations(progress)))
    log("info", "%s", lambda: result.outcome)
    for sentence in result.summary.warnings:
        log("warning", "%s", sentence)
    return result


def finished(prepared: Prepared, last: Result, state: State | None = None) -> Result:
    """Convert the last result for the start to one for the problem of the request.

    Its measurements are tested on first access.
    """
    result = prepared.finished(last, state)
    if not prepared.request.priors or not last.summary.is_solution_usable:
        return result
    from bundle.solving.survey_checks import check_survey, solve_without_attitudes

    def solve_here(ready: Prepared) -> Problem:
        return solve_prepared(ready, None, ThisProcess()).problem

    at_minimum = prepared.at(last.problem)
    is_minimum = last.summary.termination_type == "CONVERGENCE"
    return dataclasses.replace(
        result,
        _survey=(lambda: check_survey(at_minimum, solve_here)) if is_minimum else None,
        _free=lambda: solve_without_attitudes(at_minimum, solve_here),
    )


def _default_executor() -> Executor:
    crew = current()
    if crew is None:
        return ThisProcess()
    from bundle.solving.ranks.divided_solve import AllProcesses  # imported under mpirun only

    return AllProcesses(crew, ThisProcess())
